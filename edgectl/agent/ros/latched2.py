# SPDX-License-Identifier: Apache-2.0
"""Program that reads the last message of a latched topic of ROS 2, or offers it to the nodes of a task.

Run as ``python3 -c TEXT save|load`` by the Python of the set-up files; the state is standard output or
input: a line of JSON (type), then the message as it is serialized. It ends once a node of the task in
``EDGECTL_STATE_OF`` has acknowledged the message.
"""

import importlib
import json
import os
import struct
import sys
import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_POLL_S = 0.05
# How the identifiers of its readers begin: then follow two bytes of the host and two of the process.
_FAST_DDS = b"\x01\x0f"


class Session:
    """A node, and the profile of a latched topic."""

    def __init__(self, until: float) -> None:
        self.until = until
        self.rclpy: "Any" = importlib.import_module("rclpy")
        self.rclpy.init(args=[])
        self.node = self.rclpy.create_node("edgectl_state_%d" % os.getpid(), enable_rosout=False)
        qos: "Any" = importlib.import_module("rclpy.qos")
        self.profile = qos.QoSProfile(
            depth=1,
            reliability=qos.ReliabilityPolicy.RELIABLE,
            durability=qos.DurabilityPolicy.TRANSIENT_LOCAL,
        )

    def wait(self, condition: "Any") -> bool:
        """Spin until the condition holds; False where it does not in time."""
        while not condition():
            if time.monotonic() >= self.until:
                return False
            self.rclpy.spin_once(self.node, timeout_sec=_POLL_S)
        return True


def load_type(name: str) -> "Any":
    """Load the class of ``package/msg/Name``."""
    package, _, kind = name.partition("/msg/")
    return getattr(importlib.import_module(package + ".msg"), kind)


def save(topic: str, session: Session) -> None:
    """Print the message that a latched publisher of the topic sends to a new subscriber."""
    node, found = session.node, []  # type: Any, list[bytes]
    if not session.wait(lambda: node.get_publishers_info_by_topic(topic)):
        sys.exit("no message on %s: it has no publisher" % topic)
    name = node.get_publishers_info_by_topic(topic)[0].topic_type
    node.create_subscription(load_type(name), topic, found.append, session.profile, raw=True)
    if not session.wait(lambda: found):
        sys.exit("no message on %s: is it latched (transient local)?" % topic)
    sys.stdout.buffer.write(json.dumps({"type": name}).encode("ascii") + b"\n" + found[0])
    sys.stdout.buffer.flush()


def load(topic: str, session: Session) -> None:
    """Offer what standard input has until a node of the task has it."""
    name = json.loads(sys.stdin.buffer.readline().decode("ascii"))["type"]
    publisher = session.node.create_publisher(load_type(name), topic, session.profile)
    publisher.publish(sys.stdin.buffer.read())
    duration: "Any" = importlib.import_module("rclpy.duration").Duration

    def is_read() -> bool:
        return has_reader(topic, session.node) and publisher.wait_for_all_acked(
            duration(seconds=max(_POLL_S, session.until - time.monotonic()))
        )

    if not session.wait(is_read):
        sys.exit("no node of the task has read %s" % topic)


def has_reader(topic: str, node: "Any") -> bool:
    """Whether a process of the task subscribes; any subscriber, where identifiers do not have the process."""
    gids = [bytes(each.endpoint_gid) for each in node.get_subscriptions_info_by_topic(topic)]
    if not all(gid[:2] == _FAST_DDS for gid in gids):
        return bool(gids)
    return bool({gid[4:6] for gid in gids} & {struct.pack("<H", pid & 0xFFFF) for pid in list_pids()})


def list_pids() -> "list[int]":
    """List the processes of the task on this host."""
    mark, found = b"EDGECTL_TASK_DIR=" + os.fsencode(os.environ["EDGECTL_STATE_OF"]), []
    for name in os.listdir("/proc"):
        try:
            if name.isdigit():
                with open("/proc/%s/environ" % name, "rb") as file:
                    if mark in file.read().split(b"\0"):
                        found.append(int(name))
        except OSError:
            continue
    return found


def main(verb: str) -> None:
    """Save or load within ``EDGECTL_STATE_SECONDS``."""
    session = Session(time.monotonic() + float(os.environ["EDGECTL_STATE_SECONDS"]))
    (save if verb == "save" else load)(os.environ["EDGECTL_STATE_TOPIC"], session)
    sys.stdout.flush()
    # The threads of DDS may take seconds to end.
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1])
