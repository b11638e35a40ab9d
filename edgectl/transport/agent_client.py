# SPDX-License-Identifier: Apache-2.0
"""Client of the agent protocol: one constant command line, a request on standard input, a framed reply.

A login shell may print anything before and after (MOTD, rc files, banners). Only a frame with the random
marker of this request, its length and its SHA-256 counts, so noise never changes a reading.
"""

import hashlib
import json
import re
import secrets
import shlex
import time
import zlib
from collections.abc import Iterator, Mapping
from functools import cache

from edgectl.agent.link import protocol
from edgectl.errors import DeadlineError, NoPythonError, RefusedError, ReplyError
from edgectl.model.inventory import Host
from edgectl.model.text import clean_text
from edgectl.transport.agent_archive import AGENT_DIR, build_agent_zipapp, compute_agent_hash, read_program
from edgectl.transport.base import Reply, Session, Transport, trace_call

# No newline, quote, backslash or exclamation mark: between single quotes it is safe in sh, bash, zsh, fish
# and tcsh. The alarm ends an agent whose program never arrives (a dead connection); the program then sets the
# deadline.
_BOOTSTRAP = "import sys,_signal;_signal.alarm(30);s=sys.stdin.buffer;exec(s.read(int(s.readline())))"
FRAME_MARK = b"\nedgectl-frame "
# The frame, and one that a login shell may print again.
_MAX_FRAMES = 2
_NOT_FOUND_PATTERN = re.compile(
    rb"not found|no such file or directory|unknown command|cannot execute", re.IGNORECASE
)
_TOO_OLD_PATTERN = re.compile(rb"unknown option:? -[IS]", re.IGNORECASE)
# Comments and docstrings of the programs that travel with each request: a third of them.
_NOTE_PATTERN = re.compile(rb'^ *(?:#.*|"""[^"]*""")\n|  # .*', re.MULTILINE)
# Of the reason of a refusal, characters.
_MAX_MESSAGE = 1000
# Of the length of a chunk of a log, digits.
_MAX_HEAD_BYTES = 7
# By fleet; without one the compiled agent is used by this process alone.
_CACHE_KEYS: dict[str, str] = {}
_PROCESS_KEY = secrets.token_hex(16)
_PYTHON_HINT = "install python3 (3.6 or later) on the host"


def build_agent_command(python: str) -> str:
    """The only command line that is ever run on a host: it reads a program from standard input and runs it.

    Isolated (-I) and without ``site`` (-S): no user or site code runs, and the start takes a third less time.
    """
    return f"exec {shlex.quote(python)} -I -S -c '{_BOOTSTRAP}'"


def use_cache_key(fleet: str, key: str) -> None:
    """Seal the compiled agent on the hosts of ``fleet`` with ``key``, letters and digits (ADR 57)."""
    _CACHE_KEYS[fleet] = key


@cache
def _read_boot_programs() -> bytes:
    """The first program, and the other two packed, each after its length; few hosts unpack them."""
    sources = (read_program(AGENT_DIR / "link" / name) for name in ("first.py", "stub.py", "boot.py"))
    first, *others = (_NOTE_PATTERN.sub(b"", source) for source in sources)
    programs = (first, zlib.compress(b"\0".join(others), 9))
    return b"".join(b"%d\n%s" % (len(text), text) for text in programs)


def build_packet(request: Mapping[str, object], marker: str, timeout: float, agent: bytes = b"") -> bytes:
    """The standard input of one request: programs, head, request, and ``agent``, compressed."""
    return _read_boot_programs() + build_conversed_packet(request, marker, timeout, agent)


def build_conversed_packet(
    request: Mapping[str, object], marker: str, timeout: float, agent: bytes = b""
) -> bytes:
    """`build_packet` without the programs, which an agent that stays does not need."""
    body = json.dumps(request, allow_nan=False).encode()
    key = _CACHE_KEYS.get(str(request.get("fleet")), _PROCESS_KEY)
    operation = request["op"] if protocol.is_name(request.get("op")) else "unknown"
    packed = _pack_agent(agent) if agent else b""
    head = f"{marker} {compute_agent_hash()} {len(body)} {len(packed)} {timeout:.3f} {key} {operation}\n"
    return head.encode() + body + packed


@cache
def _pack_agent(agent: bytes) -> bytes:
    """The agent as it travels: 700 kB would take 22 s at 256 kbit/s, longer than a request may."""
    return zlib.compress(agent)


def prepare_requests() -> None:
    """Read what every request carries, 5 to 10 ms once per process: while the first logins are under way."""
    _read_boot_programs()
    compute_agent_hash()


