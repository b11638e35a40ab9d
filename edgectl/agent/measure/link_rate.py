# SPDX-License-Identifier: Apache-2.0
"""Present capacity of a link, by the kernel's account of a connection that the network limits.

A sender that always has data to send learns what the path carries. tcp_info says when that is so: its
delivery rate with the flag that the application was the limit (Linux 4.9), the segments under way, and the
time during which data was, or waited for the receiver or for the send buffer (4.10). Nothing is sent for it.
"""

from .sockets import read_number

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .network import Flow

# Offsets in struct tcp_info.
_FLAGS_AT, _UNACKED_AT, _RTT_AT, _THRESHOLD_AT, _WINDOW_AT, _MIN_RTT_AT = 7, 24, 68, 76, 80, 148
_NOT_SENT_AT = 144
_ACKED_AT, _DELIVERY_AT, _BUSY_AT, _BUSY_END = 120, 160, 168, 192
_APP_LIMITED = 1
# The slow-start threshold of a connection that has met no limit yet.
_NO_THRESHOLD = 0x7FFFFFFF
# Share of a window from which a connection counts as sending all the time; in it, the share of waits for the
# receiver or the send buffer up to which the network is the limit.
_BUSY_SHARE, _MAX_WAIT_SHARE = 0.9, 0.2
_MIN_BYTES = 32768
# The last segment of a burst is acknowledged up to 40 ms late (two: at once), so that the rate of that
# delivery is too low, however fast the link: one counts while more are under way.
_MIN_UNDER_WAY = 3


class Sender:
    """Sending end of a connection in a window.

    ``limited``: the network was its limit. ``steady``: at both ends of the window. ``busy_s``: how long data
    was under way. ``delivery``: bytes/s at which a flight arrived in the middle of a burst, 0 where unknown.
    """

    __slots__ = ("busy_s", "delivery", "limited", "steady")

    def __init__(
        self, limited: bool = False, steady: bool = False, busy_s: float = 0.0, delivery: float = 0.0
    ) -> None:
        self.limited, self.steady, self.busy_s, self.delivery = limited, steady, busy_s, delivery


def compare_senders(then: bytes, now: bytes, sent: int) -> Sender:
    """Compare the tcp_info of a connection at the begin (empty: not there yet) and the end of a window in
    which ``sent`` bytes arrived.

    A burst that fills no queue is limited by how fast TCP begins, and not by the link.
    """
    if sent < _MIN_BYTES:
        return Sender()
    ends = [info for info in (then, now) if _is_under_way(info)]
    (busy_s, waited_s), (busy_before, waited_before) = _read_busy(now), _read_busy(then)
    busy_s, waited_s = busy_s - busy_before, waited_s - waited_before
    if not ends or waited_s > _MAX_WAIT_SHARE * busy_s:
        return Sender()
    delivery = max([0, *(_read_delivery(info) for info in ends if _has_queue(info))])
    return Sender(True, len(ends) == 2, busy_s, float(delivery))


def _is_under_way(info: bytes) -> bool:
    """Whether the sender has more to send than was acknowledged, and would send it faster."""
    if len(info) < _DELIVERY_AT + 8 or info[_FLAGS_AT] & _APP_LIMITED:
        return False
    return read_number(info, _UNACKED_AT) >= _MIN_UNDER_WAY


def _read_delivery(info: bytes) -> int:
    return read_number(info, _DELIVERY_AT, 8)


def _read_busy(info: bytes) -> "tuple[float, float]":
    """Read (seconds with data under way, those of it that waited for receiver or send buffer).

    0 on old kernels.
    """
    if len(info) < _BUSY_END:
        return 0.0, 0.0
    busy, receiver, buffer = (read_number(info, at, 8) for at in range(_BUSY_AT, _BUSY_END, 8))
    return busy / 1e6, (receiver + buffer) / 1e6


def read_progress(info: bytes) -> "tuple[int, float]":
    """Read (bytes confirmed, seconds in which data was under way or waited, and the receiver had room)."""
    if len(info) < _ACKED_AT + 8:
        return 0, 0.0
    busy, receiver = (
        read_number(info, at, 8) if len(info) >= _BUSY_END else 0 for at in (_BUSY_AT, _BUSY_AT + 8)
    )
    return read_number(info, _ACKED_AT, 8), (busy - receiver) / 1e6


def estimate_rate(flows: "list[Flow]", seconds: float) -> "float | None":
    """Estimate the bytes/s (in plus out) that the link of ``flows`` carries; None where nothing limits them.

    All of its traffic, where a connection sends all the time. A connection that sends in bursts leaves room
    between them: what a burst was delivered at, if that is more.
    """
    limited = [flow.sender for flow in flows if flow.sender.limited]
    total = sum(flow.rx + flow.tx for flow in flows) / seconds
    if any(sender.steady and sender.busy_s >= _BUSY_SHARE * seconds for sender in limited):
        return round(total, 1)
    delivery = max([0.0, *(sender.delivery for sender in limited)])
    return round(max(total, delivery), 1) if delivery else None


def is_path_full(info: bytes) -> bool:
    """Whether a sender has met the limit of its path: a loss, the end of its slow start, or a queue."""
    if len(info) < _MIN_RTT_AT + 4:
        return False
    return _has_queue(info) or read_number(info, _THRESHOLD_AT) < _NO_THRESHOLD


def is_device_full(info: bytes) -> bool:
    """Whether a sender has data and may send it, and the queue of its own device lets it wait."""
    if len(info) < _NOT_SENT_AT + 4:
        return False
    under_way, window = read_number(info, _UNACKED_AT), read_number(info, _WINDOW_AT)
    return bool(under_way < window and read_number(info, _NOT_SENT_AT))


def _has_queue(info: bytes) -> bool:
    """Whether round trips take longer than they did without a queue."""
    return read_number(info, _RTT_AT) > 2 * read_number(info, _MIN_RTT_AT) + 2000
