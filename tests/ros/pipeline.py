# SPDX-License-Identifier: Apache-2.0
"""Nodes of a pipeline for the tests, of ROS 1 or ROS 2: ``pipeline.py 1|2 NAME ROLE WORDS..``.

``source OUT HZ BYTES`` sends so many messages, ``relay IN OUT`` sends on what it hears, ``sink IN FILE`` appends the
time of each message in s (monotonic, of the machine) to a file. In ROS 2 a relay makes the file ``relays-PID`` in its
home once it has sent on a message while its publisher had discovered a subscriber.
"""

import importlib
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def run_ros1(name: str, role: str, *words: str) -> None:
    """Run until killed."""
    rospy: Any = importlib.import_module("rospy")
    text: Any = importlib.import_module("std_msgs.msg").String
    rospy.init_node(name)

    def publish(topic: str) -> Callable[[str], None]:
        send: Callable[[str], None] = rospy.Publisher(topic, text, queue_size=1).publish
        return send

    def subscribe(topic: str, hear: Callable[[str], None]) -> None:
        rospy.Subscriber(topic, text, lambda message: hear(message.data), queue_size=1)

    if role == "source":
        send, rate = publish(words[0]), rospy.Rate(float(words[1]))
        while not rospy.is_shutdown():
            send("x" * int(words[2]))
            rate.sleep()
        return
    play(role, words, publish, subscribe)
    rospy.spin()


def run_ros2(name: str, role: str, *words: str) -> None:
    """Run until killed."""
    rclpy: Any = importlib.import_module("rclpy")
    text: Any = importlib.import_module("std_msgs.msg").String
    rclpy.init(args=[])
    node = rclpy.create_node(name)

    def publish(topic: str) -> Callable[[str], None]:
        publisher = node.create_publisher(text, topic, 1)
        mark = Path.home() / f"relays-{os.getpid()}"

        def send(data: str) -> None:
            publisher.publish(text(data=data))
            if role == "relay" and publisher.get_subscription_count() and not mark.exists():
                mark.touch()

        return send

    def subscribe(topic: str, hear: Callable[[str], None]) -> None:
        node.create_subscription(text, topic, lambda message: hear(message.data), 1)

    if role == "source":
        send = publish(words[0])
        node.create_timer(1.0 / float(words[1]), lambda: send("x" * int(words[2])))
    else:
        play(role, words, publish, subscribe)
    rclpy.spin(node)


def play(
    role: str,
    words: "tuple[str, ...]",
    publish: Callable[[str], Callable[[str], None]],
    subscribe: Callable[[str, Callable[[str], None]], None],
) -> None:
    """Relay or note what is heard."""
    if role == "relay":
        send = publish(words[1])
        subscribe(words[0], lambda data: send(data[:1000]))
        return
    file = Path(words[1]).open("a", buffering=1)  # noqa: SIM115 - it is closed with the process
    subscribe(words[0], lambda _: print(time.monotonic(), file=file))


if __name__ == "__main__":
    (run_ros1 if sys.argv[1] == "1" else run_ros2)(*sys.argv[2:])
