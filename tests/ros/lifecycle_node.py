# SPDX-License-Identifier: Apache-2.0
"""A node of rclpy for the tests: ``lifecycle_node.py NAME``. It publishes /ticks at 20 Hz, offers NAME/ask, and has a
lifecycle that becomes active after half a second.
"""

import sys
import threading
import time

import rclpy  # type: ignore[import-not-found]
from rclpy.lifecycle import LifecycleNode  # type: ignore[import-not-found]
from std_msgs.msg import String  # type: ignore[import-not-found]


def main(name: str) -> None:
    """Serve until killed."""
    rclpy.init(args=[])
    node = LifecycleNode(name)
    publisher = node.create_publisher(String, "/ticks", 1)
    node.create_timer(0.05, lambda: publisher.publish(String(data="tick")))

    def activate() -> None:
        time.sleep(0.5)
        node.trigger_configure()
        node.trigger_activate()

    threading.Thread(target=activate, daemon=True).start()
    rclpy.spin(node)


if __name__ == "__main__":
    main(sys.argv[1])
