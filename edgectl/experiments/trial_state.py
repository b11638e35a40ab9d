# SPDX-License-Identifier: Apache-2.0
"""State directories of trials: each trial runs as a new manager, isolated from the fleet's own state.

A directory that a killed run leaves behind is found again, so that what its trial started can be stopped and
forgotten.
"""

import shutil
from dataclasses import replace
from pathlib import Path

from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import Snapshot, TaskState
from edgectl.state.journal import JOURNAL_FILE_NAME, Journal
from edgectl.state.journal_reader import read_journal_cached
from edgectl.state.json_files import STATE_FORMAT_VERSION, read_json, write_json
from edgectl.state.manager_identity import copy_manager_id
from edgectl.state.manager_state import (
    fingerprint_state_files,
    load_ignored_instances,
    load_link_capacities,
    load_manager_state,
    save_ignored_instances,
    save_link_capacities,
    save_manager_state,
)
from edgectl.state.paths import ensure_private_dir
from edgectl.state.store_handle import StoreHandle
from edgectl.usecases.fleet import Fleet

_STATE_DIR_PREFIX, _FINGERPRINT_FILE_NAME = "trial-", "before.json"


def create_trial_fleet(fleet: Fleet, name: str, before: Snapshot) -> Fleet:
    """The fleet as seen by a new manager that knows cordons, drains, link capacities and holds only.

    Instances that had ended in ``before`` are ignored. The clock is monotonic: setting the system time does
    not move it.
    """
    state = ensure_private_dir(fleet.state / f"{_STATE_DIR_PREFIX}{name}")
    began, since = fleet.clock(), fleet.uptime().seconds
    known = load_manager_state(fleet.state, fleet.warn)
    ignored = (*load_ignored_instances(fleet.state, fleet.warn), *collect_ended_instances(before))
    write_json(state / _FINGERPRINT_FILE_NAME, _encode_state_fingerprint(fleet), keep=False)
    save_manager_state(state, ManagerState(cordons=known.cordons, draining=known.draining))
    save_link_capacities(state, load_link_capacities(fleet.state, fleet.warn))
    copy_manager_id(fleet.state, state)
    save_ignored_instances(state, tuple(dict.fromkeys(ignored)))
    _transfer_holds(fleet, fleet.state, state, release=False)
    return replace(
        fleet, state=state, history=StoreHandle(), clock=lambda: began + fleet.uptime().seconds - since
    )


def reopen_trial_fleets(fleet: Fleet) -> list[Fleet]:
    """The fleet as seen by each trial whose state directory is still there."""
    return [
        replace(fleet, state=ensure_private_dir(state), history=StoreHandle())
        for state in sorted(fleet.state.glob(f"{_STATE_DIR_PREFIX}*"))
    ]


def is_fleet_state_unchanged(fleet: Fleet, trial_fleet: Fleet) -> bool:
    """Whether the state files of the fleet are as at the trial's start: no other edgectl has changed it."""
    try:
        recorded = read_json(trial_fleet.state / _FINGERPRINT_FILE_NAME)
    except ValueError:
        return False
    return recorded in (None, _encode_state_fingerprint(fleet))


def load_started_generations(trial_fleet: Fleet) -> dict[str, int]:
    """By task, the highest generation that the trial may have started."""
    with Journal.open(trial_fleet.state, clock=trial_fleet.clock, warn=trial_fleet.warn) as journal:
        generations = dict(journal.log.generations)
    for name, placement in load_manager_state(trial_fleet.state, trial_fleet.warn).placements.items():
        generations[name] = max(generations.get(name, 0), placement.generation)
    return generations


def collect_ended_instances(snapshot: Snapshot) -> dict[str, tuple[str, int]]:
    """Instance -> (task, generation) of instances that have completed or failed and are not restarted."""
    return {
        sample.instance: (task, sample.generation)
        for host in snapshot.hosts.values()
        for task, sample in host.tasks.items()
        if sample.state is TaskState.COMPLETED or sample.given_up
    }


def delete_trial_state(
    fleet: Fleet, trial_fleet: Fleet, ended_instances: list[str], *, release: bool
) -> None:
    """Delete the state of a trial.

    The fleet ignores ``ended_instances`` from now on and takes over the trial's holds.

    ``release``: also record that the trial released holds of the fleet.
    """
    ignored = (*load_ignored_instances(fleet.state, fleet.warn), *ended_instances)
    save_ignored_instances(fleet.state, ignored)
    _transfer_holds(fleet, trial_fleet.state, fleet.state, release=release)
    shutil.rmtree(trial_fleet.state)


def _encode_state_fingerprint(fleet: Fleet) -> dict[str, object]:
    return {
        "format_version": STATE_FORMAT_VERSION,
        "stamp": [each and list(each) for each in fingerprint_state_files(fleet.state)],
    }


def _transfer_holds(fleet: Fleet, source: Path, target: Path, *, release: bool) -> None:
    """Copy holds from the journal of ``source`` to that of ``target``: the next manager releases the robot.

    ``release``: a hold that only ``target`` knows was released meanwhile, and is recorded as such.
    """
    held = set(read_journal_cached(source / JOURNAL_FILE_NAME).held)
    known = set(read_journal_cached(target / JOURNAL_FILE_NAME).held)
    events = [("phase", task) for task in held - known]
    if release:
        events += (("released", task) for task in known - held)
    if events:
        with Journal.open(target, clock=fleet.clock, warn=fleet.warn) as journal:
            for event, task in sorted(events):
                journal.append(event, task=task, **({"phase": "hold"} if event == "phase" else {}))
