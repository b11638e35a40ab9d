"""Messages between the programs of the patrol: a line of JSON, then as many bytes as it states.

Python >= 3.8, standard library only.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import sys
import time
from typing import Any, BinaryIO

PORT = 27000
PATIENCE_S = 30.0
ANSWER_S = 5.0
LONGEST = 1 << 20


def port(robot: str) -> int:
    """The port of a robot: 27000 and the number in its name."""
    return PORT + int((re.findall(r"\d+", robot) or ["0"])[-1]) % 1000


def send(stream: BinaryIO, header: dict[str, Any], payload: bytes = b"") -> None:
    """Write one message."""
    stream.write(json.dumps({**header, "bytes": len(payload)}).encode() + b"\n" + payload)
    stream.flush()


def receive(stream: BinaryIO) -> tuple[dict[str, Any], bytes]:
    """Read one message.

    Raises:
        ConnectionError: the other side is gone, or talks of something else.
    """
    line = stream.readline(LONGEST)
    try:
        header = json.loads(line)
        size = int(header["bytes"])
    except (ValueError, KeyError, TypeError):
        raise ConnectionError("the other side has left") from None
    payload = stream.read(size) if 0 <= size <= LONGEST else b""
    if len(payload) != size:
        raise ConnectionError("the other side has left in the middle")
    return header, payload


class Link:
    """The way to one robot; it is made anew where it breaks, for half a minute at most."""

    def __init__(self, address: str, robot: str) -> None:
        self.where = (address, port(robot))
        self.stream: Any = None

    def ask(self, what: str, payload: bytes = b"", **fields: Any) -> tuple[dict[str, Any], bytes]:
        """Ask the robot for ``what``.

        Raises:
            ConnectionError: it did not answer for half a minute.
        """
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                if self.stream is None:
                    self._connect()
                send(self.stream, {"ask": what, **fields}, payload)
                return receive(self.stream)
            except OSError as error:
                self.close()
                if time.monotonic() > deadline:
                    raise ConnectionError(
                        f"{self.where[0]}:{self.where[1]} does not answer: {error}"
                    ) from error
                time.sleep(0.2)

    def _connect(self) -> None:
        with socket.create_connection(self.where, timeout=ANSWER_S) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.stream = connection.makefile("rwb")

    def close(self) -> None:
        """Hang up."""
        if self.stream is not None:
            stream, self.stream = self.stream, None
            with contextlib.suppress(OSError):
                stream.close()


class Pace:
    """At most so many turns per second; whoever is late does not catch up."""

    def __init__(self, rate: float) -> None:
        self.every = 1.0 / rate
        self.next = time.monotonic()

    def wait(self) -> None:
        """Until the next turn."""
        now = time.monotonic()
        if now < self.next:
            time.sleep(self.next - now)
        self.next = max(self.next, now) + self.every


def give_result(robot: Link, of: str, number: int) -> float:
    """Give the robot the result of data of this number; how old the data is by now (ms, by its clock)."""
    who = f"{socket.gethostname()}/{os.getpid()}"
    return float(robot.ask("result", of=of, number=number, who=who)[0]["age_ms"])


def own_robot() -> Link:
    """The way to the robot that this task serves."""
    return Link(
        os.environ.get("EDGECTL_ROBOT_HOST") or "127.0.0.1", os.environ.get("EDGECTL_ROBOT", "robot1")
    )


def report(**values: float) -> None:
    """Add values to the metrics of this task, where edgectl asks for them; say them in the log."""
    sys.stdout.write(" ".join(f"{name}={value:.3f}" for name, value in values.items()) + "\n")
    sys.stdout.flush()
    count(**values)


def count(**values: float) -> None:
    """Add values to the metrics of this task, of which each one counts."""
    path = os.environ.get("EDGECTL_METRICS")
    if path:
        with open(path, "a") as file:  # noqa: PTH123 - one short write, which other writers cannot cut in two
            file.write("".join(f"{name} {value:.3f}\n" for name, value in values.items()))
