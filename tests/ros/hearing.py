# SPDX-License-Identifier: Apache-2.0
"""Subscriber for the tests: ``hearing.py 1|2 FILE`` appends a JSON line per message of the gateway: [topic, time in s, content].

The content of /diagnostics is {name: [level, message]}.
"""

import importlib
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

TOPICS = ("/diagnostics", "/edgectl/status")


def main(version: str, path: str) -> None:
    """Hear both topics until killed."""
    heard, guard = Path(path), threading.Lock()

    def note(topic: str, content: object) -> None:
        with guard, heard.open("a") as file:
            file.write(json.dumps([topic, time.monotonic(), content]) + "\n")

    def on_diagnostics(array: Any) -> None:
        levels = {
            each.name: [each.level if version == "1" else each.level[0], each.message]
            for each in array.status
        }
        note(TOPICS[0], levels)

    def on_status(text: Any) -> None:
        note(TOPICS[1], text.data)

    array: Any = importlib.import_module("diagnostic_msgs.msg").DiagnosticArray
    text: Any = importlib.import_module("std_msgs.msg").String
    if version == "1":
        rospy: Any = importlib.import_module("rospy")
        rospy.init_node("hearing")
        rospy.Subscriber(TOPICS[0], array, on_diagnostics)
        rospy.Subscriber(TOPICS[1], text, on_status)
        note("ready", "")
        rospy.spin()
        return
    rclpy: Any = importlib.import_module("rclpy")
    rclpy.init()
    node = rclpy.create_node("hearing")
    node.create_subscription(array, TOPICS[0], on_diagnostics, 10)
    node.create_subscription(text, TOPICS[1], on_status, 10)
    note("ready", "")
    rclpy.spin(node)


if __name__ == "__main__":
    main(*sys.argv[1:])