def call_agent(
    session: Session, request: Mapping[str, object], *, timeout: float, data: bytes = b""
) -> dict[str, object]:
    """Carry out ``request`` on the host; the agent is sent only where the host does not have it yet.

    ``data``: bytes that the operation reads after its request.

    Raises:
        RefusedError: the agent declined.
        NoPythonError: no python3, or one older than 3.6.
        ReplyError: no valid frame in the answer.
        DeadlineError: no reply within ``timeout`` seconds of one round trip; the host gives up by itself
            then.
        ConnectError: the connection was lost.
    """
    with trace_call(str(request.get("host", "")), str(request["op"]), str(request.get("task") or "")):
        reply = _send_request(session, request, timeout, b"", data)
        if reply.get("missing") is True:
            reply = _send_request(session, request, timeout, build_agent_zipapp(), data)
        return check_reply(reply)


def ask_host(
    transport: Transport, host: Host, request: Mapping[str, object], *, timeout: float, connect_timeout: float
) -> dict[str, object]:
    """Connect to ``host`` and carry out one request, each within its own time-out (s).

    Raises:
        HostError: as `Transport.connect` and `call_agent`.
    """
    with transport.connect(host, timeout=connect_timeout) as session:
        return call_agent(session, request, timeout=timeout)


def _send_request(
    session: Session, request: Mapping[str, object], timeout: float, agent: bytes, data: bytes
) -> dict[str, object]:
    marker, began = secrets.token_hex(16), time.monotonic()
    answer = session.run(
        build_agent_command(session.python),
        build_packet(request, marker, timeout, agent) + data,
        timeout=timeout,
        limit=protocol.MAX_REPLY_BYTES,
    )
    payload = find_payload(answer.stdout, marker)
    if payload is None and time.monotonic() - began >= timeout:
        # The host's own deadline was seen before ours.
        raise DeadlineError(f"no answer within {timeout:.3g} s")
    if payload is None:
        raise build_frame_error(answer)
    return parse_reply_json(payload)


def check_reply(reply: dict[str, object]) -> dict[str, object]:
    """The reply; raises the error that it states."""
    if reply.get("too_old") is True:
        raise NoPythonError(
            f"python on the host is {clean_text(reply.get('python'), 40)}, 3.6 or later is needed",
            hint=_PYTHON_HINT,
        )
    if reply.get("missing") is True:
        raise ReplyError("the agent arrived damaged on the host")
    error = reply.get("error")
    if error is None:
        return reply
    if not isinstance(error, dict):
        raise ReplyError("the agent's error is not an object")
    raise RefusedError(
        clean_text(error.get("message") or "the host refused, without a reason", _MAX_MESSAGE),
        hint=clean_text(error.get("hint") or "", _MAX_MESSAGE),
    )


def find_payload(stdout: bytes, marker: str) -> bytes | None:
    """The payload of the frame with our marker and correct digest; None if there is none or two differ.

    What a frame encloses is its payload. Only two frames are looked at: an agent sends one, and thousands,
    one within the other, would fill our memory.
    """
    mark = FRAME_MARK + marker.encode() + b" "
    payload, at = None, stdout.find(mark)
    for _ in range(_MAX_FRAMES):
        if at < 0:
            return payload
        found = _parse_frame_at(stdout, at + len(mark))
        if found is not None and payload is not None and found != payload:
            return None
        payload = payload if found is None else found
        at = stdout.find(mark, at + len(mark) + len(found or b""))
    return payload if at < 0 else None


def split_frame(buffer: bytes, marker: str) -> tuple[bytes, bytes] | None:
    """The payload of the first frame with this marker and what follows it; None until all of it has come."""
    mark = FRAME_MARK + marker.encode() + b" "
    at = buffer.find(mark)
    payload = _parse_frame_at(buffer, at + len(mark)) if at >= 0 else None
    end = buffer.find(b"\n", at + len(mark)) + 1 + len(payload or b"")
    if payload is None or buffer[end : end + 1] != b"\n":
        return None
    return payload, buffer[end + 1 :]


def _parse_frame_at(text: bytes, at: int) -> bytes | None:
    match = re.compile(rb"([0-9]{1,8}) ([0-9a-f]{64})\n").match(text, at)
    if match is None:
        return None
    payload = text[match.end() : match.end() + int(match[1])]
    return payload if match[2].decode() in _list_digests(payload) else None


def _list_digests(payload: bytes) -> Iterator[str]:
    """The digests of a payload that count: BLAKE2b, and SHA-256 of a host that has no other."""
    yield hashlib.blake2b(payload, digest_size=32).hexdigest()
    yield hashlib.sha256(payload).hexdigest()


