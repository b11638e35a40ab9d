"""What is under way, on standard error: one live line on a terminal, else one line as each part ends. Data never comes here."""

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator

from edgectl.model.course import Course, Watcher
from edgectl.model.cycle import Cycle
from edgectl.model.progress import Listener, Progress, Stage
from edgectl.model.snapshot import HostSample
from edgectl.units import format_duration
from edgectl.views.course import line, state
from edgectl.views.table import result_text
from edgectl.views.text import harmless, look_of

Heard = Callable[[str, HostSample, float], None]


@contextlib.contextmanager
def probing(count: int) -> Iterator[Heard]:
    """A listener for ``count`` hosts that answer one by one."""
    if not _live():
        yield lambda name, sample, seconds: _line(f"{name}: {'ok' if sample.ok else 'unreachable'} in {format_duration(seconds)}")
        return
    with _bar("probing", count) as advance:
        yield lambda name, _sample, _seconds: advance(name)


@contextlib.contextmanager
def applying(count: int, *, quiet: bool = False) -> Iterator[Listener]:
    """A listener for ``count`` actions; its events may come from any thread."""
    if quiet or not _live():
        guard = threading.Lock()
        yield lambda event: None if quiet else _ended(event, guard)
        return
    with _bar("applying", count) as advance:
        yield lambda event: _advanced(event, advance)


@contextlib.contextmanager
def trying(total: int) -> Iterator[Watcher]:
    """A listener for the ``total`` trials of an experiment; what goes wrong is a line of its own."""
    before: list[Cycle] = []

    def told(course: Course) -> None:
        if text := line(before[0] if before else None, course):
            _line(text)
        before[:] = [course.cycle] if course.cycle is not None else []

    if not _live():
        yield told
        return
    with _bar("trial", total) as advance:
        ended = 0

        def drawn(course: Course) -> None:
            nonlocal ended
            if course.trial is not None or course.cycle is not None:
                told(course)
            now = course.number if course.trial is not None else course.number - 1
            advance(state(course), step=now - ended)
            ended = now

        yield drawn


def _live() -> bool:
    return sys.stderr.isatty() and look_of(sys.stderr).colour


@contextlib.contextmanager
def _bar(what: str, count: int) -> Iterator[Callable[..., None]]:
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    bar_columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bar(*bar_columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=count)

        def advance(text: str, *, step: int = 1) -> None:
            bar.update(task, advance=step, description=f"{what} {escape(harmless(text))}")

        yield advance


def _advanced(event: Progress, advance: Callable[..., None]) -> None:
    if event.stage is Stage.PHASE_BEGIN:
        advance(f"{event.task}: {event.phase} on {event.host}", step=0)
    elif event.stage is Stage.ACTION_END:
        advance(event.task)


def _ended(event: Progress, guard: threading.Lock) -> None:
    if event.stage is Stage.ACTION_END and event.result is not None:
        with guard:
            _line(f"{event.action} {event.task}: {event.result.outcome} ({result_text(event.result)})")


def _line(text: str) -> None:
    with contextlib.suppress(BrokenPipeError):
        sys.stderr.write(harmless(text) + "\n")
        sys.stderr.flush()
