"""What the kernel says: processes by a word in their command line, file locks by inode, canaries by their records. Standard library only."""

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

CANARY = Path(__file__).with_name("canary.py")


@dataclass(frozen=True, slots=True, kw_only=True)
class Process:
    """A process as the machine's own /proc shows it; ``ticks`` (its start) tells it from a later one with its pid."""

    pid: int
    parent: int
    state: str
    ticks: int
    command: str

    @property
    def alive(self) -> bool:
        """Whether this very process still runs."""
        found = process(self.pid)
        return found is not None and found.ticks == self.ticks and found.state not in "ZX"


def process(pid: int) -> Process | None:
    """The process with that pid, or None."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
        command = (
            Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
        )
    except OSError:
        return None
    return Process(pid=pid, parent=int(fields[1]), state=fields[0], ticks=int(fields[19]), command=command)


def processes() -> list[Process]:
    """All processes of the machine, zombies left out."""
    found = (
        process(int(entry)) for entry in (each.name for each in Path("/proc").iterdir()) if entry.isdigit()
    )
    return [each for each in found if each is not None and each.state not in "ZX"]


def marked(word: str) -> list[Process]:
    """The processes with ``word`` in their command line: every process of a test task carries the word of its fleet."""
    return [each for each in processes() if word in each.command and each.pid != os.getpid()]


def with_environment(name: str, value: str) -> list[Process]:
    """The processes with ``name=value`` in the environment that they were started with."""
    wanted, found = f"{name}={value}\0".encode(), []
    for each in processes():
        with suppress(OSError):
            if wanted in Path(f"/proc/{each.pid}/environ").read_bytes() + b"\0":
                found.append(each)
    return found


def in_namespace(kind: str, inode: int) -> list[Process]:
    """The processes in that namespace (``pid``, ``net``, ``mnt`` ..) by its inode number."""
    found = []
    for each in processes():
        with suppress(OSError):
            if Path(f"/proc/{each.pid}/ns/{kind}").stat().st_ino == inode:
                found.append(each)
    return found


def locks_under(*directories: Path) -> list[str]:
    """``path held by PID`` for every file below the directories on which somebody holds a lock."""
    holders = {}
    for line in Path("/proc/locks").read_text().splitlines():
        fields = line.split()
        if fields[1] != "->":  # somebody who waits
            major, minor, inode = fields[5].split(":")
            holders[os.makedev(int(major, 16), int(minor, 16)), int(inode)] = fields[4]
    found = []
    for path in files_under(*directories):
        with suppress(OSError):
            info = path.stat()
            if holder := holders.get((info.st_dev, info.st_ino)):
                found.append(f"{path} held by {holder}")
    return found


def files_under(*directories: Path) -> list[Path]:
    """Every file below the directories."""
    return [Path(base) / name for top in directories for base, _, names in os.walk(top) for name in names]


def exposed(*directories: Path) -> list[str]:
    """Files that others may read and directories that others may enter."""
    found = []
    for top in directories:
        for base, _, names in os.walk(top):
            for path in (Path(base), *(Path(base) / name for name in names)):
                with suppress(OSError):
                    if not path.is_symlink() and path.stat().st_mode & 0o077:
                        found.append(f"{path} {path.stat().st_mode & 0o777:o}")
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Canary:
    """A foreign process on a host; `harm` tells what was done to it."""

    name: str
    record: Path
    seen: Process

    def harm(self) -> list[str]:
        """One sentence for every signal, and for death or standstill."""
        signals = [
            f"{self.name} got {event['event']} from {event['sender']}"
            for event in read_events(self.record)
            if event["event"] != "start"
        ]
        if not self.seen.alive:
            return [*signals, f"{self.name} is dead"]
        now = process(self.seen.pid)
        return [*signals, f"{self.name} is stopped"] if now and now.state in "Tt" else signals


def start_canary(directory: Path, name: str, *words: str) -> tuple[Canary, "subprocess.Popen[bytes]"]:
    """A canary on this machine; ``words`` go into its command line."""
    record = directory / f"{name}.canary"
    running = subprocess.Popen(
        [sys.executable, str(CANARY), str(record), *words], stdin=subprocess.DEVNULL, start_new_session=True
    )
    return wait_for_canary(name, record, running.pid), running


def wait_for_canary(name: str, record: Path, pid: int) -> Canary:
    """The canary once it listens."""
    deadline = time.monotonic() + patience(30)
    while not (record.exists() and read_events(record)):
        assert time.monotonic() < deadline, f"canary {name} did not start"
        time.sleep(0.02)
    seen = process(pid)
    assert seen is not None, f"canary {name} died at once"
    return Canary(name=name, record=record, seen=seen)


def end(found: Iterable[Process]) -> None:
    """Kill these very processes."""
    for each in found:
        if each.alive:
            with suppress(ProcessLookupError):
                os.kill(each.pid, signal.SIGKILL)