def build_frame_error(answer: Reply) -> Exception:
    """The error for an answer without a frame."""
    if _TOO_OLD_PATTERN.search(answer.stderr):
        return NoPythonError("python on the host is older than 3.6", hint=_PYTHON_HINT)
    if answer.status in (126, 127) or _NOT_FOUND_PATTERN.search(answer.stderr):
        return NoPythonError(
            f"no usable python on the host: {_format_excerpt(answer.stderr)}", hint=_PYTHON_HINT
        )
    return ReplyError(
        f"no valid reply from the agent (exit status {answer.status}): "
        f"{_format_excerpt(answer.stdout + answer.stderr)}"
    )


def _format_excerpt(noise: bytes) -> str:
    """The end of the output on one line, with control characters escaped."""
    text = noise[-400:].decode("utf-8", "replace").strip()
    return _escape_unprintable(" ".join(text.split()))[-160:] or "nothing was printed"


def _escape_unprintable(text: str) -> str:
    return "".join(letter if letter.isprintable() else f"\\x{ord(letter):02x}" for letter in text)


def parse_reply_json(payload: bytes) -> dict[str, object]:
    """Strict JSON: UTF-8, one object, no NaN, no infinity, no repeated names."""
    try:
        document = json.loads(
            payload.decode("utf-8"),
            parse_constant=_reject_constant,
            object_pairs_hook=_reject_duplicate_names,
            parse_float=_parse_finite_float,
        )
    except (ValueError, RecursionError) as error:
        raise ReplyError(
            f"the agent's reply is not valid JSON: {_escape_unprintable(str(error))[:160]}"
        ) from None
    if not isinstance(document, dict):
        raise ReplyError("the agent's reply is not an object")
    return document


def _reject_constant(constant: str) -> object:
    raise ValueError(f"{constant} is not a number")


def _parse_finite_float(text: str) -> float:
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise ValueError(f"{text} is too large")
    return value


def _reject_duplicate_names(pairs: list[tuple[str, object]]) -> dict[str, object]:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise ValueError("duplicate name in one object")
    return document


def stream_agent_log(
    session: Session, request: Mapping[str, object], *, idle_timeout: float
) -> Iterator[bytes]:
    """Follow a log: its bytes as they come, until the task ends or the iterator is closed.

    The host sends a keep-alive every few seconds, so ``idle_timeout`` (at least 10 s) tells a dead link from
    a quiet log.

    Raises:
        RefusedError, NoPythonError, ReplyError: as `call_agent`.
        DeadlineError: no output for ``idle_timeout`` seconds.
        ConnectError: the connection was lost.
    """
    # A stream cannot upload the agent: this call does, where the host does not have it yet.
    call_agent(
        session,
        {"op": protocol.OP_STATUS, **{key: request[key] for key in ("fleet", "host", "task")}},
        timeout=max(idle_timeout, 5.0),
    )
    yield from stream_agent_chunks(session, request, idle_timeout=idle_timeout)


def stream_agent_chunks(
    session: Session, request: Mapping[str, object], *, idle_timeout: float, timeout: float = 0.0
) -> Iterator[bytes]:
    """Carry out a request whose reply is a stream, on a host that has the agent: its chunks as they come.

    ``timeout``: seconds after which the host gives up; 0 for never.

    Raises:
        HostError: as `stream_agent_log`.
    """
    marker = secrets.token_hex(16)
    packet = build_packet(request, marker, timeout, b"")
    reader = _ChunkReader(marker)
    for data in session.stream(build_agent_command(session.python), packet, idle_timeout=idle_timeout):
        yield from reader.feed(data)
        if reader.ended:
            return


class _ChunkReader:
    """Parser of a stream: a frame, then chunks ``length newline bytes``.

    Length ``0`` is a keep-alive, ``end`` the end.
    """

    def __init__(self, marker: str) -> None:
        self._marker = marker
        self._buffer = b""
        self._open = False
        self.ended = False

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Whole chunks that ``data`` completes."""
        self._buffer += data
        if not self._open and not self._opened():
            return
        while not self.ended:
            head, newline, rest = self._buffer.partition(b"\n")
            if not newline and len(head) <= _MAX_HEAD_BYTES:
                return
            if head == b"end" and newline:
                self.ended = True
                return
            if re.fullmatch(rb"[0-9]{1,7}", head) is None:
                raise ReplyError(f"the log stream is garbled: {_format_excerpt(head)}")
            if not newline:
                return
            length = int(head)
            if len(rest) < length:
                return
            self._buffer = rest[length:]
            if length:
                yield rest[:length]

    def _opened(self) -> bool:
        found = split_frame(self._buffer, self._marker)
        if found is None:
            if len(self._buffer) > protocol.MAX_REPLY_BYTES:
                raise ReplyError(f"no valid reply from the agent: {_format_excerpt(self._buffer)}")
            return False
        payload, self._buffer = found
        check_reply(parse_reply_json(payload))
        self._open = True
        return True
