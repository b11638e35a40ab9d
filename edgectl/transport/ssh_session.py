# SPDX-License-Identifier: Apache-2.0
"""Operations on an open SSH connection: raw channels with one hard deadline and a size limit each.

Fabric's ``Connection.run`` is not used: it polls, it decodes, and it does not end when the line does.
"""

import contextlib
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Self

import paramiko

from edgectl.errors import ConnectError, DeadlineError, HostError, ReplyError
from edgectl.transport.base import Reply
from edgectl.transport.sockets import (
    MAX_LOGIN_BYTES,
    Line,
    can_write_to,
    find_repeat_s,
    hang_up,
    watchdog,
)
from edgectl.transport.ssh_errors import translate_ssh_error

# A connection that does not even let a channel be closed is cut this long after the deadline, seconds.
GRACE_S = 0.5
CHANNEL_PAUSES_S = (0.02, 0.05, 0.1, 0.3, 1.0)
# Between two attempts while another call of this connection has a channel, unless it ends before; and before
# the deadline, so that the refusal is told, seconds.
_BUSY_PAUSE_S, _TO_TELL_S = 1.0, 0.1
_CHUNK_BYTES = 65536
_LOST_HINT = "try again; the host may have restarted"
# More than a pulse or a heartbeat has.
_FEW_BYTES = 1024
# Of a log, between two reads: the window of a channel and as much again, bytes.
MAX_STREAM_BYTES = 1 << 22


