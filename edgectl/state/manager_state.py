# SPDX-License-Identifier: Apache-2.0
"""State of the manager on disk: a cache and a history. Losing it costs history, never a running task."""

import dataclasses
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.formats.kinds import MANAGER_STATE_KIND, DocumentKind
from edgectl.model.encoding import Instant, in_document
from edgectl.model.manager_state import ManagerState
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.json_files import Warn, ignore_warning, load_or_set_aside, write_json

MANAGER_STATE_FILE_NAME = "memory.json"


def load_manager_state(fleet_dir: Path, warn: Warn = ignore_warning) -> ManagerState:
    """The stored state; empty where there is none. A broken file is set aside and reported through ``warn``.

    Raises:
        StateError: a newer edgectl wrote it.
    """
    return load_or_set_aside(
        fleet_dir / MANAGER_STATE_FILE_NAME, MANAGER_STATE_KIND.decode, ManagerState(), warn
    )


def select_saved_fields(manager: ManagerState) -> ManagerState:
    """The part that this file keeps: heartbeats and fences have a file of their own, measured demands and
    noise stand in the history.
    """
    return dataclasses.replace(manager, contact={}, fenced=frozenset(), measured={}, noise={})


def save_manager_state(fleet_dir: Path, manager: ManagerState) -> None:
    """Replace the stored state, whole or not at all.

    Raises:
        StateError: the disk does not take it.
    """
    write_json(fleet_dir / MANAGER_STATE_FILE_NAME, MANAGER_STATE_KIND.encode(select_saved_fields(manager)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredLinks:
    """Measured link capacities in bytes/s by edge, then robot."""

    links: Mapping[str, Mapping[str, float]] = field(
        default_factory=dict, metadata=in_document(required=True)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredInstances:
    """Instances whose end no longer counts, oldest first."""

    instances: tuple[str, ...] = field(default=(), metadata=in_document(required=True))


_LINKS_FILE_NAME = "links.json"
_LINKS_KIND = DocumentKind(name="file of measured links", version=1, model=_StoredLinks)
LinkCapacities = Mapping[tuple[str, str], float]


def load_link_capacities(fleet_dir: Path, warn: Warn = ignore_warning) -> LinkCapacities:
    """The measured capacities; empty where none were measured."""
    stored = load_or_set_aside(fleet_dir / _LINKS_FILE_NAME, _LINKS_KIND.decode, _StoredLinks(), warn)
    return {(edge, robot): rate for edge, robots in stored.links.items() for robot, rate in robots.items()}


def save_link_capacities(fleet_dir: Path, capacities: LinkCapacities) -> None:
    """Replace the measured capacities."""
    links: dict[str, dict[str, float]] = {}
    for (edge, robot), value in sorted(capacities.items()):
        links.setdefault(edge, {})[robot] = value
    write_json(fleet_dir / _LINKS_FILE_NAME, _LINKS_KIND.encode(_StoredLinks(links=links)))


_IGNORED_FILE_NAME = "reopened.json"
_IGNORED_KIND = DocumentKind(name="file of ignored instances", version=1, model=_StoredInstances)
_MAX_IGNORED = 1000


def load_ignored_instances(fleet_dir: Path, warn: Warn = ignore_warning) -> tuple[str, ...]:
    """The instances, oldest first."""
    path = fleet_dir / _IGNORED_FILE_NAME
    return load_or_set_aside(path, _IGNORED_KIND.decode, _StoredInstances(), warn).instances


def save_ignored_instances(fleet_dir: Path, instances: tuple[str, ...]) -> None:
    """Replace them; the oldest are dropped beyond a thousand."""
    stored = _StoredInstances(instances=instances[-_MAX_IGNORED:])
    write_json(fleet_dir / _IGNORED_FILE_NAME, _IGNORED_KIND.encode(stored))


@dataclass(frozen=True, slots=True, kw_only=True)
class Reminder:
    """When an unattended run last reported (s since 1970) that the run ``instance`` is given up."""

    instance: str = field(metadata=in_document(required=True))
    at: Instant = field(metadata=in_document(required=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredReminders:
    """Reminders by task."""

    tasks: Mapping[str, Reminder] = field(default_factory=dict, metadata=in_document(required=True))


_REMINDERS_FILE_NAME = "reminders.json"
_REMINDERS_KIND = DocumentKind(name="file of reminders", version=1, model=_StoredReminders)


def load_reminders(fleet_dir: Path, warn: Warn = ignore_warning) -> Mapping[str, Reminder]:
    """The reminders by task."""
    path = fleet_dir / _REMINDERS_FILE_NAME
    return load_or_set_aside(path, _REMINDERS_KIND.decode, _StoredReminders(), warn).tasks


def save_reminders(fleet_dir: Path, reminders: Mapping[str, Reminder]) -> None:
    """Replace them.

    Raises:
        StateError: the disk does not take it.
    """
    write_json(fleet_dir / _REMINDERS_FILE_NAME, _REMINDERS_KIND.encode(_StoredReminders(tasks=reminders)))


StateFingerprint = tuple[tuple[int, int, int] | None, ...]


def fingerprint_state_files(fleet_dir: Path) -> StateFingerprint:
    """Fingerprints that change whenever the state or the journal of a fleet is written."""
    return tuple(_file_fingerprint(fleet_dir / name) for name in (MANAGER_STATE_FILE_NAME, JOURNAL_FILE_NAME))


def _file_fingerprint(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
