"""Operations ``sink`` and ``send``: what a link carries, by really sending for a bounded time (``probe --bandwidth``)."""

import os
import secrets
import socket
import time

from .errors import RefusalError

_LONGEST_S = 30.0
_BLOCK = 1 << 17
_MOST_BYTES = 1 << 34


def _seconds(request: dict) -> float:
    return min(_LONGEST_S, max(0.1, float(request["seconds"])))


def sink(request: dict) -> dict:
    """Listen in the background for one sender that knows the token; gone after ``seconds`` and some grace."""
    seconds, token = _seconds(request), secrets.token_hex(16)
    try:
        server = socket.socket(socket.AF_INET6, socket.SOCK_STREAM)
        server.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        server.bind(("::", 0))
    except OSError:
        server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        server.bind(("0.0.0.0", 0))  # noqa: S104 - robots reach this host from outside, and must know the token
    server.listen(4)
    child = os.fork()
    if child == 0:
        _background(server, token, seconds)
    os.waitpid(child, 0)
    port = server.getsockname()[1]
    server.close()
    return {"port": port, "token": token}


def _background(server, token: str, seconds: float) -> None:
    """In the child: leave the session, receive, end. Never returns."""
    from . import spawn

    try:
        os.setsid()
        if os.fork() == 0:
            spawn.clean_process(keep=(server.fileno(),))
            _receive(server, token.encode() + b"\n", time.monotonic() + seconds + 10.0)
    finally:
        os._exit(0)


def _receive(server, greeting: bytes, deadline: float) -> None:
    """Serve strangers nothing, the sender its byte count."""
    while time.monotonic() < deadline:
        server.settimeout(max(0.01, deadline - time.monotonic()))
        peer, _ = server.accept()
        with peer:
            peer.settimeout(2.0)
            try:
                if _exactly(peer, len(greeting)) != greeting:
                    continue
                peer.settimeout(max(0.01, deadline - time.monotonic()))
                peer.sendall(b"%d\n" % _drained(peer))
            except OSError:
                continue
            return


def _exactly(peer, length: int) -> bytes:
    data = b""
    while len(data) < length:
        part = peer.recv(length - len(data))
        if not part:
            break
        data += part
    return data


def _drained(peer) -> int:
    buffer, total = bytearray(_BLOCK), 0
    while total < _MOST_BYTES:
        got = peer.recv_into(buffer)
        if not got:
            break
        total += got
    return total


def send(request: dict) -> dict:
    """Send for ``seconds`` to a sink; bytes that it confirms, and how long that took."""
    try:
        with socket.create_connection((request["address"], int(request["port"])), timeout=5.0) as peer:
            return _measured(peer, request["token"].encode(), _seconds(request))
    except OSError as error:
        message = "cannot send to %s port %s: %s" % (request["address"], request["port"], error)
        raise RefusalError("no-path", message, "is the port open in the robot's firewall?") from None


def _measured(peer, token: bytes, seconds: float) -> dict:
    block = os.urandom(_BLOCK)
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
