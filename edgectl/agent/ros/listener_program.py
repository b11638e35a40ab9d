# SPDX-License-Identifier: Apache-2.0
"""Listener to topics, run by the Python of the set-up files: one line for each message.

The agent sends its text to ``python3 -``; arguments are the version of ROS and the topics. Lines: ``heard``,
the number of the topic, when the message came (monotonic clock, s) and its age (ms, ``-`` without a header);
or ``error``, the number of the topic, and why nothing is heard. Nothing but these topics is subscribed.
"""

import importlib
import os
import struct
import sys
import threading
import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_LOOK_S = 0.05
_LITTLE_ENDIAN = 1
_HEADER2, _HEADER1 = ("std_msgs/Header", "std_msgs/msg/Header"), ("Header", "std_msgs/Header")
_QUEUE = 1000


class Writer:
    """Lines to the agent, whole and in order."""

    def __init__(self) -> None:
        # What ROS prints is no answer.
        self.fd = os.dup(1)
        os.dup2(2, 1)
        self.lock = threading.Lock()

    def write(self, text: str) -> None:
        """Write a line; the end of the agent is the end of this program."""
        try:
            with self.lock:
                os.write(self.fd, text.encode("utf-8", "replace") + b"\n")
        except OSError:
            os._exit(0)

    def report(self, number: int, came: float, wall: float, stamp: "float | None") -> None:
        """Report a message; ``wall`` and ``stamp`` in s since 1970."""
        age = "-" if stamp is None else "%.4f" % ((wall - stamp) * 1000.0)
        self.write("heard %d %.6f %s" % (number, came, age))


def read_stamp2(data: bytes) -> float:
    """Read the stamp at the begin of a message of ROS 2 in CDR."""
    order = "<" if data[1] & _LITTLE_ENDIAN else ">"
    seconds, nanoseconds = struct.unpack_from(order + "iI", data, 4)
    return float(seconds) + float(nanoseconds) * 1e-9


def read_stamp1(data: bytes) -> float:
    """Read the stamp of the header with which a message of ROS 1 begins."""
    seconds, nanoseconds = struct.unpack_from("<II", data, 4)
    return float(seconds) + float(nanoseconds) * 1e-9


def begins_with_header(definition: str) -> bool:
    """Whether the definition of a message of ROS 1 begins with a header."""
    for line in definition.splitlines():
        words = line.split("#")[0].split()
        if words and "=" not in line.split("#")[0]:
            return words[0] in _HEADER1
    return False


def listen2(topics: "list[str]", writer: Writer) -> None:
    """Subscribe in ROS 2, each topic once its type is known."""
    rclpy: "Any" = importlib.import_module("rclpy")
    qos: "Any" = importlib.import_module("rclpy.qos")
    rclpy.init(args=[])
    node = rclpy.create_node("edgectl_listener_%d" % os.getpid(), enable_rosout=False)
    profile = qos.QoSProfile(depth=_QUEUE, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
    waiting = dict(enumerate(topics))
    while True:
        known = dict(node.get_topic_names_and_types()) if waiting else {}
        for number, topic in sorted(waiting.items()):
            if topic in known:
                del waiting[number]
                _subscribe2(node, number, topic, known[topic][0], profile, writer)
        rclpy.spin_once(node, timeout_sec=_LOOK_S if waiting else None)


def _subscribe2(node: "Any", number: int, topic: str, type_name: str, profile: "Any", writer: Writer) -> None:
    package, _, name = type_name.partition("/msg/")
    try:
        kind: "Any" = getattr(importlib.import_module(package + ".msg"), name)
    except (ImportError, AttributeError) as error:
        return writer.write("error %d %s: %s" % (number, type_name, error))
    fields = list(kind.get_fields_and_field_types().values())
    stamped = type_name in _HEADER2 or (bool(fields) and fields[0] in _HEADER2)

    def take(data: bytes) -> None:
        writer.report(number, time.monotonic(), time.time(), read_stamp2(data) if stamped else None)

    node.create_subscription(kind, topic, take, profile, raw=True)
    return None


def listen1(topics: "list[str]", writer: Writer) -> None:
    """Subscribe in ROS 1; the type of a message comes with its connection."""
    rospy: "Any" = importlib.import_module("rospy")
    rospy.init_node("edgectl_listener", anonymous=True, disable_rosout=True, disable_signals=True)

    def make(number: int) -> "Any":
        def take(message: "Any") -> None:
            came, wall = time.monotonic(), time.time()
            header = message._connection_header  # noqa: SLF001 - the only way to the definition
            stamped = header.get("type") in _HEADER1 or begins_with_header(
                header.get("message_definition", "")
            )
            writer.report(number, came, wall, read_stamp1(message._buff) if stamped else None)  # noqa: SLF001

        return take

    for number, topic in enumerate(topics):
        rospy.Subscriber(topic, rospy.AnyMsg, make(number), tcp_nodelay=True)
    while os.getppid() != 1:
        time.sleep(1.0)
    rospy.signal_shutdown("the agent has ended")


def main(version: str, topics: "list[str]") -> None:
    """Listen until killed."""
    writer = Writer()
    try:
        (listen2 if version == "2" else listen1)(topics, writer)
    except Exception as error:  # noqa: BLE001 - the answer is the only channel
        for number in range(len(topics)):
            writer.write("error %d %s: %s" % (number, type(error).__name__, error))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
