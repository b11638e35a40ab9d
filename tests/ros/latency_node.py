# SPDX-License-Identifier: Apache-2.0
"""Nodes for the tests: ``latency_node.py 1|2 send|beat|hear TOPIC FILE``, with DiagnosticArray, which has a header.

``send`` publishes 500 messages with stamps 0.5 to 5 s ago, once it has a subscriber, and writes their ages (ms).
``beat`` publishes 50 a second, and makes FILE. ``hear`` appends when each message came (monotonic clock).
"""

import importlib
import json
import random
import sys
import threading
import time
from pathlib import Path
from typing import Any

COUNT = 500


def build_message(version: str, stamp: float) -> Any:
    array: Any = importlib.import_module("diagnostic_msgs.msg").DiagnosticArray()
    seconds, fraction = divmod(stamp, 1.0)
    names = ("secs", "nsecs") if version == "1" else ("sec", "nanosec")
    setattr(array.header.stamp, names[0], int(seconds))
    setattr(array.header.stamp, names[1], int(fraction * 1e9))
    return array


def open_node(version: str, name: str) -> Any:
    """Functions that make a publisher (publish, count of its subscribers) and a subscriber."""
    kind: Any = importlib.import_module("diagnostic_msgs.msg").DiagnosticArray
    if version == "1":
        rospy: Any = importlib.import_module("rospy")
        rospy.init_node(name, anonymous=True)

        def publisher(topic: str) -> Any:
            made = rospy.Publisher(topic, kind, queue_size=1000)
            return made.publish, made.get_num_connections

        return publisher, lambda topic, take: rospy.Subscriber(topic, kind, take, tcp_nodelay=True)
    rclpy: Any = importlib.import_module("rclpy")
    rclpy.init()
    node = rclpy.create_node(name)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()

    def publisher2(topic: str) -> Any:
        made = node.create_publisher(kind, topic, 1000)
        return made.publish, made.get_subscription_count

    # As a subscriber of sensor data does, and the listener of edgectl.
    profile: Any = importlib.import_module("rclpy.qos").qos_profile_sensor_data
    return publisher2, lambda topic, take: node.create_subscription(kind, topic, take, profile)


def send(version: str, topic: str, file: Path) -> None:
    publisher, _ = open_node(version, "sender")
    publish, count = publisher(topic)
    draw, ages = random.Random(5), list[float]()
    while not count():
        time.sleep(0.05)
    time.sleep(0.5)
    for _ in range(COUNT):
        ages.append(min(5000.0, 500.0 * draw.paretovariate(1.5)))
        publish(build_message(version, time.time() - ages[-1] / 1000.0))
        time.sleep(0.004)
    file.with_suffix(".new").write_text(json.dumps(ages))
    file.with_suffix(".new").rename(file)
    time.sleep(600)


def beat(version: str, topic: str, file: Path) -> None:
    publisher, _ = open_node(version, "beater")
    publish, _ = publisher(topic)
    file.touch()
    while True:
        publish(build_message(version, time.time()))
        time.sleep(0.02)


def hear(version: str, topic: str, file: Path) -> None:
    _, subscriber = open_node(version, "hearer")
    times = file.open("a", buffering=1)
    kept = subscriber(topic, lambda _: times.write(f"{time.monotonic():.6f}\n"))
    while kept is not None:
        time.sleep(1.0)


if __name__ == "__main__":
    version, what, topic, path = sys.argv[1:]
    {"send": send, "beat": beat, "hear": hear}[what](version, topic, Path(path))
