# SPDX-License-Identifier: Apache-2.0
"""Hosts that are this machine (``connection: local``): the same command line, run by sh."""

import contextlib
import os
import select
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from typing import IO, Self

from edgectl.errors import ConnectError, DeadlineError, ReplyError
from edgectl.model.inventory import Host
from edgectl.transport.base import Reply

_BLOCK_BYTES = 65536
_GRACE_S = 0.5


class LocalTransport:
    """Opens sessions on this machine, with the manager's own environment and interpreter."""

    def connect(self, host: Host, *, timeout: float) -> "LocalSession":
        """A session; it never fails to open."""
        del timeout  # nothing here takes time
        return LocalSession(host.name)

    def address(self, host: Host) -> str:
        """The address that the inventory states."""
        return host.host


class LocalSession:
    """Runs each command in a process group of its own, so that a deadline ends all of it."""

    python = sys.executable

    def __init__(self, name: str) -> None:
        self._name = name

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        """As ``Session.run``."""
        with self._started(command) as process:
            exchange = _PipeExchange(process, stdin, deadline=time.monotonic() + timeout, limit=limit)
            try:
                stdout, stderr = exchange.finish()
                status = process.wait(timeout=max(0.1, exchange.left()))
            except (TimeoutError, subprocess.TimeoutExpired):
                raise DeadlineError(f"no answer within {timeout:.3g} s", host=self._name) from None
            except OverflowError:
                raise ReplyError(f"more than {limit} bytes of output", host=self._name) from None
        return Reply(stdout=stdout, stderr=stderr, status=status)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        """As ``Session.stream``."""
        with self._started(command) as process:
            stdout = process.stdout.fileno() if process.stdout else -1
            if process.stdin:
                with contextlib.suppress(BrokenPipeError), process.stdin as pipe:
                    pipe.write(stdin)
            while True:
                if not select.select([stdout], [], [], idle_timeout)[0]:
                    raise DeadlineError(f"no output for {idle_timeout:g} s", host=self._name)
                data = os.read(stdout, _BLOCK_BYTES)
                if not data:
                    return
                yield data

    def exchange(
        self,
        command: str,
        stdin: bytes,
        *,
        timeout: float,
        check_end: Callable[[Reply], None] = lambda _reply: None,
    ) -> "LocalExchange":
        """As ``Session.exchange``. ``check_end`` may raise an error for the end of the command."""
        with ExitStack() as stack:
            stderr = stack.enter_context(tempfile.TemporaryFile())
            process = stack.enter_context(self._started(command, stderr))
            kept = ExitStack()
            exchange = LocalExchange(self._name, process, stderr, kept, check_end)
            exchange.write(stdin, timeout=timeout)
            kept.push(stack.pop_all())
            return exchange

    def converse(
        self, command: str, stdin: bytes, *, timeout: float, give_way: Callable[[], None]
    ) -> "LocalExchange":
        """As ``ConversableSession.converse``; there is room for any number of processes."""
        del give_way
        return self.exchange(command, stdin, timeout=timeout)

    @contextlib.contextmanager
    def _started(
        self, command: str, stderr: IO[bytes] | int = subprocess.PIPE
    ) -> Iterator[subprocess.Popen[bytes]]:
        pipe = subprocess.PIPE
        try:
            process = subprocess.Popen(
                ["/bin/sh", "-c", command], stdin=pipe, stdout=pipe, stderr=stderr, start_new_session=True
            )
        except OSError as error:
            raise ConnectError(f"cannot start a process: {error.strerror}", host=self._name) from None
        try:
            yield process
        finally:
            _end_process_group(process)

    def close(self) -> None:
        """Nothing is held open between commands."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _end_process_group(process: subprocess.Popen[bytes]) -> None:
    """End the process group, reap it, close its pipes. TERM first, so that an agent ends its checks too."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=_GRACE_S)
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()


