# SPDX-License-Identifier: Apache-2.0
"""Reminders of wanted tasks that were given up: at once, then once a day."""

from edgectl.errors import StateError
from edgectl.model.assignment import Reason
from edgectl.model.plan import Plan
from edgectl.state.manager_state import Reminder, load_reminders, save_reminders
from edgectl.usecases.fleet import Fleet

_REPEAT_S = 24 * 3600.0


def take_given_up_reminders(fleet: Fleet, plan: Plan) -> tuple[str, ...]:
    """Texts on the given-up tasks of ``plan`` that no unattended run has reported for a day.

    They count as reported; a disk that does not take the record costs a repeated report.
    """
    known, now = load_reminders(fleet.state, fleet.warn), fleet.clock()
    runs = {
        step.task: _find_instance(plan, step.task, step.decision.subject)
        for step in plan.steps
        if step.decision.reason is Reason.GIVEN_UP
    }
    due = [task for task, run in runs.items() if _is_due(known.get(task), run, now)]
    kept = {task: known[task] for task in runs if task not in due}
    after = kept | {task: Reminder(instance=runs[task], at=now) for task in due}
    if after != known:
        try:
            save_reminders(fleet.state, after)
        except StateError as error:
            fleet.warn(error.message)
    hosts = {step.task: step.decision.subject for step in plan.steps}
    return tuple(
        f"{task} is given up on {hosts[task]}; edgectl restart {task}, or a changed spec, starts it again"
        for task in due
    )


def _find_instance(plan: Plan, task: str, host: str | None) -> str:
    sample = plan.snapshot.hosts.get(host or "")
    return sample.tasks[task].instance if sample is not None and task in sample.tasks else ""


def _is_due(last: Reminder | None, instance: str, now: float) -> bool:
    """Whether another run was given up, or a day has passed; also where the clock was set back."""
    return last is None or last.instance != instance or not 0 <= now - last.at < _REPEAT_S
