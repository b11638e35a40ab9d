# SPDX-License-Identifier: Apache-2.0
"""Operation ``sample-link``: rate of an idle link, by sending to a sink for a tenth of a second at most.

Bounded in time, in bytes and in rate. The connection is reset at its end, so that nothing of it stays in the
send buffer; what is then under way is at most twice what has arrived.
"""

import select
import struct
import time

from ..link.errors import RefusalError
from ..link.fast_json import Document
from . import link_rate
from .sockets import socket

_MAX_S, _CONNECT_S, _LOOK_S = 0.1, 1.0, 0.001
_BLOCK_BYTES = 1 << 14
_MAX_BYTES = 1 << 27
_INFO_BYTES = 192
_ACKED_AT = 120
# Options of Linux that module socket does not name before Python 3.12, or at all.
_NOT_SENT_LOW_WATER, _MAX_PACING_RATE = 25, 47
# What is measured after the limit was met is a rate from so many bytes and seconds on.
_MIN_TAIL_BYTES, _MIN_TAIL_S = 4096, 0.02


def sample_link(request: Document) -> Document:
    """Send to the sink at ``address`` and ``port`` for ``seconds`` at ``rate_bytes_per_s``, both at most.

    ``bytes_per_s``: what arrived, None where too little did. ``full``: whether the link was the limit; else
    it carries at least that.
    """
    seconds = min(_MAX_S, max(0.01, float(request["seconds"])))
    rate = max(1.0, float(request["rate_bytes_per_s"]))
    address, port = str(request["address"]), int(request["port"])
    peer = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_STREAM)
    try:
        peer.settimeout(_CONNECT_S)
        peer.connect((address, port))
        peer.sendall(request["token"].encode() + b"\n")
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        peer.setsockopt(socket.IPPROTO_TCP, _NOT_SENT_LOW_WATER, _BLOCK_BYTES)
        peer.setsockopt(socket.SOL_SOCKET, _MAX_PACING_RATE, min(int(rate), 0x7FFFFFFF))
        peer.setblocking(False)
        return _send_and_watch(peer, seconds, min(_MAX_BYTES, int(rate * seconds)))
    except OSError as error:
        message = "cannot send to %s port %s: %s" % (address, port, error)
        raise RefusalError("no-path", message, "check that the robot's firewall allows this port") from None
    finally:
        peer.close()


def _send_and_watch(peer: "socket.socket", seconds: float, most: int) -> Document:
    """Send up to ``most`` bytes and note when which of them were confirmed."""
    block, poll = bytes(_BLOCK_BYTES), select.poll()
    poll.register(peer, select.POLLOUT)
    began = time.monotonic()
    left, first = most, _read_info(peer)
    # (time, bytes confirmed), once for each time that the number grew; of them the first with the path full.
    seen = [(began, _count_acked(first))]
    full = 0
    end = seen[0][1] + most
    while time.monotonic() - began < seconds and seen[-1][1] < end:
        if left > 0 and poll.poll(_LOOK_S * 1000):
            left -= _send(peer, block[: min(left, _BLOCK_BYTES)])
        time.sleep(_LOOK_S)
        info = _read_info(peer)
        if _count_acked(info) > seen[-1][1]:
            seen.append((time.monotonic(), _count_acked(info)))
            full = full or (len(seen) - 1 if link_rate.is_path_full(info) else 0)
    return _summarize(seen, full)


def _send(peer: "socket.socket", data: bytes) -> int:
    try:
        return peer.send(data)
    except BlockingIOError:
        return 0


def _read_info(peer: "socket.socket") -> bytes:
    return peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO_BYTES)


def _count_acked(info: bytes) -> int:
    return int(struct.unpack_from("=Q", info, _ACKED_AT)[0]) if len(info) >= _ACKED_AT + 8 else 0


def _summarize(seen: "list[tuple[float, int]]", full: int) -> Document:
    """Summarize confirmations: the rate since entry ``full``, at which the limit was met.

    Without a limit that of the second half: a shaped link lets a first burst pass.
    """
    middle = (seen[0][0] + seen[-1][0]) / 2
    start = full or next(number for number, entry in enumerate(seen) if entry[0] >= middle)
    seconds, count = seen[-1][0] - seen[start][0], seen[-1][1] - seen[start][1]
    known = seconds >= _MIN_TAIL_S and count >= _MIN_TAIL_BYTES
    return {"bytes_per_s": round(count / seconds, 1) if known else None, "full": bool(full)}
