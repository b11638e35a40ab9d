# SPDX-License-Identifier: Apache-2.0
"""Lifecycle node of ROS 2: ``ros_node.py NODE SENDER`` sends its sender's name, a number and the time while it is active.

It runs on hosts: one file, rclpy beside the standard library.
"""

import importlib
import sys
import time
from typing import Any

PERIOD_S = 0.004
TOPIC = "/frames"


def run_node(node: str, sender: str) -> None:
    """Serve until killed."""
    rclpy: Any = importlib.import_module("rclpy")
    kind: Any = importlib.import_module("rclpy.lifecycle").LifecycleNode
    text: Any = importlib.import_module("std_msgs.msg").String

    class Camera(kind):  # type: ignore[misc]
        """What rclpy does with a publisher that is managed: it is silent unless the node is active."""

        def __init__(self) -> None:
            super().__init__(node)
            self.number = 0
            self.frames = self.create_lifecycle_publisher(text, TOPIC, 10)
            self.timer = self.create_timer(PERIOD_S, self.send)
            self.timer.cancel()

        def send(self) -> None:
            self.number += 1
            self.frames.publish(text(data=f"{sender} {self.number} {time.monotonic_ns()}"))

        def on_activate(self, state: Any) -> Any:
            done = super().on_activate(state)
            self.timer.reset()
            return done

        def on_deactivate(self, state: Any) -> Any:
            self.timer.cancel()
            return super().on_deactivate(state)

    rclpy.init(args=[])
    rclpy.spin(Camera())


if __name__ == "__main__":
    run_node(sys.argv[1], sys.argv[2])