class SshSession:
    """An open connection to one host (see `Session`)."""

    def __init__(
        self, name: str, client: paramiko.SSHClient, line: Line, *, after: Callable[[], None] | None = None
    ) -> None:
        """``line``: the socket or channel underneath; ``after`` is called once when the session is closed."""
        transport = client.get_transport()
        if transport is None:
            raise ConnectError("the connection was closed at once", host=name)
        self.name = name
        self.transport = transport
        self.allowance = line.allowance
        self._client = client
        self._line = line
        self._after = after
        self._give_way: Callable[[], None] | None = None
        self._lock = threading.Lock()
        # Calls that have a channel now; a host may have room for one.
        self._calls, self._call_ended = 0, threading.Condition()

    @property
    def python(self) -> str:
        """The interpreter to name in a command line."""
        return "python3"

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        """Run ``command`` (see `Session.run`)."""
        deadline = time.monotonic() + timeout
        most = get_most_bytes(limit)
        with self.allowance.grant(most), self._channel(command, stdin, deadline, window=limit) as channel:
            return _collect_reply(channel, deadline, limit, timeout)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        """Run ``command`` and yield its output as it comes (see `Session.stream`)."""
        with (
            self.allowance.grant(MAX_STREAM_BYTES),
            self.translate_errors(idle_timeout),
            contextlib.closing(self._open(time.monotonic() + idle_timeout)) as channel,
        ):
            with watchdog(idle_timeout + GRACE_S, self.cut):
                _start_command(channel, command, stdin, idle_timeout)
            arrived = _watch_arrivals(channel)
            while True:
                yield from _read_available(channel)
                self.allowance.renew(MAX_STREAM_BYTES)
                if _has_output_ended(channel):
                    break
                if not arrived.wait(idle_timeout):
                    raise DeadlineError(f"no output for {idle_timeout:g} s")
            self.check(channel)

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> "SshExchange":
        """Run ``command`` and leave its input open (see `Session.exchange`)."""
        deadline = time.monotonic() + timeout
        stack = contextlib.ExitStack()
        with stack, self.translate_errors(timeout):
            stack.enter_context(self.allowance.grant(MAX_STREAM_BYTES))
            with watchdog(timeout + GRACE_S, self.cut):
                channel = stack.enter_context(contextlib.closing(self._open(deadline)))
                _start_exchange(channel, command, stdin, timeout)
            return SshExchange(self, channel, stack.pop_all())

    def converse(
        self, command: str, stdin: bytes, *, timeout: float, give_way: Callable[[], None]
    ) -> "SshExchange":
        """Keep ``command`` running beside the others (see `ConversableSession.converse`)."""
        deadline = time.monotonic() + timeout
        stack = contextlib.ExitStack()
        with stack, self.translate_errors(timeout):
            # Only its first word; after that each request grants what it may bring.
            self.allowance.renew(MAX_LOGIN_BYTES)
            with watchdog(timeout + GRACE_S, self.cut):
                # Where there is room for one channel, calls have it until they end.
                channel = stack.enter_context(contextlib.closing(self._open(deadline)))
                self._give_way = give_way
                _start_exchange(channel, command, stdin, timeout)
            return SshExchange(self, channel, stack.pop_all())

    def close(self) -> None:
        """Close the connection and what it was tunnelled through; never raises."""
        with self._lock:
            after, self._after = self._after, None
        with contextlib.suppress(Exception):
            self.cut()
            self._client.close()
            self.transport.join(1)
            self._line.close()
        if after is not None:
            after()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def check(self, channel: paramiko.Channel) -> None:
        """Raise why a channel has no exit status, where it is the end of the whole connection, or a command
        to which the server did not agree.
        """
        if channel.exit_status != -1:
            return
        if not self.transport.is_active():
            cause = self.transport.saved_exception
            raise ConnectError("the connection was lost", hint=_LOST_HINT) from cause
        if not channel.event_ready:
            raise paramiko.SSHException("the server refused to run a command")

    @contextlib.contextmanager
    def translate_errors(self, seconds: float) -> Iterator[None]:
        """Raise what goes wrong within as an error of ours; ``seconds``: the time that a time-out means."""
        try:
            yield
        except Exception as error:
            ours = self.translate_error(error, seconds)
            if ours is error:
                raise
            raise ours from error

    def translate_error(self, error: Exception, seconds: float) -> Exception:
        """What went wrong as an error of ours; itself where it is one, or none of the connection."""
        if isinstance(error, TimeoutError):
            return DeadlineError(f"no answer within {seconds:.3g} s", host=self.name)
        return translate_ssh_error(error, self.name)

    def can_send(self) -> bool:
        """Whether the line takes a few bytes without a wait; behind a jump host nobody knows."""
        return isinstance(self._line, socket.socket) and can_write_to(self._line.fileno())

    def hold_writes(self) -> Callable[[], None]:
        """Hold back the few bytes that this thread writes next until it calls what is returned."""
        self._line.hold()
        return self._line.send_held

    def find_repeat_s(self) -> float | None:
        """Seconds after which the line repeats what was lost; None where nobody knows."""
        return find_repeat_s(self._line)

    def cut(self) -> None:
        """End the connection at once, from any thread."""
        hang_up(self._line)

    @contextlib.contextmanager
    def _channel(
        self, command: str, stdin: bytes, deadline: float, *, window: int
    ) -> Iterator[paramiko.Channel]:
        """A channel on which ``command`` runs and has its input; errors within are translated."""
        seconds = deadline - time.monotonic()
        with self.translate_errors(seconds), watchdog(seconds + GRACE_S, self.cut) as watch:
            try:
                with contextlib.closing(self._open(deadline, window)) as channel, self._counting_call():
                    _start_command(channel, command, stdin, seconds)
                    yield channel
                    self.check(channel)
            except Exception as error:
                if self.allowance.is_spent():
                    raise ConnectError(
                        "the host sent more than any reply has; the connection was closed",
                        hint="something floods it: check the SSH server of the host",
                    ) from error
                # A refusal is an answer, also where it is the last one of many and comes late.
                is_said = isinstance(error, HostError | paramiko.ChannelException)
                if watch.expired or (time.monotonic() >= deadline and not is_said):
                    raise DeadlineError(f"no answer within {seconds:.3g} s") from error
                raise

    def _open(self, deadline: float, window: int | None = None) -> paramiko.Channel:
        """A new channel. sshd allows ten (MaxSessions) or fewer; a closed one counts until sshd has noticed.

        ``window``: how many bytes may come that nobody has read; None: 2 MiB.
        """
        pauses = iter(CHANNEL_PAUSES_S)
        while True:
            try:
                return self._open_once(deadline, window)
            except paramiko.SSHException:
                # Not only ChannelException: of two threads refused at once, paramiko gives the reason to one.
                pause = self._await_call_end(deadline) or next(pauses, math.inf)
                if not self.transport.is_active() or time.monotonic() + pause >= deadline:
                    raise
                if self._give_way is not None:
                    self._give_way()
                time.sleep(pause)

    def _await_call_end(self, deadline: float) -> float:
        """Wait until a call ends that has a channel; the seconds to wait besides, 0 where none has one."""
        with self._call_ended:
            if not self._calls:
                return 0.0
            left = deadline - time.monotonic() - _TO_TELL_S
            ended = self._call_ended.wait(max(0.0, min(_BUSY_PAUSE_S, left)))
        return CHANNEL_PAUSES_S[0] if ended else _TO_TELL_S

    @contextlib.contextmanager
    def _counting_call(self) -> Iterator[None]:
        with self._call_ended:
            self._calls += 1
        try:
            yield
        finally:
            with self._call_ended:
                self._calls -= 1
                self._call_ended.notify_all()

    def _open_once(self, deadline: float, window: int | None) -> paramiko.Channel:
        if not self.transport.is_active():
            raise ConnectError("the connection was lost", hint=_LOST_HINT) from self.transport.saved_exception
        left = max(0.01, deadline - time.monotonic())
        return self.transport.open_session(window_size=window, timeout=left)


