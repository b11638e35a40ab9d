# SPDX-License-Identifier: Apache-2.0
"""Senders and receivers of one kind of traffic: ``traffic.py KIND ROLE ADDRESS SIZE BYTES_PER_S``.

KIND is tcp, fastdds (rclpy) or cyclone; ROLE is send or receive. Each kind needs its own Python.
"""

import itertools
import socket
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

PORT = 20007
TOPIC = "edgectl_throughput"


def pace(size: int, rate: float) -> Iterator[None]:
    """Yield whenever a message of ``size`` bytes is due."""
    began = time.monotonic()
    for number in itertools.count():
        time.sleep(max(0.0, began + number * size / rate - time.monotonic()))
        yield


def run_tcp(role: str, address: str, size: int, rate: float) -> None:
    """A stream of messages; the receiver listens at ``address``."""
    if role == "receive":
        with socket.create_server((address, PORT)) as server:
            peer, _ = server.accept()
            while peer.recv(1 << 20):
                pass
        return
    while True:
        try:
            peer = socket.create_connection((address, PORT))
            break
        except OSError:
            time.sleep(0.1)
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for _ in pace(size, rate):
        peer.sendall(bytes(size))


def run_fastdds(role: str, size: int, rate: float) -> None:
    """A topic of ROS 2 with the default quality of service."""
    import rclpy  # type: ignore[import-not-found]
    from std_msgs.msg import String  # type: ignore[import-not-found]

    rclpy.init()
    node = rclpy.create_node(role)
    if role == "receive":
        node.create_subscription(String, TOPIC, lambda _message: None, 10)
        rclpy.spin(node)
        return
    publisher = node.create_publisher(String, TOPIC, 10)
    message = String(data="x" * size)
    for _ in pace(size, rate):
        publisher.publish(message)


def run_cyclone(role: str, size: int, rate: float) -> None:
    """A reliable topic of Cyclone DDS."""
    from cyclonedds.core import Policy, Qos  # type: ignore[import-not-found]
    from cyclonedds.domain import DomainParticipant  # type: ignore[import-not-found]
    from cyclonedds.idl import IdlStruct  # type: ignore[import-not-found]
    from cyclonedds.pub import DataWriter  # type: ignore[import-not-found]
    from cyclonedds.sub import DataReader  # type: ignore[import-not-found]
    from cyclonedds.topic import Topic  # type: ignore[import-not-found]
    from cyclonedds.util import duration  # type: ignore[import-not-found]

    @dataclass
    class Blob(IdlStruct, typename="Blob"):  # type: ignore[misc, call-arg]
        text: str

    participant = DomainParticipant(0)
    quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
    topic = Topic(participant, TOPIC, Blob)
    if role == "receive":
        reader = DataReader(participant, topic, qos=quality)
        while True:
            for _ in reader.take_iter(timeout=duration(seconds=1)):
                pass
    writer = DataWriter(participant, topic, qos=quality)
    message = Blob(text="x" * size)
    for _ in pace(size, rate):
        writer.write(message)


if __name__ == "__main__":
    kind, role, address, size, rate = sys.argv[1:]
    if kind == "tcp":
        run_tcp(role, address, int(size), float(rate))
    else:
        (run_fastdds if kind == "fastdds" else run_cyclone)(role, int(size), float(rate))
