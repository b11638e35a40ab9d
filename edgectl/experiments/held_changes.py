# SPDX-License-Identifier: Apache-2.0
"""Commands of a trial that are not undone yet, on disk: a run that was killed leaves no change behind."""

from collections.abc import Iterable

from edgectl.errors import FleetBusyError
from edgectl.experiments.event_actions import run_event_command
from edgectl.experiments.model.mission_event import EventCommand
from edgectl.formats.codec import decode, encode
from edgectl.formats.document import Faults
from edgectl.state.json_files import STATE_FORMAT_VERSION, read_json, write_json
from edgectl.usecases.fleet import Fleet

_FILE_NAME = "changes.json"


def save_held_changes(trial_fleet: Fleet, commands: Iterable[EventCommand]) -> None:
    """Record the commands that have to be undone. The record is on disk before a command runs.

    Raises:
        StateError: the disk does not take it.
    """
    path = trial_fleet.state / _FILE_NAME
    held = [encode(command) for command in commands if command.undo]
    if held or path.exists():
        document = {"format_version": STATE_FORMAT_VERSION, "commands": held}
        write_json(path, document, keep=False)


def undo_held_changes(trial_fleet: Fleet) -> None:
    """Undo the commands that a trial has left, the last one first.

    Raises:
        FleetBusyError: one cannot be undone.
    """
    path = trial_fleet.state / _FILE_NAME
    held = _load_commands(trial_fleet)
    while held:
        command = held[-1]
        error = run_event_command(trial_fleet, command, command.undo)
        if error:
            where = f"on {command.on}" if command.on else "on this computer"
            raise FleetBusyError(
                f"a change of a trial is not undone: {error}",
                hint=f"undo it {where} by hand, then delete {path}",
            )
        held.pop()
        save_held_changes(trial_fleet, held)


def _load_commands(trial_fleet: Fleet) -> list[EventCommand]:
    document = read_json(trial_fleet.state / _FILE_NAME)
    faults: Faults = []
    raw = document.get("commands") if isinstance(document, dict) else []
    commands = [decode(EventCommand, each, faults) for each in (raw if isinstance(raw, list) else ())]
    if faults:
        raise FleetBusyError(
            f"{trial_fleet.state / _FILE_NAME} is damaged, so that a change of a trial may not be undone",
            hint="undo it by hand, then delete the file",
        )
    return commands
