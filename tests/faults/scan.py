# SPDX-License-Identifier: Apache-2.0
"""Processes, file locks and file modes as the kernel reports them, and bystander processes. Standard library
only.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.faults.oracle import read_events
from tests.pace import patience

BYSTANDER = Path(__file__).with_name("bystander.py")


@dataclass(frozen=True, slots=True, kw_only=True)
class Process:
    """A process of this machine's /proc; ``ticks`` (its start time) distinguishes it from a later process
    with the same pid.
    """

    pid: int
    parent: int
    state: str
    ticks: int
    command: str

    @property
    def alive(self) -> bool:
        """Whether this very process still runs."""
        found = read_process(self.pid)
        return found is not None and found.ticks == self.ticks and found.state not in "ZX"


def read_process(pid: int) -> Process | None:
    """Return the process with that pid, or None."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
        command = (
            Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
        )
    except OSError:
        return None
    return Process(pid=pid, parent=int(fields[1]), state=fields[0], ticks=int(fields[19]), command=command)


def list_processes() -> list[Process]:
    """List all processes of the machine except zombies."""
    found = (
        read_process(int(entry))
        for entry in (each.name for each in Path("/proc").iterdir())
        if entry.isdigit()
    )
    return [each for each in found if each is not None and each.state not in "ZX"]


def list_marked_processes(word: str) -> list[Process]:
    """List processes with ``word`` in their command line: every process of a test task carries the mark of
    its fleet.
    """
    return [each for each in list_processes() if word in each.command and each.pid != os.getpid()]


def list_processes_with_env(name: str, value: str) -> list[Process]:
    """List processes with ``name=value`` in their initial environment."""
    wanted, found = f"{name}={value}\0".encode(), []
    for each in list_processes():
        with suppress(OSError):
            if wanted in Path(f"/proc/{each.pid}/environ").read_bytes() + b"\0":
                found.append(each)
    return found


def list_processes_in_namespace(kind: str, inode: int) -> list[Process]:
    """List processes in a namespace (``pid``, ``net``, ``mnt`` ..) by its inode number."""
    found = []
    for each in list_processes():
        with suppress(OSError):
            if Path(f"/proc/{each.pid}/ns/{kind}").stat().st_ino == inode:
                found.append(each)
    return found


def list_held_locks(*directories: Path) -> list[str]:
    """Return ``path held by PID`` for every locked file below the directories."""
    holders = {}
    for line in Path("/proc/locks").read_text().splitlines():
        fields = line.split()
        if fields[1] != "->":  # a waiter, not a holder
            major, minor, inode = fields[5].split(":")
            holders[os.makedev(int(major, 16), int(minor, 16)), int(inode)] = fields[4]
    found = []
    for path in list_files(*directories):
        with suppress(OSError):
            info = path.stat()
            if holder := holders.get((info.st_dev, info.st_ino)):
                found.append(f"{path} held by {holder}")
    return found


def list_files(*directories: Path) -> list[Path]:
    """List every file below the directories."""
    return [Path(base) / name for top in directories for base, _, names in os.walk(top) for name in names]


def list_exposed_paths(*directories: Path) -> list[str]:
    """List files that others may read and directories that others may enter."""
    found = []
    for top in directories:
        for base, _, names in os.walk(top):
            for path in (Path(base), *(Path(base) / name for name in names)):
                with suppress(OSError):
                    if not path.is_symlink() and path.stat().st_mode & 0o077:
                        found.append(f"{path} {path.stat().st_mode & 0o777:o}")
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Bystander:
    """An unrelated process on a host; `list_harm` reports its signals."""

    name: str
    record: Path
    seen: Process

    def list_harm(self) -> list[str]:
        """Return one sentence for every signal, and for death or stop."""
        signals = [
            f"{self.name} got {event['event']} from {event['sender']}"
            for event in read_events(self.record)
            if event["event"] != "start"
        ]
        if not self.seen.alive:
            return [*signals, f"{self.name} is dead"]
        now = read_process(self.seen.pid)
        return [*signals, f"{self.name} is stopped"] if now and now.state in "Tt" else signals


def start_bystander(directory: Path, name: str, *words: str) -> tuple[Bystander, "subprocess.Popen[bytes]"]:
    """Start a bystander on this machine; ``words`` are added to its command line."""
    record = directory / f"{name}.bystander"
    running = subprocess.Popen(
        [sys.executable, str(BYSTANDER), str(record), *words],
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    return wait_for_bystander(name, record, running.pid), running


def wait_for_bystander(name: str, record: Path, pid: int) -> Bystander:
    """Wait until the bystander listens."""
    deadline = time.monotonic() + patience(30)
    while not (record.exists() and read_events(record)):
        assert time.monotonic() < deadline, f"bystander {name} did not start"
        time.sleep(0.02)
    seen = read_process(pid)
    assert seen is not None, f"bystander {name} died at once"
    return Bystander(name=name, record=record, seen=seen)


def kill_processes(found: Iterable[Process]) -> None:
    """Kill these very processes."""
    for each in found:
        if each.alive:
            with suppress(ProcessLookupError):
                os.kill(each.pid, signal.SIGKILL)
