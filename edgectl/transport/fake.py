# SPDX-License-Identifier: Apache-2.0
"""A fleet without a network, for tests: handlers answer requests, through the same frames as a real agent.

    transport = FakeTransport(
        {"edge1": lambda request: {"v": 1, "op": request["op"]}, "edge2": ConnectError("switched off")}
    )

A request that waits for ``go`` reaches its handler when that comes; without it, the reply is ``not-asked``.
A handler takes the request and returns the reply; it may raise a `HostError`: a `RefusedError` is the refusal
of the agent, any other one a failed connection. An error in place of a handler: connecting to the host fails.
"""

import hashlib
import json
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Self

from edgectl.agent.link import protocol
from edgectl.errors import ConnectError, DeadlineError, HostError, RefusedError
from edgectl.model.inventory import Host
from edgectl.transport.agent_client import build_agent_command
from edgectl.transport.base import Reply

Handler = Callable[[dict[str, object]], Mapping[str, object]]


class FakeTransport:
    """Hosts with handlers; every other host is a `ConnectError`. ``requests``: (host, request) in order."""

    def __init__(self, handlers: Mapping[str, Handler | HostError]) -> None:
        self._handlers = handlers
        self._lock = threading.Lock()
        self.requests: list[tuple[str, dict[str, object]]] = []

    def connect(self, host: Host, *, timeout: float) -> "FakeSession":
        """A session, or the error in place of a handler."""
        del timeout  # nothing here takes time
        handler = self._handlers.get(host.name, ConnectError("no handler for this host"))
        if isinstance(handler, HostError):
            raise type(handler)(handler.message, hint=handler.hint, host=host.name)
        return FakeSession(host.name, handler, self._note)

    def address(self, host: Host) -> str:
        """The address that the inventory states."""
        return host.host

    def _note(self, name: str, request: dict[str, object]) -> None:
        with self._lock:
            self.requests.append((name, request))


class FakeSession:
    """Parses requests as an agent does, and frames what the handler returns."""

    python = "python3"

    def __init__(self, name: str, handler: Handler, note: Callable[[str, dict[str, object]], None]) -> None:
        self.name = name
        self._handler = handler
        self._note = note

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        """Answer one request (see `Session.run`)."""
        del timeout, limit  # instant and small
        marker, reply = self._answer(command, stdin)
        return Reply(stdout=frame_reply(marker, reply), stderr=b"", status=0)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        """Answer ``follow``: the reply's ``text`` comes as one piece (see `Session.stream`)."""
        del idle_timeout  # it never idles
        marker, reply = self._answer(command, stdin)
        if "error" in reply:
            yield frame_reply(marker, reply)
            return
        text = str(reply.get("text", "")).encode()
        yield frame_reply(marker, {"stream": True})
        yield b"%d\n%s" % (len(text), text) if text else b""
        yield b"end\n"

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> "FakeExchange":
        """Hold one request (see `Session.exchange`)."""
        del timeout  # instant
        return FakeExchange(unpack_request(stdin)[0], lambda: self._answer(command, stdin)[1])

    def close(self) -> None:
        """Nothing to close."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _answer(self, command: str, stdin: bytes) -> tuple[str, Mapping[str, object]]:
        if command != build_agent_command(self.python):
            raise RefusedError("only the agent's own command line can be run", host=self.name)
        marker, request = unpack_request(stdin)
        self._note(self.name, request)
        try:
            return marker, self._handler(request)
        except RefusedError as error:
            return marker, {"error": {"kind": "refused", "message": error.message, "hint": error.hint}}


class FakeExchange:
    """A request that is prepared at once, and answered when its input is closed (see `Exchange`)."""

    def __init__(self, marker: str, answer: Callable[[], Mapping[str, object]]) -> None:
        self._marker = marker
        self._answer = answer
        self._output = [f"\n{protocol.HELD_WORD} {marker}\n".encode()]

    def read(self, *, timeout: float) -> bytes:
        """The next piece; DeadlineError where nothing would ever come."""
        if not self._output:
            raise DeadlineError(f"no answer within {timeout:.3g} s")
        return self._output.pop(0)

    def finish(self, data: bytes, *, timeout: float) -> None:
        """Answer the request where ``data`` lets it go on."""
        del timeout  # instant
        reply = self._answer() if data == protocol.GO_LINE else {"state": protocol.NOT_ASKED}
        self._output += [frame_reply(self._marker, reply), b""]

    def build_reply(self) -> Reply:
        """A command that ended well and complained of nothing."""
        return Reply(stdout=b"", stderr=b"", status=0)

    def close(self) -> None:
        """Nothing to close."""


def unpack_request(packet: bytes) -> tuple[str, dict[str, object]]:
    """Marker and request of a packet: two programs, head line, request, agent (`transport.agent_client`)."""
    for _ in range(2):
        size, _, rest = packet.partition(b"\n")
        packet = rest[int(size) :]
    head, _, body = packet.partition(b"\n")
    marker, _, length, *_ = head.decode().split()
    return marker, dict(json.loads(body[: int(length)]))


def frame_reply(marker: str, reply: Mapping[str, object]) -> bytes:
    """``reply`` as an agent frames it: marker, length, digest, JSON."""
    payload = json.dumps(reply).encode()
    return (
        f"\nedgectl-frame {marker} {len(payload)} {hashlib.sha256(payload).hexdigest()}\n".encode()
        + payload
        + b"\n"
    )
