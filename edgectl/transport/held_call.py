# SPDX-License-Identifier: Apache-2.0
"""A request that a host prepares and then holds until it is told to go on.

Between the two nothing happens on the host: without ``go``, at the end of the connection or of
``await_go_s``, it replies ``not-asked``. What takes long (login, imports, checks, the environment of a
command) is over by then, so that ``go`` costs one way of the line and the command itself (ADR 110).
"""

import secrets
import time
from collections.abc import Mapping
from typing import Self

from edgectl.agent.link import protocol
from edgectl.errors import ReplyError
from edgectl.transport.agent_client import (
    build_agent_command,
    build_frame_error,
    build_packet,
    call_agent,
    check_reply,
    find_payload,
    parse_reply_json,
)
from edgectl.transport.base import Exchange, Reply, Session


class HeldCall:
    """A prepared request of one thread. Close it in every case: without `go`, nothing was done by then."""

    def __init__(self, exchange: Exchange, marker: str, timeout: float) -> None:
        self._exchange = exchange
        self._marker = marker
        self._timeout = timeout
        self._output = b""
        self._reply: dict[str, object] | None = None
        self._finished = False

    def prepare(self) -> dict[str, object] | None:
        """Wait until the host is prepared: None then, or the reply of one that did not hold the request."""
        word = f"\n{protocol.HELD_WORD} {self._marker}\n".encode()
        self._read_until(word)
        return self._reply

    def go(self) -> None:
        """Let the request go on; a second call, or one after a reply, does nothing.

        Raises:
            ConnectError, DeadlineError: nobody knows whether it went on.
        """
        self._finish(protocol.GO_LINE)

    def wait(self) -> dict[str, object]:
        """The reply; without `go` before, the request ends with ``not-asked``.

        Raises:
            HostError: as `call_agent`.
        """
        self._finish(b"")
        self._read_until(None)
        if self._reply is None:
            raise ReplyError("no reply from the agent")
        return check_reply(self._reply)

    def close(self) -> None:
        """End the exchange; never raises. A request that was let go on may still be carried out."""
        self._exchange.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _finish(self, data: bytes) -> None:
        if not self._finished and self._reply is None:
            self._finished = True
            self._exchange.finish(data, timeout=self._timeout)

    def _read_until(self, word: bytes | None) -> None:
        """Read until ``word`` has come, or the reply."""
        deadline = time.monotonic() + self._timeout
        while self._reply is None and (word is None or word not in self._output):
            piece = self._exchange.read(timeout=max(0.0, deadline - time.monotonic()))
            self._output += piece
            if len(self._output) > protocol.MAX_REPLY_BYTES:
                raise ReplyError(f"more than {protocol.MAX_REPLY_BYTES} bytes of output")
            payload = find_payload(self._output, self._marker)
            if payload is not None:
                self._reply = parse_reply_json(payload)
            elif not piece:
                said = self._exchange.build_reply()
                raise build_frame_error(Reply(stdout=self._output, stderr=said.stderr, status=said.status))


def hold_agent_call(session: Session, request: Mapping[str, object], *, timeout: float) -> HeldCall:
    """Send ``request``, whose ``await_go_s`` is above 0, and return once the host is prepared for ``go``.

    ``timeout``: seconds to prepare it, and once more from ``go`` to the reply. A host that has nothing to
    wait for, because the instance is as asked already, has replied: `HeldCall.wait` returns that.

    Raises:
        RefusedError: the agent declined; nothing was done.
        HostError: as `call_agent`; nothing was done.
    """
    held = _send(session, request, timeout)
    if held is None:
        # As a stream, this cannot upload the agent: the status does, where the host does not have it yet.
        named = {key: request[key] for key in ("fleet", "host", "task")}
        call_agent(session, {"op": protocol.OP_STATUS, **named}, timeout=timeout)
        held = _send(session, request, timeout)
    if held is None:
        raise ReplyError("the agent arrived damaged on the host")
    return held


def _send(session: Session, request: Mapping[str, object], timeout: float) -> HeldCall | None:
    """The prepared request; None where the host does not have the agent."""
    marker = secrets.token_hex(16)
    seconds = float(str(request["await_go_s"])) + 2.0 * timeout
    packet = build_packet(request, marker, seconds)
    exchange = session.exchange(build_agent_command(session.python), packet, timeout=timeout)
    held = HeldCall(exchange, marker, timeout)
    try:
        reply = held.prepare()
        if reply is not None and reply.get("missing") is not True:
            check_reply(reply)
    except BaseException:
        held.close()
        raise
    if reply is not None and reply.get("missing") is True:
        held.close()
        return None
    return held
