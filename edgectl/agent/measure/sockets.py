# SPDX-License-Identifier: Apache-2.0
"""TCP connections with their byte counters, queried from the kernel (NETLINK_SOCK_DIAG): no tool needs to be
installed.
"""

import sys

from . import proc

try:
    # Module socket imports enum and selectors, several ms of CPU.
    import _socket as socket
except ImportError:
    import socket  # type: ignore[no-redef]

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from collections.abc import Set as AbstractSet

__all__ = [
    "CloseListener",
    "TcpConnection",
    "count_opened",
    "list_connections",
    "look_up_connections",
    "pack_address",
    "read_number",
    "read_rtt_ms",
    "socket",
    "unmap_address",
]

_NETLINK_SOCK_DIAG = 4
_TCPDIAG_GETSOCK, _SOCK_DIAG_BY_FAMILY = 18, 20
_REQUEST_FLAG, _DUMP_FLAGS = 1, 0x301  # NLM_F_REQUEST, and with NLM_F_DUMP
_DONE, _ERROR = 3, 2
_LOOPBACK_V4, _LOOPBACK_V6, _MAPPED = 127, bytes(15) + b"\1", bytes(10) + b"\xff\xff"
_TCP_DESTROYED = 0b101  # groups SKNLGRP_INET_TCP_DESTROY and SKNLGRP_INET6_TCP_DESTROY
_INET_DIAG_INFO = 2
_EXT_INFO = 1 << (_INET_DIAG_INFO - 1)
_LISTEN, _TIME_WAIT = 10, 6
_STATES = 0xFFF & ~(1 << _LISTEN) & ~(1 << _TIME_WAIT)
# Offsets in struct tcp_info; the byte counters came with Linux 4.1.
_RTT_AT, _BYTES_AT, _BYTES_END = 68, 120, 136
_HEAD, _MESSAGE = 16, 72
# In struct inet_diag_msg.
_REMOTE_PORT, _COOKIE = slice(6, 8), slice(44, 52)
# Since Linux 4.12; the same number on all machines but SPARC and PA-RISC.
_SO_COOKIE = 57
# The longest wait for the report of a closed socket, s; idle, it takes 50 us.
_REPORT_S = 0.05
# Of struct inet_diag_sockid in an answer: ports, addresses, interface and cookie.
_ID_AT, _ID_END = 4, 52
# A connection that is looked up is gone: ENOENT, ESTALE.
_GONE = (-2, -116)
# So many look-ups, of 5 us each, are cheaper than to go through the kernel's table.
MOST_LOOK_UPS = 32
# The kernel sends 32 KiB at most. Above 128 KiB, the C library would ask for new pages each time.
_MOST_BYTES = 1 << 16
# An answer of one connection takes 500 bytes, the refusal of a question its own length more.
_ANSWER_BYTES = 1 << 12


class TcpConnection:
    """One TCP connection.

    ``key`` identifies it for its whole life, ``inode`` its socket; ``local`` and ``remote`` are (address,
    port). ``rx`` and ``tx``: bytes since it was opened; ``rtt_ms``: 0 where unmeasured. ``info``: its struct
    tcp_info.
    """

    __slots__ = ("family", "identity", "info", "inode", "key", "local", "remote", "rtt_ms", "rx", "tx")

    def __init__(self, message: bytes) -> None:
        """``message``: a struct inet_diag_msg with its attributes."""
        family, info = message[0], _find_tcp_info(message)
        self.family, self.identity = family, message[_ID_AT:_ID_END]
        self.local = (_format_address(family, message[8:24]), int.from_bytes(message[4:6], "big"))
        self.remote = (_format_address(family, message[24:40]), int.from_bytes(message[6:8], "big"))
        self.key, self.inode, self.info = message[_COOKIE], read_number(message, 68), info
        self.rtt_ms = read_number(info, _RTT_AT) / 1000.0
        self.tx = self.rx = 0
        if len(info) >= _BYTES_END:
            self.tx, self.rx = read_number(info, _BYTES_AT, 8), read_number(info, _BYTES_AT + 8, 8)


