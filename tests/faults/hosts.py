# SPDX-License-Identifier: Apache-2.0
"""Two kinds of real host behind one protocol: sshd on a loopback address, and an emulated computer in
namespaces.

A kind of host lacks the operations that it cannot perform (a loopback address has no cable); nothing is half
emulated.
"""

import getpass
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from tests import sshd
from tests.faults import scan
from tests.faults.scan import Bystander, Process
from tests.pace import patience

HERE = Path(__file__).parent
POWER, CABLE, REBOOT, DISK, MOUNTS, PYTHON, LIMIT = (
    "power",
    "cable",
    "reboot",
    "disk",
    "mounts",
    "python",
    "limit",
)


class Host(Protocol):
    """A host that the tests can break. Paths are those of the tests, while the host is on."""

    name: str
    kind: str
    can: frozenset[str]

    @property
    def login(self) -> tuple[str, int, str, str]: ...  # address, port, user, public host key line
    @property
    def home(self) -> Path: ...
    @property
    def records(self) -> Path: ...
    def power_off(self) -> None: ...
    def boot(self) -> None: ...
    def processes(self) -> list[Process]: ...
    def run(self, *command: str) -> "subprocess.CompletedProcess[str]": ...
    def start_bystander(self, name: str, *words: str, pid: int = 0) -> Bystander: ...
    def set_env(self, **env: str) -> None: ...
    def set_server_options(self, *lines: str) -> None: ...
    def change_key(self) -> None: ...
    def allow_logins(self, *, allowed: bool) -> None: ...
    def close(self) -> None: ...


def wait_for(condition: Callable[[], object], what: str, seconds: float = 30) -> None:
    """Poll until the condition holds."""
    deadline = time.monotonic() + patience(seconds)
    while not condition():
        assert time.monotonic() < deadline, f"no {seconds} s later: {what}"
        time.sleep(0.02)


def install_programs(directory: Path) -> None:
    """Install the oracle's programs and record directory on a host."""
    (directory / "records").mkdir(parents=True)
    (directory / "records").chmod(0o777)
    for program in ("recording_task.py", "standby_task.py", "bystander.py"):
        shutil.copy(HERE / program, directory / program)
        (directory / program).chmod(0o644)


@dataclass(kw_only=True)
class LoopbackHost:
    """Unprivileged sshd on a loopback address. Power-off ends the processes started through it; the boot id
    stays the machine's.
    """

    name: str
    lab: sshd.Lab
    env: dict[str, str] = field(default_factory=dict)
    options: tuple[str, ...] = ()
    bystanders: list["subprocess.Popen[bytes]"] = field(default_factory=list)
    kind: str = "loopback"
    can: frozenset[str] = frozenset()

    @property
    def server(self) -> sshd.Server:
        return self.lab[self.name]

    @property
    def login(self) -> tuple[str, int, str, str]:
        return self.server.address, self.server.port, getpass.getuser(), self.server.key

    @property
    def home(self) -> Path:
        return self.server.home

    @property
    def records(self) -> Path:
        return self.home / "oracle" / "records"

    def power_off(self) -> None:
        self.server.stop()

    def boot(self) -> None:
        if self.server.process is None:
            self.server.start()
            self.server.wait()

    def processes(self) -> list[Process]:
        """List processes left by logins (sessions carry no mark, or are shells started by sshd)."""
        return scan.list_processes_with_env(sshd.MARK, str(self.server.directory))

    def run(self, *command: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            command, capture_output=True, text=True, env=self._env(), timeout=patience(60), check=False
        )

    def _env(self) -> dict[str, str]:
        return {"HOME": str(self.home), "PATH": sshd.PATH} | self.env

    def start_bystander(self, name: str, *words: str, pid: int = 0) -> Bystander:
        assert not pid, "a loopback host has no process ids of its own"
        found, running = scan.start_bystander(self.records, name, *words)
        self.bystanders.append(running)
        return found

    def set_env(self, **env: str) -> None:
        self.env = env
        self._configure()

    def set_server_options(self, *lines: str) -> None:
        """Add lines to the configuration of sshd, for connections from now on."""
        self.options = lines
        self._configure()

    def _configure(self, *extra: str) -> None:
        standard = {
            "HOME": str(self.home),
            "XDG_STATE_HOME": str(self.home / "state"),
            sshd.MARK: str(self.server.directory),
            "PATH": sshd.PATH,
        }
        self.server.configure(
            env=standard | self.env, authorized=self.lab.authorized_keys, extra=(*extra, *self.options)
        )
        self._hang_up()
        self.server.wait()

    def _hang_up(self) -> None:
        assert self.server.process is not None
        self.server.process.send_signal(signal.SIGHUP)
        time.sleep(0.3)

    def change_key(self) -> None:
        (self.server.directory / "host_key").unlink()
        self.server.key = sshd.make_key(self.server.directory / "host_key")
        self._hang_up()

    def allow_logins(self, *, allowed: bool) -> None:
        self._configure(*([] if allowed else ["AuthorizedKeysFile none"]))

    def close(self) -> None:
        for running in self.bystanders:
            running.kill()
            running.wait()


@contextmanager
def start_loopback_hosts(directory: Path, names: list[str]) -> Iterator[dict[str, Host]]:
    """Start hosts on loopback addresses; needs no root."""
    with sshd.running_lab(directory, names) as lab:
        hosts: dict[str, Host] = {}
        for name in names:
            install_programs(lab[name].home / "oracle")
            hosts[name] = LoopbackHost(name=name, lab=lab)
        try:
            yield hosts
        finally:
            for host in hosts.values():
                host.close()
