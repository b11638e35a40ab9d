# SPDX-License-Identifier: Apache-2.0
"""Heartbeats: the last contact of each host, and the hosts that the operator fenced.

Replacing a task depends on both. Times are uptimes of this machine, so that setting a clock cannot lengthen a
silence. Commands that take no lock write here too: every change is a merge under a lock of this file's own,
and a contact only ever becomes later.
"""

import contextlib
import fcntl
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field, replace
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.formats.document import FormatErrors
from edgectl.formats.kinds import DocumentKind
from edgectl.model.encoding import in_document
from edgectl.state.json_files import (
    FileStamp,
    Warn,
    ignore_warning,
    read_json,
    read_stamp,
    set_aside,
    write_json,
)
from edgectl.state.paths import open_private_file
from edgectl.state.uptime import Uptime, compute_elapsed_s

_FILE_NAME = "contacts.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Heartbeats:
    """Last contact of each host, the fenced hosts (declared off), and by host the tasks that had no
    supervisor there when it last answered: nothing stops those when the host falls silent.

    Nothing is known of a host that is in neither.
    """

    last: Mapping[str, Uptime] = field(default_factory=dict, metadata=in_document(required=True))
    fenced: frozenset[str] = field(default=frozenset(), metadata=in_document(required=True))
    orphans: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def to_instants(self, wall: float, now: Uptime) -> dict[str, float]:
        """The contacts as instants of a wall clock that shows ``wall`` at ``now``."""
        return {host: wall - compute_elapsed_s(since, now) for host, since in self.last.items()}


# By file: what it was when it was read last, and what it had.
_READ: dict[Path, tuple[FileStamp | None, Heartbeats]] = {}
_KIND = DocumentKind(name="file of heartbeats", version=1, model=Heartbeats)


def load_heartbeats(fleet_dir: Path, warn: Warn = ignore_warning) -> Heartbeats:
    """The stored heartbeats; a file that was not replaced since is not read again, as a watch asks often.

    A broken file is set aside and not replaced by the previous one, which would know of too old contacts.

    Raises:
        StateError: a newer edgectl wrote it.
    """
    path = fleet_dir / _FILE_NAME
    # Before it is read: what is written meanwhile is read the next time.
    stamp = read_stamp(path)
    known = _READ.get(path)
    if known is not None and stamp is not None and known[0] == stamp:
        return known[1]
    try:
        document = read_json(path)
        found = Heartbeats() if document is None else _KIND.decode(document)
    except (ValueError, FormatErrors) as error:
        warn(f"{path} is broken ({error}); set aside as {set_aside(path).name}")
        return Heartbeats()
    _READ[path] = (stamp, found)
    return found


def record_heartbeats(fleet_dir: Path, heard: Mapping[str, Uptime]) -> None:
    """Record contacts: the later one of each host is kept, and its fence is removed.

    Raises:
        StateError: the disk does not take it.
    """
    _update_heartbeats(fleet_dir, lambda known: _merge_heartbeats(known, heard))


def add_fences(fleet_dir: Path, hosts: Iterable[str]) -> Heartbeats:
    """Mark ``hosts`` as powered off.

    Raises:
        StateError: the disk does not take it.
    """
    return _update_heartbeats(fleet_dir, lambda known: replace(known, fenced=known.fenced | set(hosts)))


def remove_fences(fleet_dir: Path, hosts: Iterable[str]) -> Heartbeats:
    """Clear the fence of ``hosts``.

    Raises:
        StateError: the disk does not take it.
    """
    return _update_heartbeats(fleet_dir, lambda known: replace(known, fenced=known.fenced - set(hosts)))


def record_orphans(fleet_dir: Path, seen: Mapping[str, tuple[str, ...]]) -> Heartbeats:
    """Record the orphans of each host that answered; those of other hosts stay.

    Raises:
        StateError: the disk does not take it.
    """

    def merge(known: Heartbeats) -> Heartbeats:
        merged = {host: tasks for host, tasks in {**known.orphans, **seen}.items() if tasks}
        return replace(known, orphans=merged)

    return _update_heartbeats(fleet_dir, merge)


def replace_marks(
    fleet_dir: Path,
    *,
    fenced: frozenset[str],
    orphans: Mapping[str, tuple[str, ...]],
    heard: Mapping[str, Uptime],
) -> Heartbeats:
    """Replace fences by those of another machine, add its orphans, and record ``heard`` as contacts. Either
    machine may have seen an orphan last; which ones are left is known once their host answers.

    Raises:
        StateError: the disk does not take it.
    """

    def change(known: Heartbeats) -> Heartbeats:
        both = {
            host: tuple(sorted({*known.orphans.get(host, ()), *orphans.get(host, ())}))
            for host in known.orphans.keys() | orphans.keys()
        }
        return replace(_merge_heartbeats(known, heard), fenced=fenced, orphans=both)

    return _update_heartbeats(fleet_dir, change)


def _merge_heartbeats(known: Heartbeats, heard: Mapping[str, Uptime]) -> Heartbeats:
    later = {host: at for host, at in heard.items() if _is_later(at, known.last.get(host))}
    return replace(known, last={**known.last, **later}, fenced=known.fenced - heard.keys())


def _is_later(one: Uptime, other: Uptime | None) -> bool:
    """Whether to keep ``one``, which was taken in this very run, over ``other``."""
    return other is None or one.boot != other.boot or one.seconds > other.seconds


def _update_heartbeats(fleet_dir: Path, change: Callable[[Heartbeats], Heartbeats]) -> Heartbeats:
    with _lock_heartbeats(fleet_dir):
        known = load_heartbeats(fleet_dir)
        changed = change(known)
        if changed != known:
            write_json(fleet_dir / _FILE_NAME, _KIND.encode(changed))
    return changed


@contextlib.contextmanager
def _lock_heartbeats(fleet_dir: Path) -> Iterator[None]:
    """The lock of this file: held for one write, never while a host is asked."""
    descriptor = open_private_file(fleet_dir / f"{_FILE_NAME}.lock", os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
