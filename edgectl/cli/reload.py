"""Reload of a fleet when its files change."""

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from edgectl.cli.connect import build_fleet
from edgectl.cli.user_files import (
    LoadedInputs,
    choose_task_paths,
    resolve_inventory_path,
    resolve_task_paths,
    select_exposed,
)
from edgectl.errors import EdgectlError
from edgectl.usecases.fleet import Fleet

FileStats = tuple[tuple[str, int, int, int], ...]


def build_fleet_reloader(
    inventory: Path | None, tasks: Sequence[Path] | None, *, accept_new: bool
) -> Callable[[], Fleet | None]:
    """A function that returns a new fleet if its files, or those of ssh, changed since the last call, else
    None.

    It raises an EdgectlError while the files are broken.
    """
    seen, broken = _fingerprint_files(inventory, tasks, accept_new=accept_new), None

    def refresh() -> Fleet | None:
        nonlocal seen, broken
        now = _fingerprint_files(inventory, tasks, accept_new=accept_new)
        if now == seen:
            if broken is not None:
                raise broken.with_traceback(None)
            return None
        seen = now
        try:
            fleet = build_fleet(_load_inputs_quietly(inventory, tasks), accept_new=accept_new, asking=False)
        except EdgectlError as error:
            broken = error
            raise
        broken = None
        return fleet

    return refresh


def _load_inputs_quietly(inventory: Path | None, tasks: Sequence[Path] | None) -> LoadedInputs:
    from edgectl.config.load import load_inventory_and_tasks

    path = resolve_inventory_path(inventory)
    fleet, work, warnings = load_inventory_and_tasks(path, choose_task_paths(tasks))
    return LoadedInputs(inventory=fleet, tasks=work, path=path, exposed=select_exposed(warnings))


def _fingerprint_files(
    inventory: Path | None, tasks: Sequence[Path] | None, *, accept_new: bool
) -> FileStats:
    """Names and times of the files. Keys that edgectl accepts change known_hosts; they are not a change."""
    try:
        files = [resolve_inventory_path(inventory), *resolve_task_paths(tasks)]
    except EdgectlError:
        files = []
    ssh = [Path.home() / ".ssh" / "config", *([] if accept_new else [Path.home() / ".ssh" / "known_hosts"])]
    own = os.environ.get("EDGECTL_SSH_CONFIG")
    return tuple(_stat_files([*files, *ssh, *([Path(own)] if own else [])]))


def _stat_files(paths: Iterable[Path]) -> Iterable[tuple[str, int, int, int]]:
    for path in paths:
        try:
            found = path.stat()
        except OSError:
            yield str(path), 0, 0, 0
        else:
            yield str(path), found.st_ino, found.st_size, found.st_mtime_ns
