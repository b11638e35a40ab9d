# SPDX-License-Identifier: Apache-2.0
"""A command of the user that is prepared and then waits: its shell has sourced the set-up files and run the
prelude, and needs one line to go on. It holds a lock for as long as any of its processes lives.
"""

import _signal as signal
import fcntl
import os
import select
import time

from ..link.fast_json import Document
from ..measure.sockets import socket
from . import shell, spawn

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping, NoReturn, Sequence

_KEPT_BYTES = 2048
# The descriptor over which the shell says that it waits, and hears that it may go on; sh knows one digit.
_GATE_FD, _FIRST_FREE_FD = 9, 20
_WAIT_FOR_GO = "echo >&%d; read -r _edgectl_go <&%d || exit 125; exec %d>&-\n" % ((_GATE_FD,) * 3)
_MSG_NOSIGNAL = 0x4000
# The end of the command is looked for more rarely the longer it takes.
_FIRST_LOOK_S, _LAST_LOOK_S, _LOOK_SHARE = 0.0003, 0.02, 0.1


class HeldShell:
    """One command, with the interface of a `ShellCommand` once `go` was called."""

    def __init__(
        self,
        command: str,
        prelude: str,
        env: "Mapping[str, str]",
        setup: "Sequence[str]",
        cwd: str,
        lock: int,
    ) -> None:
        """``lock``: an open descriptor that the command inherits."""
        self.deadline = 0.0
        self.kept = b""
        script = (prelude + "\n" if prelude else "") + _WAIT_FOR_GO + command
        self.pipe, output = os.pipe()
        os.set_blocking(self.pipe, False)
        self._gate, gate_end = socket.socketpair()
        self.pid = os.fork()
        if self.pid == 0:
            _exec_shell(shell.build_argv(script, "", setup), env, cwd, lock, output, gate_end.fileno())
        os.close(output)
        gate_end.close()
        shell.ShellCommand.running.add(self)

    def await_prepared(self, patience_s: float) -> str:
        """Wait until the command needs nothing but `go`: empty then, else why it does not."""
        deadline = time.monotonic() + patience_s
        while True:
            self._drain()
            left_s = max(0.0, min(_LAST_LOOK_S, deadline - time.monotonic()))
            if select.select([self._gate], [], [], left_s)[0]:
                if self._gate.recv(1):
                    return ""
                self._drain()
                return "its shell has ended: " + (self.read_end() or "it printed nothing")
            if time.monotonic() >= deadline:
                return "its shell was not prepared within %g s" % patience_s

    def go(self, timeout_s: float) -> None:
        """Run the command, for at most ``timeout_s``."""
        self.deadline = time.monotonic() + timeout_s
        try:
            # A supervisor has the default action for SIGPIPE.
            self._gate.send(b"\n", _MSG_NOSIGNAL)
        except OSError:
            # Its end says why.
            pass

    def poll(self) -> "Document | None":
        """None while it runs, else its result; it is killed at its deadline."""
        self._drain()
        # Not reaped yet: until then its pid and process group cannot be reused.
        found = os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if found is None and time.monotonic() < self.deadline:
            return None
        code = self.end()
        timed_out = found is None
        return {"exit": None if timed_out else code, "timed_out": timed_out, "output": self.read_end()}

    def result(self) -> Document:
        """Wait for the end."""
        began = time.monotonic()
        while True:
            found = self.poll()
            if found is not None:
                return found
            pause_s = _LOOK_SHARE * (time.monotonic() - began)
            time.sleep(max(_FIRST_LOOK_S, min(_LAST_LOOK_S, pause_s)))

    def end(self) -> int:
        """Kill what is left of its process group and reap it; its exit code, -1 where a signal ended it."""
        shell.ShellCommand.running.discard(self)
        try:
            os.killpg(self.pid, signal.SIGKILL)
        except OSError:
            try:
                os.kill(self.pid, signal.SIGKILL)
            except OSError:
                pass
        status = os.waitpid(self.pid, 0)[1]
        self._drain()
        os.close(self.pipe)
        self._gate.close()
        return os.WEXITSTATUS(status) if os.WIFEXITED(status) else -1

    def read_end(self) -> str:
        """The end of what it printed, as one line."""
        return " ".join(self.kept.decode("utf-8", "replace").split())

    def _drain(self) -> None:
        try:
            for _ in range(64):
                data = os.read(self.pipe, 65536)
                if not data:
                    return
                self.kept = (self.kept + data)[-_KEPT_BYTES:]
        except OSError:
            pass


def _exec_shell(
    argv: "list[str]", env: "Mapping[str, str]", cwd: str, lock: int, output: int, gate: int
) -> "NoReturn":
    """In the child: become the shell."""
    try:
        os.setsid()
        signal.set_wakeup_fd(-1)
        spawn.reset_signals()
        null = os.open(os.devnull, os.O_RDWR)
        for fd, place in ((null, 0), (output, 1), (output, 2)):
            os.dup2(fd, place)
        # Out of the way of the gate.
        gate, lock = (fcntl.fcntl(fd, fcntl.F_DUPFD, _FIRST_FREE_FD) for fd in (gate, lock))
        spawn.close_other_fds({0, 1, 2, gate, lock})
        os.dup2(gate, _GATE_FD)
        os.close(gate)
        os.chdir(cwd)
        os.execve(argv[0], argv, dict(env))  # noqa: S606 - argv[0] is bash or sh
    except OSError as error:
        text = "%s: %s" % (error.filename or argv[0], error.strerror)
        os.write(2, text.encode("utf-8", "surrogateescape"))
    finally:
        os._exit(127)
