# SPDX-License-Identifier: Apache-2.0
"""CPU limits of emulated computers, by cgroup v1 or v2, whichever is writable."""

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.pace import patience

ROOT = Path("/sys/fs/cgroup")
PERIOD_US = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class CpuGroup:
    """A cgroup of a test; ``limited``: whether the CPU limit applies; ``why``: reason if not."""

    directories: tuple[Path, ...]
    limited: bool
    why: str = ""

    @property
    def procs_files(self) -> list[str]:
        """Return the files that take a pid."""
        return [str(directory / "cgroup.procs") for directory in self.directories]

    def limit(self, cores: float) -> None:
        """Set the CPU limit in cores."""
        for directory in self.directories:
            quota = int(cores * PERIOD_US)
            if (directory / "cpu.cfs_quota_us").exists():
                (directory / "cpu.cfs_quota_us").write_text(f"{quota}\n")
            if (directory / "cpu.max").exists():
                (directory / "cpu.max").write_text(f"{quota} {PERIOD_US}\n")

    def prefer(self) -> None:
        """Let its processes come before those of other groups where they compete."""
        for directory in self.directories:
            for name, most in (("cpu.shares", 262144), ("cpu.weight", 10000)):
                if (directory / name).exists():
                    (directory / name).write_text(f"{most}\n")

    def read_cpu_s(self) -> float:
        """Return the CPU seconds of all processes that were ever in it; 0 where they are not counted."""
        for directory in self.directories:
            if (directory / "cpuacct.usage").exists():
                return int((directory / "cpuacct.usage").read_text()) / 1e9
            if (directory / "cpu.stat").exists():
                stat = dict(line.split() for line in (directory / "cpu.stat").read_text().splitlines())
                if "usage_usec" in stat:
                    return int(stat["usage_usec"]) / 1e6
        return 0.0

    def remove(self) -> None:
        """Remove the cgroup; its processes must end within 5 s."""
        deadline = time.monotonic() + patience(5)
        for directory in self.directories:
            while directory.exists():
                try:
                    directory.rmdir()
                except OSError:
                    assert time.monotonic() < deadline, f"{directory} is still in use"
                    time.sleep(0.02)


def create_cgroup(name: str, cores: float | None, memory: float | None = None) -> CpuGroup:
    """Create a cgroup ``name`` limited to ``cores`` (None: no cgroup), whose CPU time is counted where that
    is another hierarchy (v1), and with ``memory`` limited to so many bytes.
    """
    if cores is None:
        return CpuGroup(directories=(), limited=False, why="no limit wanted")
    for parent in (ROOT / "cpu", ROOT):
        directory = parent / name
        with suppress(OSError):
            directory.mkdir()
            beside = _create_beside(name, memory) if parent != ROOT else ()
            group = CpuGroup(directories=(directory, *beside), limited=True)
            if (directory / "cpu.cfs_quota_us").exists() or (directory / "cpu.max").exists():
                group.limit(cores)
                return group
        with suppress(OSError):
            directory.rmdir()
    return CpuGroup(
        directories=(), limited=False, why=f"no writable cpu controller below {ROOT} for uid {os.geteuid()}"
    )


def _create_beside(name: str, memory: float | None) -> tuple[Path, ...]:
    """Create the group in the hierarchies of v1 that count its CPU time and limit its memory."""
    found = []
    for controller in ("cpuacct", *(["memory"] if memory else [])):
        directory = ROOT / controller / name
        if (ROOT / controller).exists() and (ROOT / controller).resolve() != (ROOT / "cpu").resolve():
            directory.mkdir()
            found.append(directory)
        if controller == "memory" and memory:
            (directory / "memory.limit_in_bytes").write_text(f"{int(memory)}\n")
    return tuple(found)


def list_hierarchies() -> list[Path]:
    """List the roots of the control groups of this machine that can be written: one for each v1 controller and
    the v2 tree beside them, else that of v2; empty without one in which systemd could work.
    """
    if (ROOT / "cgroup.controllers").exists():
        return [ROOT] if os.access(ROOT / "cgroup.procs", os.W_OK) else []
    found = [path for path in sorted(ROOT.iterdir()) if os.access(path / "cgroup.procs", os.W_OK)]
    return found if ROOT / "systemd" in found else []


def create_everywhere(name: str) -> list[Path]:
    """Create the group ``name`` in each hierarchy."""
    groups = [hierarchy / name for hierarchy in list_hierarchies()]
    for group in groups:
        group.mkdir()
        for setting in ("cpuset.cpus", "cpuset.mems"):
            if (group / setting).exists():
                (group / setting).write_text((group.parent / setting).read_text())
    return groups


def remove_tree(group: Path) -> None:
    """Remove a group and those below it; their processes must end within 5 s."""
    deadline = time.monotonic() + patience(5)
    while group.exists():
        for directory, _, _ in os.walk(group, topdown=False):
            with suppress(OSError):
                Path(directory).rmdir()
        assert not group.exists() or time.monotonic() < deadline, f"{group} is still in use"
        time.sleep(0.02)
