"""Nodes, topics and messages of the patrol in ROS 2.

A UInt8MultiArray is a line of JSON and the bytes that it counts, as in wire.py; a String is JSON; a result
is a Header: the stamp of the data that it is of, and JSON. The robot keeps data for others (``keep``) and
offers it to whoever comes later (``kept/NAME``, latched). Python >= 3.8, rclpy and std_msgs.
"""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import time
from array import array
from collections.abc import Callable
from typing import Any

import rclpy
import wire
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Header, String, UInt8MultiArray

LOOK_S = 0.2
KEPT_S = 2.0
KEPT = ("map", "places", "stops", "final")
# Of a sensor only the newest matters; what is kept is for those who come later.
SENSOR = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


def pack(header: dict[str, Any], payload: bytes = b"") -> UInt8MultiArray:
    """Write a message with bytes."""
    stream = io.BytesIO()
    wire.send(stream, header, payload)
    return UInt8MultiArray(data=array("B", stream.getvalue()))


def unpack(message: UInt8MultiArray) -> tuple[dict[str, Any], bytes]:
    """Read a message with bytes."""
    return wire.receive(io.BytesIO(message.data.tobytes()))


def say(**fields: Any) -> String:
    """Write a message of fields."""
    return String(data=json.dumps(fields))


def give_result(of: dict[str, Any], **found: Any) -> Header:
    """Write the result for data with this header; its stamp is that of the data."""
    who = f"{socket.gethostname()}/{os.getpid()}"
    result = Header(frame_id=json.dumps({"number": of["number"], "who": who, **found}))
    result.stamp.sec, result.stamp.nanosec = of["stamp"]
    return result


class Member:
    """A node among those of one robot, until TERM or `leave`."""

    def __init__(self, name: str, robot: str = "") -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(
            name, namespace=robot or os.environ.get("EDGECTL_ROBOT", "robot1"), enable_rosout=False
        )
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.over, self.publishers = False, {}
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self.leave)

    def leave(self, *_signal: object) -> None:
        """End `spin` soon."""
        self.over = True

    def publish(self, topic: str, message: Any, quality: Any = 10) -> None:
        """Publish; the first message of a topic makes its publisher."""
        self.publisher(topic, type(message), quality).publish(message)

    def publisher(self, topic: str, kind: Any, quality: Any = 10) -> Any:
        """The publisher of a topic."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(kind, topic, quality)
        return self.publishers[topic]

    def hear(self, topic: str, kind: Any, take: Callable[[Any], object], quality: Any = 10) -> None:
        """Call ``take`` with each message."""
        self.node.create_subscription(kind, topic, take, quality)

    def spin(self, until: Callable[[], bool] = lambda: False) -> None:
        """Take messages until told to leave, or until this holds."""
        while not self.over and not until():
            self.executor.spin_once(timeout_sec=LOOK_S)

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown()


class Board:
    """What the robot keeps for others: the questions ``get`` and ``put`` of `wire.Link`, by topics."""

    def __init__(self, member: Member) -> None:
        self.member = member
        self.sent: dict[str, bytes] = {}
        self.kept: dict[str, bytes] = {}
        member.publisher("keep", UInt8MultiArray)

    def ask(self, what: str, payload: bytes = b"", name: str = "") -> tuple[dict[str, Any], bytes]:
        """``put`` data under a name, or ``get`` what is kept there: nothing before the first time."""
        if name not in self.kept and name not in self.sent:
            self.member.hear("kept/" + name, UInt8MultiArray, lambda each: self.take(name, each), LATCHED)
        if what == "put":
            self.sent[name] = payload
            self.member.publish("keep", pack({"name": name}, payload))
        else:
            self.member.spin(lambda: name in self.kept)
        return {}, self.kept.get(name, b"")

    def take(self, name: str, message: UInt8MultiArray) -> None:
        """Know what is kept."""
        self.kept[name] = unpack(message)[1]

    def settle(self) -> None:
        """Wait until what was sent is kept, at most `KEPT_S`: acknowledgements of DDS come a second later."""
        until = time.monotonic() + KEPT_S
        while time.monotonic() < until and any(self.kept.get(n) != data for n, data in self.sent.items()):
            self.member.executor.spin_once(timeout_sec=LOOK_S)
