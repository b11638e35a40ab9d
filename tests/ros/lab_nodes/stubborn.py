#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""A node for the tests that ends badly: ``stubborn.py 1|2 deaf|forks|dies``, of ROS 1 or ROS 2.

``deaf``: it ignores INT and TERM. ``forks``: the same, with another such node in a session of its own, whose
name is its own. ``dies``: it ends after a second without a goodbye, for who respawns it.
"""

import importlib
import os
import signal
import sys
import threading
import time
from typing import Any


def run_ros1() -> None:
    """Register a publisher, a subscriber and a service."""
    rospy: Any = importlib.import_module("rospy")
    text: Any = importlib.import_module("std_msgs.msg").String
    trigger: Any = importlib.import_module("std_srvs.srv").Trigger
    rospy.init_node("stubborn", anonymous=True, disable_signals=True)
    rospy.Publisher("/stubborn", text, queue_size=1)
    rospy.Subscriber("/stubborn", text, lambda _: None)
    rospy.Service("~save", trigger, lambda _: trigger._response_class())


def run_ros2(name: str) -> None:
    """Join the graph."""
    rclpy: Any = importlib.import_module("rclpy")
    signals: Any = importlib.import_module("rclpy.signals")
    rclpy.init(args=[], signal_handler_options=signals.SignalHandlerOptions.NO)
    node = rclpy.create_node(name)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()


def main(version: str, kind: str, *_: str) -> None:
    """Run until killed."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    if kind == "forks" and os.fork() == 0:
        os.setsid()
        # Without the name that roslaunch gives.
        del sys.argv[1:]
        kind = "forked"
    if version == "1":
        run_ros1()
    else:
        run_ros2(kind)
    if kind == "dies":
        time.sleep(1.0)
        os._exit(1)
    while True:
        time.sleep(1000)


if __name__ == "__main__":
    main(*sys.argv[1:])
