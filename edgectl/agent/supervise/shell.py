# SPDX-License-Identifier: Apache-2.0
"""Shell commands of the user: run by bash where the host has it (ROS set-up files need it), else by sh.

Bounded in time and output.
"""

import _signal as signal
import os
import time

from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..link.protocol import build_sourced_argv

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, Mapping, NoReturn, Sequence

_KEPT_BYTES = 2048
# Variables of the SSH login and of the manager's systemd unit, which do not apply to a task.
_DROPPED_VARIABLES = (
    "SSH_CLIENT",
    "SSH_CONNECTION",
    "SSH_TTY",
    "SSH_AUTH_SOCK",
    "SSH_ORIGINAL_COMMAND",
    "INVOCATION_ID",
)


def build_argv(command: str, prelude: str, setup: "Sequence[str]" = ()) -> "list[str]":
    """Build the argument vector that runs ``prelude`` and then ``command`` in one shell.

    ``setup``: files that another shell sources before it becomes that one.
    """
    shell = "/bin/bash" if os.access("/bin/bash", os.X_OK) else "/bin/sh"
    argv = [shell, "-c", prelude + "\n" + command if prelude else command]
    return build_sourced_argv(list(setup), argv) if setup else argv


def build_environment(extra: "Mapping[str, object] | None") -> "dict[str, str]":
    """Build the environment of the login with ``extra`` on top."""
    found = {name: value for name, value in os.environ.items() if name not in _DROPPED_VARIABLES}
    found.update({str(name): str(value) for name, value in (extra or {}).items()})
    return found


class ShellCommand:
    """A check that runs beside other work; its process group ends with it, unless it ``leaves`` some."""

    # Also questions to the ROS graph, which have the same interface.
    running: "set[Any]" = set()

    def __init__(
        self,
        command: "str | list[str]",
        prelude: str,
        env: "Mapping[str, object] | None",
        timeout_s: float,
        cwd: "str | None" = None,
        setup: "Sequence[str]" = (),
        leaves: bool = False,
    ) -> None:
        """``command``: text for a shell, or an argument vector, which needs none.

        ``leaves``: what it has started goes on after it has ended by itself.
        """
        # Imported on demand: 2 MB in every supervisor without a check.
        import subprocess

        self.deadline = time.monotonic() + timeout_s
        self.leaves = leaves
        self.kept = b""
        self.pipe, end = os.pipe()
        os.set_blocking(self.pipe, False)
        try:
            self.process = subprocess.Popen(
                build_argv(command, prelude, setup) if isinstance(command, str) else command,
                stdin=subprocess.DEVNULL,
                stdout=end,
                stderr=end,
                env=build_environment(env),
                start_new_session=True,
                cwd=cwd,
            )
        except BaseException:
            os.close(self.pipe)
            raise
        finally:
            os.close(end)
        self.pid = self.process.pid
        ShellCommand.running.add(self)

    def poll(self) -> "Document | None":
        """None while it runs, else its result; it is killed at its deadline."""
        self._drain()
        # Not reaped yet: until then its pid and process group cannot be reused.
        ended = os.waitid(os.P_PID, self.process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        if not ended and time.monotonic() < self.deadline:
            return None
        self.end(spared=ended and self.leaves)
        text = self.kept.decode("utf-8", "replace")
        return {"exit": self.process.returncode if ended else None, "timed_out": not ended, "output": text}

    def _drain(self) -> None:
        try:
            for _ in range(64):
                data = os.read(self.pipe, 65536)
                if not data:
                    return
                self.kept = (self.kept + data)[-_KEPT_BYTES:]
        except BlockingIOError:
            pass

    def end(self, spared: bool = False) -> None:
        """Kill what is left of its process group, unless ``spared``, and reap it."""
        ShellCommand.running.discard(self)
        if not spared:
            try:
                os.killpg(self.process.pid, signal.SIGKILL)
            except OSError:
                pass
        self.process.wait()
        self._drain()
        os.close(self.pipe)

    def result(self) -> Document:
        """Wait for the end."""
        while True:
            found = self.poll()
            if found is not None:
                return found
            time.sleep(0.01)


def run_program(request: Document) -> Document:
    """Operation ``run``: an argument vector, without a shell, for at most ``timeout_s``.

    What it leaves running goes on; at the deadline everything in its process group is killed.

    Raises:
        RefusalError: there is no such program, or it cannot be run.
    """
    install_deadline_handlers()
    argv = [str(word) for word in request["argv"]]
    try:
        home = os.path.expanduser("~")
        program = ShellCommand(argv, "", {}, float(request["timeout_s"]), cwd=home, leaves=True)
    except OSError as error:
        raise RefusalError("no-program", "%s: %s" % (argv[0], error.strerror), "install it there") from None
    return program.result()


def end_all_commands(*_signal: object) -> "NoReturn":
    """Handle the deadline of the request or the loss of its manager: kill every running check, then exit."""
    for command in list(ShellCommand.running):
        command.end()
    os._exit(124)


def install_deadline_handlers() -> None:
    """From here on the deadline of the request also ends the checks that were started."""
    for number in (signal.SIGALRM, signal.SIGTERM):
        signal.signal(number, end_all_commands)


def resolve_workdir(workdir: "str | None", env: "Mapping[str, str]") -> str:
    """Resolve the directory of a command: as requested, else the home directory, else /."""
    home = env.get("HOME") or "/"
    return os.path.expanduser(workdir) if workdir else home if os.path.isdir(home) else "/"
