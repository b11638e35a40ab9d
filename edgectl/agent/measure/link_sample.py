# SPDX-License-Identifier: Apache-2.0
"""Operation ``sample-link``: rate of an idle link, by sending to a sink for a tenth of a second at most.

Bounded in time, in bytes and in rate. The kernel sends what was handed to it while this program waits for its
turn on a busy host, and counts the time in which it had anything to send and the receiver took it. The
connection is reset at its end: what is still in the send buffer is dropped, and what is then under way is at
most twice what has arrived.
"""

import select
import struct
import time

from ..link.errors import RefusalError
from ..link.fast_json import Document
from . import link_rate
from .sockets import socket

_MAX_S, _CONNECT_S, _LOOK_S = 0.1, 1.0, 0.001
# As much as the kernel allows without rights: so much is handed over at once.
_BUFFER_BYTES = 212_992
_MAX_BYTES = 1 << 27
_INFO_BYTES = 192
# Options of Linux that module socket does not name before Python 3.12, or at all.
_CONGESTION, _MAX_PACING_RATE = 13, 47
# In every kernel, and for everybody: it fills the queue of a link, which BBR never does.
_RENO = b"reno"
# What is measured after the limit was met is a rate from so many bytes and seconds on.
_MIN_TAIL_BYTES, _MIN_TAIL_S = 4096, 0.02
# Shares: of the rate that was asked for, below which it is not the limit; by which a steady rate varies; of
# the moments at which the device is the limit.
_LIMITED_SHARE, _STEADY_SHARE, _HELD_SHARE = 0.9, 0.15, 0.5
# Bytes that were confirmed at once are a burst from so many on, after silence for this share of the time
# since the moment before.
_MIN_BURST_BYTES, _SILENT_SHARE = 8192, 0.5


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
        peer.setsockopt(socket.IPPROTO_TCP, _CONGESTION, _RENO)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        peer.setsockopt(socket.SOL_SOCKET, _MAX_PACING_RATE, min(int(rate), 0x7FFFFFFF))
        peer.setblocking(False)
        return _send_and_watch(peer, seconds, rate)
    except OSError as error:
        message = "cannot send to %s port %s: %s" % (address, port, error)
        raise RefusalError("no-path", message, "check that the robot's firewall allows this port") from None
    finally:
        peer.close()


class Moment:
    """What TCP had done after ``seconds`` in which it could send: ``count`` bytes confirmed.

    ``held``: its own device was the limit, or the rate that was asked for. ``burst``: much was confirmed at
    once, after none for most of the time since the moment before, although somebody looked.
    """

    __slots__ = ("burst", "count", "held", "seconds")

    def __init__(self, count: int, seconds: float, held: bool, burst: bool = False) -> None:
        self.count, self.seconds, self.held, self.burst = count, seconds, held, burst


def _send_and_watch(peer: "socket.socket", seconds: float, rate: float) -> Document:
    """Send up to ``rate`` for ``seconds`` and note when which bytes were confirmed."""
    left = most = min(_MAX_BYTES, int(rate * seconds))
    block, poll = bytes(_BUFFER_BYTES), select.poll()
    poll.register(peer, select.POLLOUT)
    began = time.monotonic()
    # A moment for each time that more was confirmed; of them the first with the path full.
    seen, full = [_note_moment(_read_info(peer))], 0
    end = seen[0].count + most
    changed = looked = began
    while time.monotonic() - began < seconds and seen[-1].count < end:
        if left > 0 and poll.poll(_LOOK_S * 1000):
            left -= _send(peer, block[: min(left, _BUFFER_BYTES)])
        time.sleep(_LOOK_S)
        info = _read_info(peer)
        moment = _note_moment(info)
        now = time.monotonic()
        if moment.count > seen[-1].count:
            silent = looked - changed > _SILENT_SHARE * (now - changed)
            moment.burst = silent and moment.count - seen[-1].count >= _MIN_BURST_BYTES
            seen.append(moment)
            full = full or (len(seen) - 1 if link_rate.is_path_full(info) else 0)
            changed = now
        looked = now
    return summarize_moments(seen, full, rate)


def _note_moment(info: bytes) -> Moment:
    return Moment(*link_rate.read_progress(info), link_rate.is_device_full(info))


def _send(peer: "socket.socket", data: bytes) -> int:
    try:
        return peer.send(data)
    except BlockingIOError:
        return 0


def _read_info(peer: "socket.socket") -> bytes:
    return peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO_BYTES)


def summarize_moments(seen: "list[Moment]", full: int, rate: float) -> Document:
    """Summarize confirmations: the rate since entry ``full``, at which the limit was met.

    Without a limit that of the second half: a shaped link lets a first burst pass. If that was steady, with
    the device as the limit and below ``rate``, the link was the limit.
    """
    middle = (seen[0].seconds + seen[-1].seconds) / 2
    half = seen[next(number for number, entry in enumerate(seen) if entry.seconds >= middle) :]
    start = full or len(seen) - len(half)
    tail = seen[start:]
    found = (
        _compute_rate(seen[start - 1 : -1], tail)
        if start and _is_in_bursts(tail)
        else _compute_rate(tail, tail)
    )
    steady = found is not None and not full and _is_steady(half, found) and found < _LIMITED_SHARE * rate
    return {"bytes_per_s": None if found is None else round(found, 1), "full": bool(full) or steady}


def _is_in_bursts(tail: "list[Moment]") -> bool:
    """Whether most of this was confirmed in bursts.

    A shaper lets a large segment of TCP pass whole, and then the link rests for as long as that should have
    taken. While TCP begins, each burst is larger than the one before: what passed in the time between two is
    the first of them.
    """
    return sum(moment.burst for moment in tail) > len(tail) / 2


def _compute_rate(counted: "list[Moment]", timed: "list[Moment]") -> "float | None":
    """The rate of what was confirmed from the first to the last moment, by the times of others."""
    seconds, count = timed[-1].seconds - timed[0].seconds, counted[-1].count - counted[0].count
    return count / seconds if seconds >= _MIN_TAIL_S and count >= _MIN_TAIL_BYTES else None


def _is_steady(half: "list[Moment]", rate: float) -> bool:
    """Whether both halves of these moments have this rate, with the device as the limit of both.

    A sender that still finds out how fast it may send doubles its rate with each round trip.
    """
    middle = half[len(half) // 2]
    first = (middle.count - half[0].count) / max(1e-6, middle.seconds - half[0].seconds)
    held = sum(moment.held for moment in half)
    return abs(first / rate - 1.0) <= _STEADY_SHARE and held >= _HELD_SHARE * len(half)
