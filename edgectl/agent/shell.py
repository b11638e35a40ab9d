"""Commands of the user: run by bash where the host has it (ROS set-up files need it), else by sh; bounded in time and output."""

import os
import signal
import time

_KEPT = 2048
# What an SSH login leaves behind says nothing to a task, and would tie it to the manager that started it; nor is it a unit of systemd's.
_DROPPED = (
    "SSH_CLIENT",
    "SSH_CONNECTION",
    "SSH_TTY",
    "SSH_AUTH_SOCK",
    "SSH_ORIGINAL_COMMAND",
    "INVOCATION_ID",
)


def argv(command: str, prelude: str) -> list:
    """The argument vector that runs ``prelude`` and then ``command`` in one shell."""
    shell = "/bin/bash" if os.access("/bin/bash", os.X_OK) else "/bin/sh"
    return [shell, "-c", prelude + "\n" + command if prelude else command]


def environment(extra) -> dict:
    """The login's environment with ``extra`` on top."""
    found = {name: value for name, value in os.environ.items() if name not in _DROPPED}
    found.update({str(name): str(value) for name, value in (extra or {}).items()})
    return found


class Command:
    """A check that runs beside other work; its whole process group ends with it."""

    running = set()

    def __init__(self, command: str, prelude: str, env, timeout_s: float, cwd=None) -> None:
        # Two megabytes in every supervisor that has no check to run.
        import subprocess

        self.deadline = time.monotonic() + timeout_s
        self.kept = b""
        self.pipe, end = os.pipe()
        os.set_blocking(self.pipe, False)
        try:
            self.process = subprocess.Popen(
                argv(command, prelude), stdin=subprocess.DEVNULL, stdout=end, stderr=end,
                env=environment(env), start_new_session=True, cwd=cwd,
            )  # fmt: skip
        except BaseException:
            os.close(self.pipe)
            raise
        finally:
            os.close(end)
        Command.running.add(self)

    def poll(self):
        """None while it runs, else its result; at its deadline it is killed."""
        self._drain()
        # Looked at but not reaped: until it is, its pid and process group cannot become a stranger's.
        ended = os.waitid(os.P_PID, self.process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        if not ended and time.monotonic() < self.deadline:
            return None
        self.end()
        text = self.kept.decode("utf-8", "replace")
        return {"exit": self.process.returncode if ended else None, "timed_out": not ended, "output": text}

    def _drain(self) -> None:
        try:
            for _ in range(64):
                data = os.read(self.pipe, 65536)
                if not data:
                    return
                self.kept = (self.kept + data)[-_KEPT:]
        except BlockingIOError:
            pass

    def end(self) -> None:
        """Kill what is left of its process group and reap it."""
        Command.running.discard(self)
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except OSError:
            pass
        self.process.wait()
        self._drain()
        os.close(self.pipe)

    def result(self) -> dict:
        """Wait for the end."""
        while True:
            found = self.poll()
            if found is not None:
                return found
            time.sleep(0.01)


def end_all(*_signal) -> None:
    """The deadline of the request, or nobody waits any more: kill every check that still runs, then go."""
    for command in list(Command.running):
        command.end()
    os._exit(124)


def guard() -> None:
    """From here on the request's deadline also ends the checks that were started."""
    for number in (signal.SIGALRM, signal.SIGTERM):
        signal.signal(number, end_all)


def check(request: dict) -> dict:
    """Operation ``check``: run one command now."""
    guard()
    return Command(
        request["command"], request.get("prelude", ""), request.get("env"), float(request["timeout_s"])
    ).result()
