# SPDX-License-Identifier: Apache-2.0
"""Starts of which nobody knows whether they happened, while the old instance of the task may still run.

Such a start is kept beside the record of the task's place, never in its stead, until its host has answered,
the old one has shown that nothing runs there, or a later start has replaced it (ADR 189).
"""

import dataclasses
from collections.abc import Mapping

from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import Snapshot
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.journal_reader import read_journal_cached
from edgectl.state.manager_state import load_manager_state
from edgectl.state.shared_state import PendingStart
from edgectl.usecases.coordination import load_pending_starts
from edgectl.usecases.fleet import Fleet

Starts = Mapping[str, PendingStart]


def load_doubtful_starts(fleet: Fleet) -> Starts:
    """The starts that were announced in etcd, and those that the journal of this machine has beside an old
    instance; of two of a task the later one.
    """
    found = dict(load_pending_starts(fleet))
    for task, start in load_journaled_doubts(fleet).items():
        if task not in found or found[task].generation <= start.generation:
            found[task] = start
    return found


def load_journaled_doubts(fleet: Fleet) -> Starts:
    """Those of the journal alone."""
    doubtful = read_journal_cached(fleet.state / JOURNAL_FILE_NAME).doubtful
    return {task: PendingStart(host=host, generation=at) for task, (host, at) in doubtful.items()}


def encode_journaled_doubts(fleet: Fleet, starts: Starts) -> dict[str, tuple[str, int]]:
    """Those of ``starts`` that the journal has, as one of its entries names them."""
    own = load_journaled_doubts(fleet)
    return {task: (start.host, start.generation) for task, start in starts.items() if task in own}


def list_open_starts(
    fleet: Fleet, snapshot: Snapshot, after: ManagerState, used: Mapping[str, int]
) -> Starts:
    """Those whose host has not answered since, and which no later start has replaced; ``used``: the
    generations of a run that has just ended, after the ``snapshot``.
    """
    fresh = {
        task for task, start in load_journaled_doubts(fleet).items() if used.get(task) == start.generation
    }
    return {
        task: start
        for task, start in load_doubtful_starts(fleet).items()
        if task in fresh or not_heard(snapshot, start.host)
        if task not in after.placements or after.placements[task].generation < start.generation
    }


def restore_known_places(fleet: Fleet, snapshot: Snapshot, after: ManagerState) -> ManagerState:
    """``after`` with the recorded place of each task that lives there, where a doubtful start on a silent
    host stands in its stead: that one may come back without it, when nobody can see the recorded place.
    """
    known = load_manager_state(fleet.state).placements
    lives = {
        task: known[task]
        for task, start in load_doubtful_starts(fleet).items()
        if not_heard(snapshot, start.host) and task in known and task in after.placements
        if (after.placements[task].host, after.placements[task].generation) == (start.host, start.generation)
        if known[task].host != start.host and _is_alive(snapshot, known[task].host, task)
    }
    return dataclasses.replace(after, placements={**after.placements, **lives}) if lives else after


def not_heard(snapshot: Snapshot, host: str) -> bool:
    """Whether ``host`` did not answer, or was not asked."""
    return host not in snapshot.hosts or not snapshot.hosts[host].ok


def _is_alive(snapshot: Snapshot, host: str, task: str) -> bool:
    sample = snapshot.hosts.get(host)
    return sample is not None and sample.ok and task in sample.tasks and sample.tasks[task].state.alive