class _Arrivals(threading.Event):
    """Set where an output of a channel has data or has ended; while it is ``resting``, only where it ended.

    paramiko's thread sets it, before it adds the data. ``at``: when it did that last; ``is_new``: since the
    last look.
    """

    def __init__(self, channel: paramiko.Channel) -> None:
        super().__init__()
        self._channel = channel
        self.resting = self.is_new = False
        self.at = time.monotonic()

    def set(self) -> None:
        """Wake whoever waits for it now."""
        self.at, self.is_new = time.monotonic(), True
        if not self.resting or self._channel.eof_received or self._channel.closed:
            super().set()

    def wake(self) -> None:
        """Wake whoever waits for it, though nothing may have come."""
        super().set()


class SshExchange:
    """A channel whose standard input is open (see `Exchange`)."""

    def __init__(self, session: SshSession, channel: paramiko.Channel, stack: contextlib.ExitStack) -> None:
        self._session, self._channel, self._stack = session, channel, stack
        self._stderr = bytearray()
        self._arrived = _Arrivals(channel)
        _watch_arrivals(channel, self._arrived)

    @property
    def arrived_at(self) -> float:
        """As ``RestingExchange.arrived_at``."""
        return self._arrived.at

    def rest(self, *, resting: bool) -> None:
        """As ``RestingExchange.rest``."""
        self._arrived.resting = resting
        if not resting and self._arrived.is_new:
            self.wake()

    def wake(self) -> None:
        """As ``RestingExchange.wake``."""
        self._arrived.wake()

    def await_arrival(self, seconds: float) -> None:
        """As ``RestingExchange.await_arrival``."""
        self._arrived.wait(seconds)

    def has_arrived(self) -> bool:
        """As ``RestingExchange.has_arrived``: a read may have to tell the server that there is room again."""
        return self._arrived.is_new and self.can_write()

    def hold_writes(self) -> Callable[[], None]:
        """As ``RestingExchange.hold_writes``."""
        return self._session.hold_writes()

    def find_repeat_s(self) -> float | None:
        """As ``RestingExchange.find_repeat_s``."""
        return self._session.find_repeat_s()

    def read(self, *, timeout: float) -> bytes:
        """As ``Exchange.read``."""
        deadline = time.monotonic() + timeout
        with self._session.translate_errors(timeout):
            while True:
                self._arrived.clear()
                self._arrived.is_new = False
                piece = b"".join(_read_available(self._channel, self._stderr))
                del self._stderr[:-_CHUNK_BYTES]
                if piece:
                    return piece
                if _has_output_ended(self._channel):
                    self._session.check(self._channel)
                    return b""
                if not self._arrived.wait(max(0.0, deadline - time.monotonic())):
                    raise DeadlineError(f"no answer within {timeout:.3g} s")

    def write(self, data: bytes, *, timeout: float) -> None:
        """As ``OpenExchange.write``."""
        # Not by the block of the others, which takes six calls, as it is for each pulse.
        try:
            self._channel.settimeout(timeout)
            _feed_input(self._channel, data, last=False)
        except Exception as error:
            ours = self._session.translate_error(error, timeout)
            if ours is error:
                raise
            raise ours from error

    def can_write(self) -> bool:
        """As ``OpenExchange.can_write``."""
        channel, session = self._channel, self._session
        return (
            channel.out_window_size >= _FEW_BYTES
            and session.transport.clear_to_send.is_set()
            and session.can_send()
        )

    @contextlib.contextmanager
    def expect_reply(self, *, timeout: float, limit: int) -> Iterator[None]:
        """As ``OpenExchange.expect_reply``."""
        session = self._session
        with session.allowance.grant(get_most_bytes(limit)), watchdog(timeout + GRACE_S, session.cut):
            yield

    def expect_more(self, size: int) -> None:
        """As ``OpenExchange.expect_more``."""
        self._session.allowance.renew(size)

    def finish(self, data: bytes, *, timeout: float) -> None:
        """As ``Exchange.finish``."""
        with self._session.translate_errors(timeout):
            self._channel.settimeout(timeout)
            _feed_input(self._channel, data, last=True)

    def build_reply(self) -> Reply:
        """As ``Exchange.build_reply``."""
        self._channel.status_event.wait(GRACE_S)
        return Reply(stdout=b"", stderr=bytes(self._stderr), status=self._channel.exit_status)

    def close(self) -> None:
        """As ``Exchange.close``."""
        with contextlib.suppress(Exception):
            self._stack.close()


