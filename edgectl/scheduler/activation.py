# SPDX-License-Identifier: Apache-2.0
"""Activation of a copy in place of a start, for a task whose active instance is gone. Pure."""

from dataclasses import replace

from edgectl.model.assignment import Reason, Verdict
from edgectl.model.snapshot import TaskSample, TaskState
from edgectl.model.task import Task
from edgectl.scheduler.candidates import CandidateSet
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.initial_state import InitialState
from edgectl.scheduler.scan import is_feasible_total


def is_usable(sample: TaskSample | None, task: Task) -> bool:
    """Whether an instance can become the task or its copy as it is: of the present specification, and with a
    supervisor.
    """
    return sample is not None and sample.spec_hash == task.spec_hash and not sample.orphaned


def prefer_standby(choice: Choice, candidates: CandidateSet, state: InitialState) -> Choice:
    """``choice``, or the place of a copy if the task ran nowhere before the plan and has room there.

    A start takes seconds and an activation milliseconds, and meanwhile the robot has neither: the gap counts
    more than what another host is better. A copy that is ready comes first, then of a task with state the
    one that was active last, which has that state in memory (ADR 122), then the greater total.
    """
    task = candidates.task
    copies = state.standbys.get(task.name, ())
    if choice.place is None or task.standby is None or task.name in state.running:
        return choice
    open_ = {
        each.place: (
            each.sample.state is TaskState.STARTING,
            -each.sample.deactivated if task.state is not None else 0,
        )
        for each in copies
        if each.sample.state.alive
        and is_usable(each.sample, task)
        and is_feasible_total(candidates.totals[each.place])
    }
    if not open_:
        return choice
    order = candidates.context.fleet.order
    place = min(open_, key=lambda each: (open_[each], -candidates.totals[each], order[each]))
    return replace(choice, verdict=Verdict.PLACED, reason=Reason.STANDBY_ACTIVATED, place=place)
