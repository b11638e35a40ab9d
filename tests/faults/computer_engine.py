# SPDX-License-Identifier: Apache-2.0
"""A real Docker Engine on an emulated computer, for an ordinary user of that. It ends with the power of the computer."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tests.containers.docker_engine import PROGRAMS, EngineClient, build_engine_argv
from tests.faults import cgroup, scan
from tests.faults.scan import Process
from tests.pace import patience

if TYPE_CHECKING:
    from tests.faults.namespace_host import NamespaceHost

PLACE = Path("/opt/docker")
"""Where the computers have Docker's programs."""
SHARED: Mapping[str, Path] = {str(PLACE): PROGRAMS}
_START_S = 60.0


@dataclass
class ComputerEngine(EngineClient):
    """``live_restore``: containers survive its end. It is running between `start` and `kill`, or a loss of power."""

    computer: "NamespaceHost"
    live_restore: bool = True
    process: "subprocess.Popen[bytes] | None" = None

    def __post_init__(self) -> None:
        self.folder.mkdir()

    @property
    def group(self) -> str:
        """Name of the control group of all its containers."""
        return f"test-of-edgectl-{os.getpid()}-{id(self)}-{self.computer.name}"

    @property
    def socket(self) -> Path:
        return Path(f"/proc/{self.computer.pid}/root/run/docker.sock")

    def install(self) -> None:
        """Put ``docker`` where the shells of the computer find it."""
        place = self.computer.path("usr/bin/docker")
        place.unlink(missing_ok=True)  # that of the machine
        place.symlink_to(PLACE / "docker")

    def start(self) -> None:
        """Start the engine where it does not run, let it go on where it is frozen, and wait until it answers."""
        if not self.list_daemons("dockerd"):
            self._begin()
        self.thaw()
        deadline = time.monotonic() + patience(_START_S)
        while not self.answers():
            ended = self.process is None or self.process.poll() is not None
            if ended or time.monotonic() > deadline:
                raise AssertionError((self.folder / "dockerd.log").read_text()[-2000:])
            time.sleep(0.05)
        self.import_image()

    def _begin(self) -> None:
        self.forget()
        network = f"{self.computer.site.network}.0/24"
        own = [
            "--host=unix:///run/docker.sock",
            "--exec-root=/run/docker",
            "--pidfile=/run/docker.pid",
            f"--group={self.computer.login[2]}",
            f"--insecure-registry={network}",
            *(["--live-restore"] if self.live_restore else []),
        ]
        argv = build_engine_argv(PLACE, self.group, folder=Path("/var/lib/docker"), more=own)
        path = f"PATH={PLACE}:/usr/sbin:/usr/bin:/sbin:/bin"
        words = self.computer.enter("env", "-i", path, f"LD_LIBRARY_PATH={PLACE}", *argv, user=False)
        with (self.folder / "dockerd.log").open("ab") as log:
            self.process = subprocess.Popen(words, stdout=log, stderr=log, stdin=subprocess.DEVNULL)

    def list_daemons(self, *names: str) -> list[Process]:
        """List the processes of the engine by the names of their programs."""
        return [each for each in self.computer.list_all() if _get_program(each) in names]

    def list_shims(self) -> list[Process]:
        """List the processes between the engine and the containers."""
        return self.list_daemons("containerd-shim-runc-v2")

    def list_inside(self) -> list[Process]:
        """List the processes in containers."""
        return [each for each in scan.list_processes() if self.group in _read_groups(each.pid)]

    def stop(self) -> None:
        """End the engine as a service manager does."""
        self._end(signal.SIGTERM)

    def kill(self) -> None:
        """Kill the engine, and with it its containerd; shims and containers live on."""
        self._end(signal.SIGKILL)

    def freeze(self) -> None:
        """Stop the engine's own process, which then accepts connections and answers none."""
        _send(self.list_daemons("dockerd"), signal.SIGSTOP)

    def thaw(self) -> None:
        _send(self.list_daemons("dockerd"), signal.SIGCONT)
        if self.process is not None:
            # nsenter stops with what it has started, and not only that.
            self.process.send_signal(signal.SIGCONT)

    def _end(self, number: signal.Signals) -> None:
        _send(self.list_daemons("dockerd"), number)
        self.forget()
        deadline = time.monotonic() + patience(_START_S)
        while left := self.list_daemons("dockerd", "containerd"):
            assert time.monotonic() < deadline, f"still there: {left}"
            if number == signal.SIGKILL:
                _send(left, number)
            time.sleep(0.02)
        # Another process may have got the number in it meanwhile, which would then pass for an engine.
        for place in ("run/docker.pid", "run/docker/containerd/containerd.pid"):
            Path(f"/proc/{self.computer.pid}/root/{place}").unlink(missing_ok=True)

    def forget(self) -> None:
        """Wait for the end of what has started the engine, which ends with it."""
        if self.process is not None:
            self.process.send_signal(signal.SIGCONT)
            self.process.wait(patience(_START_S))
            self.process = None

    def find_left(self) -> list[str]:
        """What is left after all tasks have been stopped, one sentence each."""
        found = [f"{self.computer.name}: container {name}" for name in self.list_containers()]
        deadline = time.monotonic() + patience(5)
        while (shims := self.list_shims()) and time.monotonic() < deadline:
            time.sleep(0.05)
        return found + [f"{self.computer.name}: process {each.pid} {each.command[:90]}" for each in shims]

    def remove_groups(self) -> None:
        """Remove the control groups of its containers, which have ended with the computer."""
        for top in (cgroup.ROOT, *cgroup.ROOT.glob("*/")):
            cgroup.remove_tree(top / self.group)


def is_of_engine(each: Process) -> bool:
    """Whether it is a process of an engine: no task, and none of edgectl."""
    return _get_program(each) in ("dockerd", "containerd", "containerd-shim-runc-v2", "runc")


def _get_program(each: Process) -> str:
    return Path(each.command.split(" ", 1)[0]).name


def _read_groups(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cgroup").read_text()
    return ""


def _send(found: list[Process], number: signal.Signals) -> None:
    for each in found:
        if each.alive:
            with contextlib.suppress(ProcessLookupError):
                os.kill(each.pid, number)