def read_number(data: bytes, at: int, size: int = 4) -> int:
    """Read an unsigned number in the byte order of this machine; 0 where ``data`` ends before it.

    Module struct is a library of its own in many builds of Python: 0.15 ms.
    """
    return int.from_bytes(data[at : at + size], sys.byteorder) if len(data) >= at + size else 0


def count_opened(counters: bytes) -> "int | None":
    """Count the connections that this network namespace has opened and accepted since boot.

    ``counters`` as ``proc.read_network_counters``. None where unknown. Each is counted within the call by
    which it comes to be.
    """
    found = proc.find_counters(counters, b"Tcp")
    try:
        return int(found[b"ActiveOpens"]) + int(found[b"PassiveOpens"])
    except (KeyError, ValueError):
        return None


def list_connections(wanted: "AbstractSet[bytes]" = frozenset()) -> "list[TcpConnection]":
    """List the TCP connections of this network namespace, IPv4 and IPv6.

    Empty where the kernel does not answer. Connections to loopback addresses only where the remote address is
    in ``wanted`` (packed): a machine that hosts a whole test fleet has thousands of them, and decoding one
    takes longer than the kernel needs to list it.
    """
    try:
        messages = _query_kernel()
    except OSError:
        return []
    return [TcpConnection(message) for message in messages if _is_relevant(message, wanted)]


def _query_kernel() -> "list[bytes]":
    """Query both families by the older of the two requests, struct inet_diag_req: the other one has to go
    twice through the kernel's table of connections, 0.2 ms each time where that has 262,144 buckets.
    """
    body = bytes((socket.AF_UNSPEC, 0, 0, _EXT_INFO)) + bytes(48) + _pack_number(_STATES) + bytes(4)
    found: "list[bytes]" = []
    link = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_SOCK_DIAG)
    try:
        link.settimeout(2.0)
        link.sendto(_build_message(_TCPDIAG_GETSOCK, _DUMP_FLAGS, body), (0, 0))
        while True:
            for kind, message in _split_messages(link.recv(_MOST_BYTES)):
                if kind in (_DONE, _ERROR):
                    return found
                found.append(message)
    finally:
        link.close()


def look_up_connections(known: "Collection[TcpConnection]") -> "list[TcpConnection] | None":
    """Look up connections that were listed before, as they are now, without those that are gone.

    None where the kernel does not answer, or has another reason not to tell. The cookie of a connection is
    part of the question, so that none is taken for one that was opened later between the same ends.
    """
    if not known:
        return []
    questions = [
        bytes((each.family, socket.IPPROTO_TCP, _EXT_INFO, 0)) + _pack_number(_STATES) + each.identity
        for each in known
    ]
    link = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_SOCK_DIAG)
    try:
        link.settimeout(2.0)
        link.sendto(
            b"".join(_build_message(_SOCK_DIAG_BY_FAMILY, _REQUEST_FLAG, each) for each in questions), (0, 0)
        )
        # Each answer comes by itself.
        answers = [answer for _ in questions for answer in _split_messages(link.recv(_ANSWER_BYTES))]
    except OSError:
        return None
    finally:
        link.close()
    refusals = [message for kind, message in answers if kind == _ERROR]
    if any(int.from_bytes(each[:4], sys.byteorder, signed=True) not in _GONE for each in refusals):
        return None
    found = [message for kind, message in answers if kind == _SOCK_DIAG_BY_FAMILY]
    # What is left of a closed connection (TIME-WAIT) has its cookie; the kernel shows it, whatever was asked.
    return [TcpConnection(message) for message in found if 1 << message[1] & _STATES]


def _build_message(kind: int, flags: int, body: bytes) -> bytes:
    """Build a message of netlink."""
    head = _pack_number(_HEAD + len(body)) + _pack_number(kind, 2) + _pack_number(flags, 2)
    return head + _pack_number(1) + bytes(4) + body


def _pack_number(value: int, size: int = 4) -> bytes:
    return value.to_bytes(size, sys.byteorder)


