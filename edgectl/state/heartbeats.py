"""When each host was last in touch, and which hosts the operator declared switched off. What may be started elsewhere hangs on both.

Times are uptimes of this machine, so that a clock that is set cannot make a silence longer than it was. Commands that take no
lock write here too: every change is a merge under a lock of this file's own, and a contact only ever becomes later.
"""

import contextlib
import fcntl
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from edgectl.state.json_files import (
    STATE_FORMAT_VERSION,
    Warn,
    ignore_warning,
    read_json,
    set_aside,
    write_json,
)
from edgectl.state.paths import open_private_file
from edgectl.state.uptime import Uptime, compute_elapsed_s

_FILE_NAME = "contacts.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Heartbeats:
    """Last contact of each host; hosts declared off. Nothing is known of a host that is in neither."""

    last: Mapping[str, Uptime] = field(default_factory=dict)
    fenced: frozenset[str] = frozenset()

    def to_instants(self, wall: float, now: Uptime) -> dict[str, float]:
        """The contacts as instants of a wall clock that shows ``wall`` at ``now``."""
        return {host: wall - compute_elapsed_s(since, now) for host, since in self.last.items()}


def load_heartbeats(fleet_dir: Path, warn: Warn = ignore_warning) -> Heartbeats:
    """What is known. A broken file is set aside; then nothing is known, and nothing is replaced: an older file would say too much.

    Raises:
        StateError: a newer edgectl wrote it.
    """
    path = fleet_dir / _FILE_NAME
    try:
        document = read_json(path)
        return Heartbeats() if document is None else _decode_heartbeats(document)
    except ValueError as error:
        warn(f"{path} is broken ({error}); set aside as {set_aside(path).name}")
        return Heartbeats()


def record_heartbeats(fleet_dir: Path, heard: Mapping[str, Uptime]) -> None:
    """Hosts were in touch: later contacts are kept, and none of them is switched off.

    Raises:
        StateError: the disk does not take it.
    """
    _update_heartbeats(fleet_dir, lambda known: _merge_heartbeats(known, heard))


def add_fences(fleet_dir: Path, hosts: Iterable[str]) -> Heartbeats:
    """Take the operator's word that ``hosts`` are switched off.

    Raises:
        StateError: the disk does not take it.
    """
    return _update_heartbeats(fleet_dir, lambda known: replace(known, fenced=known.fenced | set(hosts)))


def remove_fences(fleet_dir: Path, hosts: Iterable[str]) -> Heartbeats:
    """Take that back.

    Raises:
        StateError: the disk does not take it.
    """
    return _update_heartbeats(fleet_dir, lambda known: replace(known, fenced=known.fenced - set(hosts)))


def _merge_heartbeats(known: Heartbeats, heard: Mapping[str, Uptime]) -> Heartbeats:
    later = {host: at for host, at in heard.items() if _is_later(at, known.last.get(host))}
    return Heartbeats(last={**known.last, **later}, fenced=known.fenced - heard.keys())


def _is_later(one: Uptime, other: Uptime | None) -> bool:
    """Whether to keep ``one``, which was taken in this very run, over ``other``."""
    return other is None or one.boot != other.boot or one.seconds > other.seconds


def _update_heartbeats(fleet_dir: Path, change: Callable[[Heartbeats], Heartbeats]) -> Heartbeats:
    with _lock_heartbeats(fleet_dir):
        known = load_heartbeats(fleet_dir)
        changed = change(known)
        if changed != known:
            write_json(fleet_dir / _FILE_NAME, _encode_heartbeats(changed))
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


def _encode_heartbeats(contacts: Heartbeats) -> dict[str, object]:
    last = {host: {"boot": at.boot, "uptime_s": at.seconds} for host, at in sorted(contacts.last.items())}
    return {"format_version": STATE_FORMAT_VERSION, "last": last, "fenced": sorted(contacts.fenced)}


def _decode_heartbeats(document: dict[str, object]) -> Heartbeats:
    last, fenced = document.get("last"), document.get("fenced")
    if (
        not isinstance(last, dict)
        or not isinstance(fenced, list)
        or not all(isinstance(host, str) for host in fenced)
    ):
        raise ValueError("last must be an object and fenced a list of names")
    return Heartbeats(
        last={host: _decode_uptime(value) for host, value in last.items()}, fenced=frozenset(fenced)
    )


def _decode_uptime(value: object) -> Uptime:
    boot, seconds = (value.get("boot"), value.get("uptime_s")) if isinstance(value, dict) else (None, None)
    if (
        not isinstance(boot, str)
        or isinstance(seconds, bool)
        or not isinstance(seconds, int | float)
        or not 0 <= seconds < float("inf")
    ):
        raise ValueError(f"not an uptime: {value!r}")
    return Uptime(boot=boot, seconds=float(seconds))
