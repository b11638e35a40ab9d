# SPDX-License-Identifier: Apache-2.0
"""Present capacity of a link, by the kernel's account of a connection that the network limits.

A sender that always has data to send learns what the path carries. tcp_info says when that is so: its
delivery rate with the flag that the application was the limit (Linux 4.9), and the time during which data was
under way or waited for the receiver or for the send buffer (4.10). Nothing is sent for it.
"""

from .sockets import struct

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .network import Flow

# Offsets in struct tcp_info.
_FLAGS_AT, _RTT_AT, _THRESHOLD_AT, _MIN_RTT_AT = 7, 68, 76, 148
_DELIVERY_AT, _BUSY_AT, _BUSY_END = 160, 168, 192
_APP_LIMITED = 1
# The slow-start threshold of a connection that has met no limit yet.
_NO_THRESHOLD = 0x7FFFFFFF
# Share of a window from which a connection counts as sending all the time; in it, the share of waits for the
# receiver or the send buffer up to which the network is the limit.
_BUSY_SHARE, _MAX_WAIT_SHARE = 0.8, 0.2
_MIN_BYTES, _MIN_BUSY_S = 32768, 0.2


class Sender:
    """Sending end of a connection in a window.

    ``limited``: the network was its limit. ``busy_s``: how long data was under way. ``delivery``: bytes/s at
    which the last full flight arrived, 0 where unknown.
    """

    __slots__ = ("busy_s", "delivery", "limited")

    def __init__(self, limited: bool = False, busy_s: float = 0.0, delivery: float = 0.0) -> None:
        self.limited, self.busy_s, self.delivery = limited, busy_s, delivery


def compare_senders(then: bytes, now: bytes, sent: int) -> Sender:
    """Compare the tcp_info of a connection at the begin (empty: not there yet) and the end of a window in
    which ``sent`` bytes arrived.

    The kernel keeps the last delivery rate for ever, so one that has not changed in the window says nothing;
    nor does one of a connection that was still probing upwards.
    """
    if len(now) < _DELIVERY_AT + 8 or sent < _MIN_BYTES or now[_FLAGS_AT] & _APP_LIMITED:
        return Sender()
    delivery, before = _read_delivery(now), _read_delivery(then)
    if delivery == before:
        return Sender()
    (busy_s, waited_s), (busy_before, waited_before) = _read_busy(now), _read_busy(then)
    busy_s, waited_s = busy_s - busy_before, waited_s - waited_before
    if waited_s > _MAX_WAIT_SHARE * busy_s:
        return Sender()
    if busy_s < _MIN_BUSY_S and struct.unpack_from("=I", now, _THRESHOLD_AT)[0] >= _NO_THRESHOLD:
        return Sender()
    return Sender(True, busy_s, float(delivery))


def _read_delivery(info: bytes) -> int:
    return int(struct.unpack_from("=Q", info, _DELIVERY_AT)[0]) if len(info) >= _DELIVERY_AT + 8 else 0


def _read_busy(info: bytes) -> "tuple[float, float]":
    """Read (seconds with data under way, those of it that waited for receiver or send buffer).

    0 on old kernels.
    """
    if len(info) < _BUSY_END:
        return 0.0, 0.0
    busy, receiver, buffer = struct.unpack_from("=QQQ", info, _BUSY_AT)
    return busy / 1e6, (receiver + buffer) / 1e6


def estimate_rate(flows: "list[Flow]", seconds: float) -> "float | None":
    """Estimate the bytes/s (in plus out) that the link of ``flows`` carries; None where nothing limits them.

    All of its traffic, where a connection sends all the time. A connection that sends in bursts leaves room
    between them: what its last burst was delivered at, if that is more.
    """
    limited = [flow.sender for flow in flows if flow.sender.limited]
    if not limited:
        return None
    total = sum(flow.rx + flow.tx for flow in flows) / seconds
    if any(sender.busy_s >= _BUSY_SHARE * seconds for sender in limited):
        return round(total, 1)
    return round(max(total, *(sender.delivery for sender in limited)), 1)


def is_path_full(info: bytes) -> bool:
    """Whether a sender has met the limit of its path: a loss, the end of its slow start, or a queue."""
    if len(info) < _MIN_RTT_AT + 4:
        return False
    rtt, least = struct.unpack_from("=I", info, _RTT_AT)[0], struct.unpack_from("=I", info, _MIN_RTT_AT)[0]
    return bool(struct.unpack_from("=I", info, _THRESHOLD_AT)[0] < _NO_THRESHOLD or rtt > 2 * least + 2000)
