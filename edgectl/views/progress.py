"""What is under way, on standard error: one live line on a terminal, else one line as each part ends. Data never comes here."""

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator

from edgectl.experiments.model.experiment import TrialListener, TrialProgress
from edgectl.experiments.views.progress import describe_trial_news, format_trial_state
from edgectl.model.cycle import Cycle
from edgectl.model.progress import ProgressEvent, ProgressListener, ProgressStage
from edgectl.model.snapshot import HostSample
from edgectl.units import format_duration
from edgectl.views.table import format_action_result
from edgectl.views.text import detect_render_options, escape_unprintable

ProbeListener = Callable[[str, HostSample, float], None]


@contextlib.contextmanager
def show_probe_progress(count: int) -> Iterator[ProbeListener]:
    """A listener for ``count`` hosts that answer one by one."""
    if not _can_show_bar():
        yield lambda name, sample, seconds: _print_progress_line(
            f"{name}: {'ok' if sample.ok else 'unreachable'} in {format_duration(seconds)}"
        )
        return
    with _show_progress_bar("probing", count) as advance:
        yield lambda name, _sample, _seconds: advance(name)


@contextlib.contextmanager
def show_apply_progress(count: int, *, quiet: bool = False) -> Iterator[ProgressListener]:
    """A listener for ``count`` actions; its events may come from any thread."""
    if quiet or not _can_show_bar():
        guard = threading.Lock()
        yield lambda event: None if quiet else _print_action_end(event, guard)
        return
    with _show_progress_bar("applying", count) as advance:
        yield lambda event: _advance_bar(event, advance)


@contextlib.contextmanager
def show_trial_progress(total: int) -> Iterator[TrialListener]:
    """A listener for the ``total`` trials of an experiment; what goes wrong is a line of its own."""
    before: list[Cycle] = []

    def told(course: TrialProgress) -> None:
        if text := describe_trial_news(before[0] if before else None, course):
            _print_progress_line(text)
        before[:] = [course.cycle] if course.cycle is not None else []

    if not _can_show_bar():
        yield told
        return
    with _show_progress_bar("trial", total) as advance:
        ended = 0

        def drawn(course: TrialProgress) -> None:
            nonlocal ended
            if course.trial is not None or course.cycle is not None:
                told(course)
            now = course.number if course.trial is not None else course.number - 1
            advance(format_trial_state(course), step=now - ended)
            ended = now

        yield drawn


def _can_show_bar() -> bool:
    return sys.stderr.isatty() and detect_render_options(sys.stderr).colour


@contextlib.contextmanager
def _show_progress_bar(what: str, count: int) -> Iterator[Callable[..., None]]:
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    bar_columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bar(*bar_columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=count)

        def advance(text: str, *, step: int = 1) -> None:
            bar.update(task, advance=step, description=f"{what} {escape(escape_unprintable(text))}")

        yield advance


def _advance_bar(event: ProgressEvent, advance: Callable[..., None]) -> None:
    if event.stage is ProgressStage.PHASE_BEGIN:
        advance(f"{event.task}: {event.phase} on {event.host}", step=0)
    elif event.stage is ProgressStage.ACTION_END:
        advance(event.task)


def _print_action_end(event: ProgressEvent, guard: threading.Lock) -> None:
    if event.stage is ProgressStage.ACTION_END and event.result is not None:
        with guard:
            _print_progress_line(
                f"{event.action} {event.task}: {event.result.outcome} ({format_action_result(event.result)})"
            )


def _print_progress_line(text: str) -> None:
    with contextlib.suppress(BrokenPipeError):
        sys.stderr.write(escape_unprintable(text) + "\n")
        sys.stderr.flush()
