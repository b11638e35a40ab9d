# SPDX-License-Identifier: Apache-2.0
"""``ros_listener.py TOPIC`` prints each message and the time in ns at which it came, until its standard input ends.

A line of one number says how many publishers it has discovered. It runs in the Python that has rclpy.
"""

import sys
import threading
import time
from contextlib import suppress

import rclpy  # type: ignore[import-not-found]
from rclpy.event_handler import SubscriptionEventCallbacks  # type: ignore[import-not-found]
from rclpy.executors import ExternalShutdownException  # type: ignore[import-not-found]
from std_msgs.msg import String  # type: ignore[import-not-found]


def print_messages(topic: str) -> None:
    """Serve until standard input ends."""
    rclpy.init(args=[])
    node = rclpy.create_node("listener")

    def hear(message: String) -> None:
        print(message.data, time.monotonic_ns(), flush=True)

    events = SubscriptionEventCallbacks(matched=lambda match: print(match.current_count, flush=True))
    node.create_subscription(String, topic, hear, 10, event_callbacks=events)

    def end_with_input() -> None:
        sys.stdin.read()
        rclpy.shutdown()

    threading.Thread(target=end_with_input, daemon=True).start()
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    print_messages(sys.argv[1])