class LocalExchange:
    """A process whose standard input is open (see `Exchange`)."""

    def __init__(
        self,
        name: str,
        process: subprocess.Popen[bytes],
        stderr: IO[bytes],
        stack: ExitStack,
        check_end: Callable[[Reply], None],
    ) -> None:
        self._name, self._process, self._stderr = name, process, stderr
        self._stack, self._check_end = stack, check_end

    def read(self, *, timeout: float) -> bytes:
        """As ``Exchange.read``."""
        pipe = self._process.stdout
        if pipe is None or not select.select([pipe], [], [], timeout)[0]:
            raise DeadlineError(f"no answer within {timeout:.3g} s", host=self._name)
        data = os.read(pipe.fileno(), _BLOCK_BYTES)
        if not data:
            self._check_end(self.build_reply())
        return data

    def write(self, data: bytes, *, timeout: float) -> None:
        """Write ``data``; a process that has ended is no error. Raises DeadlineError."""
        pipe, deadline = self._process.stdin, time.monotonic() + timeout
        if pipe is None or pipe.closed:
            return
        os.set_blocking(pipe.fileno(), False)
        with contextlib.suppress(BrokenPipeError):
            while data:
                if not select.select([], [pipe], [], max(0.0, deadline - time.monotonic()))[1]:
                    raise DeadlineError(f"no answer within {timeout:.3g} s", host=self._name)
                data = data[os.write(pipe.fileno(), data[:_BLOCK_BYTES]) :]

    def can_write(self) -> bool:
        """As ``OpenExchange.can_write``."""
        pipe = self._process.stdin
        return pipe is None or pipe.closed or bool(select.select([], [pipe], [], 0)[1])

    def expect_reply(self, *, timeout: float, limit: int) -> AbstractContextManager[None]:
        """As ``OpenExchange.expect_reply``: a pipe has no limit, and its writer a deadline."""
        del timeout, limit
        return contextlib.nullcontext()

    def expect_more(self, size: int) -> None:
        """As ``OpenExchange.expect_more``."""

    def finish(self, data: bytes, *, timeout: float) -> None:
        """As ``Exchange.finish``."""
        self.write(data, timeout=timeout)
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()

    def build_reply(self) -> Reply:
        """As ``Exchange.build_reply``."""
        try:
            status = self._process.wait(timeout=_GRACE_S)
        except subprocess.TimeoutExpired:
            status = -1
        self._stderr.seek(0)
        return Reply(stdout=b"", stderr=self._stderr.read(_BLOCK_BYTES), status=status)

    def close(self) -> None:
        """As ``Exchange.close``."""
        self._stack.close()


class _PipeExchange:
    """Writes all of standard input and reads both outputs at once, up to a deadline and a size."""

    def __init__(
        self, process: subprocess.Popen[bytes], stdin: bytes, *, deadline: float, limit: int
    ) -> None:
        self._process = process
        self._stdin = memoryview(stdin)
        self._deadline = deadline
        self._limit = limit
        self._got: dict[str, bytearray] = {"stdout": bytearray(), "stderr": bytearray()}

    def left(self) -> float:
        """Seconds until the deadline."""
        return self._deadline - time.monotonic()

    def finish(self) -> tuple[bytes, bytes]:
        """Standard output and error. Raises TimeoutError at the deadline, OverflowError above the limit."""
        with selectors.DefaultSelector() as selector:
            for name, events in (
                ("stdin", selectors.EVENT_WRITE),
                ("stdout", selectors.EVENT_READ),
                ("stderr", selectors.EVENT_READ),
            ):
                os.set_blocking(getattr(self._process, name).fileno(), False)
                selector.register(getattr(self._process, name), events, name)
            while selector.get_map():
                ready = selector.select(self.left())
                if not ready and self.left() <= 0:
                    raise TimeoutError
                for key, _ in ready:
                    pipe: IO[bytes] = getattr(self._process, key.data)
                    if not (self._write(pipe) if key.data == "stdin" else self._read(pipe, key.data)):
                        selector.unregister(pipe)
        return bytes(self._got["stdout"]), bytes(self._got["stderr"])

    def _write(self, pipe: IO[bytes]) -> bool:
        """Whether there is more to write."""
        try:
            self._stdin = self._stdin[os.write(pipe.fileno(), self._stdin[:_BLOCK_BYTES]) :]
        except BrokenPipeError:
            self._stdin = self._stdin[:0]
        if not self._stdin:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
        return bool(self._stdin)

    def _read(self, pipe: IO[bytes], name: str) -> bool:
        """Whether there may be more to read."""
        data = os.read(pipe.fileno(), _BLOCK_BYTES)
        self._got[name] += data
        if len(self._got["stdout"]) + len(self._got["stderr"]) > self._limit:
            raise OverflowError
        return bool(data)
