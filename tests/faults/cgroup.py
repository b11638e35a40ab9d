"""CPU limits for emulated computers, by cgroup v1 or v2, whichever this machine lets us write."""

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.pace import patience

ROOT = Path("/sys/fs/cgroup")
PERIOD_US = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """A cgroup of ours; ``limited`` says whether the CPU limit holds, ``why`` why not."""

    directories: tuple[Path, ...]
    limited: bool
    why: str = ""

    @property
    def doors(self) -> list[str]:
        """The files to write a pid to."""
        return [str(directory / "cgroup.procs") for directory in self.directories]

    def limit(self, cores: float) -> None:
        """Set the limit."""
        for directory in self.directories:
            quota = int(cores * PERIOD_US)
            if (directory / "cpu.cfs_quota_us").exists():
                (directory / "cpu.cfs_quota_us").write_text(f"{quota}\n")
            if (directory / "cpu.max").exists():
                (directory / "cpu.max").write_text(f"{quota} {PERIOD_US}\n")

    def remove(self) -> None:
        """Remove it; what ran in it must have ended (given up to 5 s)."""
        deadline = time.monotonic() + patience(5)
        for directory in self.directories:
            while directory.exists():
                try:
                    directory.rmdir()
                except OSError:
                    assert time.monotonic() < deadline, f"{directory} is still in use"
                    time.sleep(0.02)


def make(name: str, cores: float | None) -> Group:
    """A cgroup ``name`` limited to ``cores`` (None: no group at all)."""
    if cores is None:
        return Group(directories=(), limited=False, why="no limit wanted")
    for parent in (ROOT / "cpu", ROOT):
        directory = parent / name
        with suppress(OSError):
            directory.mkdir()
            group = Group(directories=(directory,), limited=True)
            if (directory / "cpu.cfs_quota_us").exists() or (directory / "cpu.max").exists():
                group.limit(cores)
                return group
        with suppress(OSError):
            directory.rmdir()
    return Group(
        directories=(), limited=False, why=f"no writable cpu controller below {ROOT} for uid {os.geteuid()}"
    )
