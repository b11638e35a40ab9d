# SPDX-License-Identifier: Apache-2.0
"""Progress of an experiment on standard error: a live line on a terminal, otherwise a line per trial."""

import contextlib
from collections.abc import Callable, Iterator

from edgectl.experiments.model.experiment import Trial, TrialListener, TrialProgress
from edgectl.model.cycle import Cycle
from edgectl.model.event import EventKind
from edgectl.units import format_duration
from edgectl.views.progress import can_show_bar, print_progress_line, show_progress_bar
from edgectl.views.text import escape_unprintable
from edgectl.views.watch_cycle import format_event

_PROBLEM_EVENTS = (
    EventKind.HOST_LOST,
    EventKind.HOST_BACK,
    EventKind.HOST_REBOOTED,
    EventKind.LINK_DOWN,
    EventKind.LINK_BACK,
    EventKind.TASK_FAILED,
    EventKind.TASK_CRASHLOOP,
    EventKind.TASK_LOST,
    EventKind.TASK_DEFERRED,
    EventKind.ACTION_FAILED,
)


@contextlib.contextmanager
def show_trial_progress(total: int) -> Iterator[TrialListener]:
    """A listener that shows the progress of ``total`` trials; each problem gets a line of its own."""
    previous: list[Cycle] = []

    def print_news(progress: TrialProgress) -> None:
        if text := describe_trial_news(previous[0] if previous else None, progress):
            print_progress_line(text)
        previous[:] = [progress.cycle] if progress.cycle is not None else []

    if not can_show_bar():
        yield print_news
        return
    with show_progress_bar("trial", total) as advance:
        ended = 0

        def update_bar(progress: TrialProgress) -> None:
            nonlocal ended
            if progress.trial is not None or progress.cycle is not None:
                print_news(progress)
            now = progress.number if progress.trial is not None else progress.number - 1
            advance(format_trial_state(progress), step=now - ended)
            ended = now

        yield update_bar


def describe_trial_news(previous: Cycle | None, progress: TrialProgress) -> str:
    """The start or end of a trial, or the problems that are new since its cycle ``previous``; "" if none."""
    which = (
        f"trial {progress.number} of {progress.total}: {progress.scheme}, repetition {progress.repetition}"
    )
    if progress.trial is not None:
        return escape_unprintable(f"{which}: {_describe_trial_outcome(progress, progress.trial)}")
    if progress.cycle is None:
        remaining = "" if progress.left is None else f" (about {format_duration(round(progress.left))} left)"
        return escape_unprintable(which + remaining)
    return escape_unprintable(
        "; ".join(
            f"{progress.scheme}, repetition {progress.repetition}: {text}"
            for text in list_cycle_problems(previous, progress.cycle)
        )
    )


def list_cycle_problems(previous: Cycle | None, cycle: Cycle) -> list[str]:
    """Problem and recovery events of a cycle, and the warnings and error that are new since ``previous``."""
    known = set(previous.warnings) if previous is not None else set()
    found = [format_event(event) for event in cycle.events if event.kind in _PROBLEM_EVENTS]
    found += [f"warning: {warning}" for warning in cycle.warnings if warning not in known]
    if cycle.error and (previous is None or previous.error != cycle.error):
        found.append(f"error: {cycle.error}")
    return found


def format_trial_state(progress: TrialProgress) -> str:
    """The text of the live line."""
    left = f", about {format_duration(round(progress.left))} left" if progress.left is not None else ""
    done = f"{len(progress.completed)}/{len(progress.until)} completed"
    elapsed = format_duration(round(progress.elapsed))
    return escape_unprintable(f"{progress.scheme} {progress.repetition}: {done}, {elapsed}{left}")


def _describe_trial_outcome(progress: TrialProgress, trial: Trial) -> str:
    moved = f"{len(trial.handoffs)} {'handoff' if len(trial.handoffs) == 1 else 'handoffs'}"
    if trial.finished:
        return f"finished in {format_duration(round(trial.latency, 1))}, {moved}"
    missing = ", ".join(task for task in progress.until if task not in trial.completed)
    return f"not finished, {missing} did not complete (counts as {format_duration(trial.latency)}); {moved}"


@contextlib.contextmanager
def show_world_progress(count: int) -> Iterator[Callable[[], None]]:
    """A function to call after each of ``count`` worlds of a sweep: a bar on a terminal, else nothing."""
    if not count or not can_show_bar():
        yield lambda: None
        return
    with show_progress_bar("worlds", count) as advance:
        yield lambda: advance("")
