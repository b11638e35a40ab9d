# SPDX-License-Identifier: Apache-2.0
"""A lifecycle node of rclpy for the tests: ``waiting_node.py NAME FILE`` waits for its transitions.

It writes each to FILE, as ``NAME active`` or ``NAME standby``, and publishes NAME on /ticks while it is active.
"""

import sys
from pathlib import Path

import rclpy  # type: ignore[import-not-found]
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn  # type: ignore[import-not-found]
from std_msgs.msg import String  # type: ignore[import-not-found]


class WaitingNode(LifecycleNode):  # type: ignore[misc]
    """Publishes while it is active."""

    def __init__(self, name: str, path: Path) -> None:
        super().__init__(name)
        self.path, self.active = path, False
        self.ticks = self.create_publisher(String, "/ticks", 10)
        self.create_timer(0.005, self.tick)

    def tick(self) -> None:
        if self.active:
            self.ticks.publish(String(data=self.get_name()))

    def note(self, word: str) -> TransitionCallbackReturn:
        self.active = word == "active"
        with self.path.open("a") as file:
            file.write(f"{self.get_name()} {word}\n")
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, _state: object) -> TransitionCallbackReturn:
        return self.note("configured")

    def on_activate(self, _state: object) -> TransitionCallbackReturn:
        return self.note("active")

    def on_deactivate(self, _state: object) -> TransitionCallbackReturn:
        return self.note("standby")


if __name__ == "__main__":
    rclpy.init(args=[])
    rclpy.spin(WaitingNode(sys.argv[1], Path(sys.argv[2])))
