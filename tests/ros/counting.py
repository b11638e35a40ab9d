# SPDX-License-Identifier: Apache-2.0
"""Nodes of rospy for the tests, run by /usr/bin/python3: ``counting.py talk NAME`` and ``counting.py hear NAME FILE``.

The listener writes to its file how many messages it has heard, and from which process the last one came.
"""

import os
import sys
import threading
from pathlib import Path

import rospy  # type: ignore[import-not-found]
from std_msgs.msg import String  # type: ignore[import-not-found]


def talk(name: str) -> None:
    """Publish the process id at 50 Hz."""
    rospy.init_node(name)
    publisher = rospy.Publisher("/counted", String, queue_size=1)
    rate = rospy.Rate(50)
    while not rospy.is_shutdown():
        publisher.publish(str(os.getpid()))
        rate.sleep()


def hear(name: str, path: str) -> None:
    """Count what is heard."""
    heard, guard = 0, threading.Lock()

    def count(message: String) -> None:
        nonlocal heard
        with guard:  # each publisher has a thread of its own
            heard += 1
            Path(path + ".new").write_text(f"{heard} {message.data}")
            Path(path + ".new").replace(path)

    rospy.init_node(name)
    rospy.Subscriber("/counted", String, count)
    rospy.spin()


if __name__ == "__main__":
    if sys.argv[1] == "talk":
        talk(sys.argv[2])
    else:
        hear(sys.argv[2], sys.argv[3])