def get_most_bytes(limit: int) -> int:
    """What a call brings at most: until ``limit`` is seen, and what the window lets come meanwhile."""
    return 2 * limit + MAX_LOGIN_BYTES


def _start_exchange(channel: paramiko.Channel, command: str, stdin: bytes, seconds: float) -> None:
    """Run ``command``, write what it reads first, and leave its input open."""
    channel.settimeout(seconds)
    _send_command(channel, command)
    _feed_input(channel, stdin, last=False)


def _start_command(channel: paramiko.Channel, command: str, stdin: bytes, seconds: float) -> None:
    """Run ``command`` and write its input.

    A program that ends before it has read all is no error, as in a pipe.
    """
    channel.settimeout(seconds)
    _send_command(channel, command)
    _feed_input(channel, stdin, last=True)


def _send_command(channel: paramiko.Channel, command: str) -> None:
    """Ask the server to run ``command``, and go on: its input need not wait until the server agrees.

    That saves a way there and back where the window of a new channel is open; OpenSSH opens it as it agrees.
    A server that refuses closes the channel (`SshSession.check`). A paramiko without this method to wait
    waits.
    """
    channel._wait_for_event = _wait_for_nothing  # type: ignore[attr-defined] # noqa: SLF001 - see above
    try:
        channel.exec_command(command)
    finally:
        del channel._wait_for_event  # type: ignore[attr-defined] # noqa: SLF001


def _wait_for_nothing() -> None:
    """In place of the wait until the server agrees."""


def _feed_input(channel: paramiko.Channel, data: bytes, *, last: bool) -> None:
    try:
        channel.sendall(data)
        if last:
            channel.shutdown_write()
    except TimeoutError:
        raise
    except OSError:
        if not channel.closed and not channel.eof_received:
            raise


def _collect_reply(channel: paramiko.Channel, deadline: float, limit: int, timeout: float) -> Reply:
    """Read both outputs to their end, then the exit status.

    Raises:
        DeadlineError: the deadline passed.
        ReplyError: more than ``limit`` bytes came.
    """
    stdout, stderr, total = bytearray(), bytearray(), 0
    arrived = _watch_arrivals(channel)
    while True:
        for piece in _read_available(channel, stderr):
            stdout += piece
            total = len(stdout) + len(stderr)
            if total > limit:
                raise ReplyError(
                    f"more than {limit} bytes of output",
                    hint="something floods the output: check the login shell's startup files",
                )
        if _has_output_ended(channel) or not arrived.wait(max(0.0, deadline - time.monotonic())):
            break
    if not _has_output_ended(channel) or not channel.status_event.wait(max(0.0, deadline - time.monotonic())):
        raise DeadlineError(f"no answer within {timeout:.3g} s")
    return Reply(stdout=bytes(stdout), stderr=bytes(stderr), status=channel.exit_status)


def _watch_arrivals(channel: paramiko.Channel, event: threading.Event | None = None) -> threading.Event:
    """An event that is set when either output of ``channel`` has data or ended: one thread waits for both."""
    arrived = threading.Event() if event is None else event
    channel.in_buffer.set_event(arrived)
    channel.in_stderr_buffer.set_event(arrived)
    if channel.recv_ready() or channel.recv_stderr_ready():
        arrived.set()
    return arrived


def _read_available(channel: paramiko.Channel, stderr: bytearray | None = None) -> Iterator[bytes]:
    """The standard output so far in pieces; an empty piece marks data that was added to ``stderr``."""
    while channel.recv_ready() or channel.recv_stderr_ready():
        if channel.recv_stderr_ready():
            piece = channel.recv_stderr(_CHUNK_BYTES)
            if stderr is not None:
                stderr += piece
                yield b""
        if channel.recv_ready():
            yield channel.recv(_CHUNK_BYTES)


def _has_output_ended(channel: paramiko.Channel) -> bool:
    over = bool(channel.eof_received or channel.closed)
    return over and not channel.recv_ready() and not channel.recv_stderr_ready()
