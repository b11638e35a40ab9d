"""The manager's memory of a fleet on disk: a cache and a history. Losing it costs history, never a running task."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path

from edgectl.formats import manager_state as form
from edgectl.formats.document import FormatErrors
from edgectl.model.manager_state import ManagerState
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.json_files import STATE_FORMAT_VERSION, Warn, ignore_warning, load_or_set_aside, write_json

MANAGER_STATE_FILE_NAME = "memory.json"


def load_manager_state(fleet_dir: Path, warn: Warn = ignore_warning) -> ManagerState:
    """What is remembered of the fleet; empty where nothing is. A broken file is set aside and said through ``warn``.

    Raises:
        StateError: a newer edgectl wrote it.
    """
    return load_or_set_aside(fleet_dir / MANAGER_STATE_FILE_NAME, _decode_manager_state, ManagerState(), warn)


def _decode_manager_state(document: dict[str, object]) -> ManagerState:
    try:
        return form.decode(document)
    except FormatErrors as error:
        raise ValueError(error.message) from error


def select_saved_fields(memory: ManagerState) -> ManagerState:
    """What this file keeps: contacts and fences stand in a file of their own (``state.contacts``), measured demands in the history."""
    return dataclasses.replace(memory, contact={}, fenced=frozenset(), measured={})


def save_manager_state(fleet_dir: Path, memory: ManagerState) -> None:
    """Replace what is remembered, whole or not at all.

    Raises:
        StateError: the disk does not take it.
    """
    write_json(fleet_dir / MANAGER_STATE_FILE_NAME, form.encode(select_saved_fields(memory)))


_LINKS_FILE_NAME = "links.json"
LinkCapacities = Mapping[tuple[str, str], float]


def load_link_capacities(fleet_dir: Path, warn: Warn = ignore_warning) -> LinkCapacities:
    """The measured capacities; empty where none were measured."""
    return load_or_set_aside(fleet_dir / _LINKS_FILE_NAME, _decode_link_capacities, {}, warn)


def save_link_capacities(fleet_dir: Path, capacities: LinkCapacities) -> None:
    """Replace the measured capacities."""
    links: dict[str, dict[str, float]] = {}
    for (edge, robot), value in sorted(capacities.items()):
        links.setdefault(edge, {})[robot] = value
    write_json(fleet_dir / _LINKS_FILE_NAME, {"format_version": STATE_FORMAT_VERSION, "links": links})


def _decode_link_capacities(document: dict[str, object]) -> LinkCapacities:
    edges = document.get("links")
    if not isinstance(edges, dict) or not all(isinstance(robots, dict) for robots in edges.values()):
        raise ValueError("links must be an object of objects")
    return {
        (edge, robot): _decode_rate(value)
        for edge, robots in edges.items()
        for robot, value in robots.items()
    }


def _decode_rate(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
        raise ValueError(f"not a rate: {value!r}")
    return float(value)


_IGNORED_FILE_NAME = "reopened.json"
_MAX_IGNORED = 1000


def load_ignored_instances(fleet_dir: Path, warn: Warn = ignore_warning) -> tuple[str, ...]:
    """The instances, oldest first."""
    return load_or_set_aside(fleet_dir / _IGNORED_FILE_NAME, _decode_ignored_instances, (), warn)


def save_ignored_instances(fleet_dir: Path, instances: tuple[str, ...]) -> None:
    """Replace them; the oldest are dropped beyond a thousand."""
    write_json(
        fleet_dir / _IGNORED_FILE_NAME,
        {"format_version": STATE_FORMAT_VERSION, "instances": list(instances[-_MAX_IGNORED:])},
    )


def _decode_ignored_instances(document: dict[str, object]) -> tuple[str, ...]:
    instances = document.get("instances")
    if not isinstance(instances, list) or not all(isinstance(instance, str) for instance in instances):
        raise ValueError("instances must be a list of strings")
    return tuple(instances)


StateFingerprint = tuple[tuple[int, int, int] | None, ...]


def fingerprint_state_files(fleet_dir: Path) -> StateFingerprint:
    """What changes whenever the memory or the journal of a fleet is written."""
    return tuple(_file_fingerprint(fleet_dir / name) for name in (MANAGER_STATE_FILE_NAME, JOURNAL_FILE_NAME))


def _file_fingerprint(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
