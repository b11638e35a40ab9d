# SPDX-License-Identifier: Apache-2.0
"""Operations ``sink`` and ``send``: throughput of a link, measured by sending for a bounded time (``probe
--bandwidth``).
"""

import os
import secrets
import socket
import time

from ..link.errors import RefusalError
from ..link.fast_json import Document

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn

_MAX_S = 30.0
_BLOCK_BYTES = 1 << 17
_MAX_BYTES = 1 << 34
# A short sample must not wait for its sink on a busy host: the kernel takes what comes. As much as it allows
# without rights, from the first byte on; a longer measurement is better off with a buffer that grows.
_SHORT_S, _BUFFER_BYTES = 0.1, 212_992


def _clamp_seconds(request: Document) -> float:
    return min(_MAX_S, max(0.1, float(request["seconds"])))


def start_sink(request: Document) -> Document:
    """Listen in the background for one sender that has the token.

    Ends after ``seconds`` and a grace of 10 s.
    """
    seconds, token = _clamp_seconds(request), secrets.token_hex(16)
    try:
        server = socket.socket(socket.AF_INET6, socket.SOCK_STREAM)
        server.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        server.bind(("::", 0))
    except OSError:
        server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        server.bind(("0.0.0.0", 0))  # noqa: S104 - robots connect from outside, and must send the token
    if float(request["seconds"]) < _SHORT_S:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    server.listen(4)
    child = os.fork()
    if child == 0:
        _serve_in_background(server, token, seconds)
    os.waitpid(child, 0)
    port = server.getsockname()[1]
    server.close()
    return {"port": port, "token": token}


def _serve_in_background(server: socket.socket, token: str, seconds: float) -> "NoReturn":
    """In the child: leave the session, receive, exit."""
    from ..supervise import spawn

    try:
        os.setsid()
        if os.fork() == 0:
            spawn.clean_process(keep=(server.fileno(),))
            _serve_sender(server, token.encode() + b"\n", time.monotonic() + seconds + 10.0)
    finally:
        os._exit(0)


def _serve_sender(server: socket.socket, greeting: bytes, deadline: float) -> None:
    """Reply the byte count to the sender; other peers get nothing."""
    while time.monotonic() < deadline:
        server.settimeout(max(0.01, deadline - time.monotonic()))
        peer, _ = server.accept()
        with peer:
            peer.settimeout(2.0)
            try:
                if _receive_exactly(peer, len(greeting)) != greeting:
                    continue
            except OSError:
                continue
            try:
                peer.settimeout(max(0.01, deadline - time.monotonic()))
                peer.sendall(b"%d\n" % _count_received(peer))
            except OSError:
                # A sender of a short sample resets the connection when it has seen enough.
                pass
            return


def _receive_exactly(peer: socket.socket, length: int) -> bytes:
    data = b""
    while len(data) < length:
        part = peer.recv(length - len(data))
        if not part:
            break
        data += part
    return data


def _count_received(peer: socket.socket) -> int:
    buffer, total = bytearray(_BLOCK_BYTES), 0
    while total < _MAX_BYTES:
        got = peer.recv_into(buffer)
        if not got:
            break
        total += got
    return total


def send_to_sink(request: Document) -> Document:
    """Send for ``seconds`` to a sink; returns the bytes that it confirms and the seconds taken."""
    try:
        with socket.create_connection((request["address"], int(request["port"])), timeout=5.0) as peer:
            return _measure_rate(peer, request["token"].encode(), _clamp_seconds(request))
    except OSError as error:
        message = "cannot send to %s port %s: %s" % (request["address"], request["port"], error)
        raise RefusalError("no-path", message, "check that the robot's firewall allows this port") from None


def _measure_rate(peer: socket.socket, token: bytes, seconds: float) -> Document:
    block = os.urandom(_BLOCK_BYTES)
    peer.sendall(token + b"\n")
    began = time.monotonic()
    peer.settimeout(seconds + 5.0)
    while time.monotonic() - began < seconds:
        peer.sendall(block)
    peer.shutdown(socket.SHUT_WR)
    confirmed = b""
    while not confirmed.endswith(b"\n"):
        part = peer.recv(64)
        if not part:
            raise OSError("the receiver confirmed nothing")
        confirmed += part
    return {"bytes": int(confirmed), "seconds": round(time.monotonic() - began, 4)}
