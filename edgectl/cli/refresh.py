"""A fleet that follows its files: read anew where they changed."""

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from edgectl.cli.inputs import Loaded, inventory_file, task_files
from edgectl.cli.reach import reach
from edgectl.errors import EdgectlError
from edgectl.usecases.fleet import Fleet

Seen = tuple[tuple[str, int, int, int], ...]


def refreshing(inventory: Path | None, tasks: Sequence[Path] | None, *, accept_new: bool) -> Callable[[], Fleet | None]:
    """What to call now and then: a new fleet where its files, or those of ssh, changed since the last call, else None.

    It raises an EdgectlError while the files are broken.
    """
    seen, broken = _seen(inventory, tasks, accept_new=accept_new), None

    def refresh() -> Fleet | None:
        nonlocal seen, broken
        now = _seen(inventory, tasks, accept_new=accept_new)
        if now == seen:
            if broken is not None:
                raise broken.with_traceback(None)
            return None
        seen = now
        try:
            fleet = reach(_read(inventory, tasks), accept_new=accept_new, asking=False)
        except EdgectlError as error:
            broken = error
            raise
        broken = None
        return fleet

    return refresh


def _read(inventory: Path | None, tasks: Sequence[Path] | None) -> Loaded:
    from edgectl.config.load import load

    path = inventory_file(inventory)
    fleet, work, _warnings = load(path, task_files(tasks))
    return Loaded(inventory=fleet, tasks=work, path=path)


def _seen(inventory: Path | None, tasks: Sequence[Path] | None, *, accept_new: bool) -> Seen:
    """Which files there are, and when they changed. Keys that we accept ourselves change known_hosts, which is no news then."""
    try:
        files = [inventory_file(inventory), *task_files(tasks)]
    except EdgectlError:
        files = []
    ssh = [Path.home() / ".ssh" / "config", *([] if accept_new else [Path.home() / ".ssh" / "known_hosts"])]
    own = os.environ.get("EDGECTL_SSH_CONFIG")
    return tuple(_marks([*files, *ssh, *([Path(own)] if own else [])]))


def _marks(paths: Iterable[Path]) -> Iterable[tuple[str, int, int, int]]:
    for path in paths:
        try:
            found = path.stat()
        except OSError:
            yield str(path), 0, 0, 0
        else:
            yield str(path), found.st_ino, found.st_size, found.st_mtime_ns
