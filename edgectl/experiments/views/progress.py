"""How far an experiment is, in words."""

from edgectl.experiments.model.experiment import Trial, TrialProgress
from edgectl.model.cycle import Cycle
from edgectl.model.event import EventKind
from edgectl.units import format_duration
from edgectl.views.text import escape_unprintable
from edgectl.views.watch_cycle import format_event

_PROBLEM_EVENTS = (
    EventKind.HOST_LOST, EventKind.HOST_BACK, EventKind.HOST_REBOOTED, EventKind.TASK_FAILED, EventKind.TASK_CRASHLOOP, EventKind.TASK_LOST,
    EventKind.TASK_DEFERRED, EventKind.ACTION_FAILED,
)  # fmt: skip


def describe_trial_news(before: Cycle | None, course: TrialProgress) -> str:
    """What is new since ``before``, the cycle of the same trial that came before; nothing in a trial that goes well."""
    which = f"trial {course.number} of {course.total}: {course.scheme}, repetition {course.repetition}"
    if course.trial is not None:
        return escape_unprintable(f"{which}: {_describe_trial_outcome(course, course.trial)}")
    if course.cycle is None:
        return escape_unprintable(
            which
            + (f" (about {format_duration(round(course.left))} left)" if course.left is not None else "")
        )
    return escape_unprintable(
        "; ".join(
            f"{course.scheme}, repetition {course.repetition}: {text}"
            for text in list_cycle_problems(before, course.cycle)
        )
    )


def list_cycle_problems(before: Cycle | None, cycle: Cycle) -> list[str]:
    """What went wrong, or is well again; trouble that lasts is told when it begins."""
    known = set(before.warnings) if before is not None else set()
    told = [format_event(event) for event in cycle.events if event.kind in _PROBLEM_EVENTS]
    told += [f"warning: {warning}" for warning in cycle.warnings if warning not in known]
    return told + (
        [f"error: {cycle.error}"] if cycle.error and (before is None or before.error != cycle.error) else []
    )


def format_trial_state(course: TrialProgress) -> str:
    """Where it stands, on a line that is drawn again and again."""
    left = f", about {format_duration(round(course.left))} left" if course.left is not None else ""
    done = f"{len(course.completed)}/{len(course.until)} completed"
    return escape_unprintable(
        f"{course.scheme} {course.repetition}: {done}, {format_duration(round(course.elapsed))}{left}"
    )


def _describe_trial_outcome(course: TrialProgress, trial: Trial) -> str:
    moved = f"{len(trial.handoffs)} {'handoff' if len(trial.handoffs) == 1 else 'handoffs'}"
    if trial.finished:
        return f"finished in {format_duration(round(trial.latency, 1))}, {moved}"
    missing = [task for task in course.until if task not in trial.completed]
    return f"not finished, {', '.join(missing)} did not complete (counts as {format_duration(trial.latency)}); {moved}"
