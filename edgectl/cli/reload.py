"""Reload of a fleet when its files change."""

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from edgectl.cli.connect import build_fleet
from edgectl.cli.project import choose_files, find_project_path, get_user_file
from edgectl.cli.user_files import LoadedInputs, list_task_files, list_task_paths, select_exposed
from edgectl.errors import EdgectlError
from edgectl.usecases.fleet import Fleet

FileStats = tuple[tuple[str, int, int, int], ...]


def build_fleet_reloader(
    inventory: Sequence[Path] | None, tasks: Sequence[Path] | None, *, accept_new: bool
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


def _load_inputs_quietly(inventory: Sequence[Path] | None, tasks: Sequence[Path] | None) -> LoadedInputs:
    from edgectl.config.load import load_inventory_and_tasks

    chosen = choose_files(inventory, tasks)
    fleet, work, warnings = load_inventory_and_tasks(chosen.inventories, list_task_paths(chosen))
    exposed = select_exposed(warnings)
    return LoadedInputs(inventory=fleet, tasks=work, path=chosen.inventories[0], exposed=exposed)


def _fingerprint_files(
    inventory: Sequence[Path] | None, tasks: Sequence[Path] | None, *, accept_new: bool
) -> FileStats:
    """Names and times of the files. Keys that edgectl accepts change known_hosts; they are not a change."""
    settings = [path for path in (find_project_path(), get_user_file()) if path is not None]
    try:
        chosen = choose_files(inventory, tasks)
        files = [*chosen.inventories, *list_task_files(chosen)]
    except EdgectlError:
        files = []
    ssh = [Path.home() / ".ssh" / "config", *([] if accept_new else [Path.home() / ".ssh" / "known_hosts"])]
    own = os.environ.get("EDGECTL_SSH_CONFIG")
    return tuple(_stat_files([*files, *settings, *ssh, *([Path(own)] if own else [])]))


def _stat_files(paths: Iterable[Path]) -> Iterable[tuple[str, int, int, int]]:
    for path in paths:
        try:
            found = path.stat()
        except OSError:
            yield str(path), 0, 0, 0
        else:
            yield str(path), found.st_ino, found.st_size, found.st_mtime_ns