class CloseListener:
    """Listener for closed connections: the kernel reports them with their last counters (since Linux 4.3)."""

    def __init__(self, wanted: "AbstractSet[bytes]" = frozenset()) -> None:
        self._link: "socket.socket | None" = None
        self._wanted = wanted
        # What was reported before the end of this socket is of no interest; b"": all of it is.
        self._mark = b""
        try:
            self._link = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_SOCK_DIAG)
            self._link.bind((0, _TCP_DESTROYED))
        except OSError:
            self.close()

    def close(self) -> None:
        """Stop listening."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def forget(self) -> None:
        """Forget the connections closed until now, without a wait for the reports of the kernel."""
        self._mark = b"" if self._link is None else _close_socket()

    def collect(self) -> "list[TcpConnection]":
        """Collect the connections closed since the last call.

        The kernel reports them a moment later, on a busy host a long one; so a socket is closed whose report
        comes after theirs.
        """
        found: "list[TcpConnection]" = []
        marker = b"" if self._link is None else _close_socket()
        while self._link is not None:
            try:
                self._link.settimeout(_REPORT_S if marker else 0.0)
                data = self._link.recv(_MOST_BYTES)
            except OSError:
                break
            for kind, message in _split_messages(data):
                if message[_COOKIE] == marker:
                    marker = b""
                elif message[_COOKIE] == self._mark:
                    found.clear()
                # A socket that was never connected is a marker, perhaps of another agent.
                elif kind == _SOCK_DIAG_BY_FAMILY and message[_REMOTE_PORT] != b"\0\0":
                    found += [TcpConnection(message)] if _is_relevant(message, self._wanted) else []
        self._mark = b""
        return found


def _close_socket() -> bytes:
    """Open and close a TCP socket; the key of its report, b"" where there is none."""
    try:
        opened = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    except OSError:
        return b""
    try:
        return bytes(opened.getsockopt(socket.SOL_SOCKET, _SO_COOKIE, 8))
    except OSError:
        return b""
    finally:
        opened.close()


def pack_address(address: str) -> bytes:
    """Convert an address to the form that ``list_connections`` takes."""
    return socket.inet_pton(socket.AF_INET6 if ":" in address else socket.AF_INET, address)


def _is_relevant(message: bytes, wanted: "AbstractSet[bytes]") -> bool:
    """Whether the connection leaves this host or its remote address is wanted."""
    remote = message[24:40]
    if message[0] == socket.AF_INET or remote.startswith(_MAPPED):
        remote = remote[:4] if message[0] == socket.AF_INET else remote[12:]
        return remote[0] != _LOOPBACK_V4 or remote in wanted
    return remote != _LOOPBACK_V6 or remote in wanted


def _split_messages(data: bytes) -> "Iterator[tuple[int, bytes]]":
    at = 0
    while at + _HEAD <= len(data):
        length, kind = read_number(data, at), read_number(data, at + 4, 2)
        if length < _HEAD:
            return
        yield kind, data[at + _HEAD : at + length]
        at += (length + 3) & ~3


def _format_address(family: int, raw: bytes) -> str:
    if family == socket.AF_INET:
        return socket.inet_ntop(socket.AF_INET, raw[:4])
    return unmap_address(socket.inet_ntop(socket.AF_INET6, raw))


def unmap_address(text: str) -> str:
    """Convert an IPv4-mapped IPv6 address to IPv4; any other address is unchanged."""
    return text[7:] if text.startswith("::ffff:") and "." in text else text


def _find_tcp_info(message: bytes) -> bytes:
    at = _MESSAGE
    while at + 4 <= len(message):
        length, kind = read_number(message, at, 2), read_number(message, at + 2, 2)
        if length < 4:
            break
        if kind == _INET_DIAG_INFO:
            return message[at + 4 : at + length]
        at += (length + 3) & ~3
    return b""


def read_rtt_ms(connection: "socket.socket") -> float:
    """Read the round-trip time of an open connection of this process; 0 where unknown."""
    try:
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _RTT_AT + 4)
    except OSError:
        return 0.0
    return read_number(info, _RTT_AT) / 1000.0
