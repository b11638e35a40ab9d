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


def create_cgroup(name: str, cores: float | None) -> CpuGroup:
    """Create a cgroup ``name`` limited to ``cores`` (None: no cgroup)."""
    if cores is None:
        return CpuGroup(directories=(), limited=False, why="no limit wanted")
    for parent in (ROOT / "cpu", ROOT):
        directory = parent / name
        with suppress(OSError):
            directory.mkdir()
            group = CpuGroup(directories=(directory,), limited=True)
            if (directory / "cpu.cfs_quota_us").exists() or (directory / "cpu.max").exists():
                group.limit(cores)
                return group
        with suppress(OSError):
            directory.rmdir()
    return CpuGroup(
        directories=(), limited=False, why=f"no writable cpu controller below {ROOT} for uid {os.geteuid()}"
    )
