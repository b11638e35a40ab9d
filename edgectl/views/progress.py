# SPDX-License-Identifier: Apache-2.0
"""Progress on standard error: a live line on a terminal, else a line as each part ends."""

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator

from edgectl.model.progress import ProgressEvent, ProgressListener, ProgressStage
from edgectl.model.snapshot import HostSample
from edgectl.units import format_duration
from edgectl.views.text import detect_render_options, escape_unprintable, wrap_text

ProbeListener = Callable[[str, HostSample, float], None]


@contextlib.contextmanager
def show_probe_progress(count: int) -> Iterator[ProbeListener]:
    """A listener for ``count`` hosts that answer one by one."""
    if not can_show_bar():
        yield lambda name, sample, seconds: print_progress_line(
            f"{name}: {'ok' if sample.ok else 'unreachable'} in {format_duration(seconds)}"
        )
        return
    with show_progress_bar("probing", count) as advance:
        yield lambda name, _sample, _seconds: advance(name)


@contextlib.contextmanager
def show_apply_progress(count: int, *, quiet: bool = False) -> Iterator[ProgressListener]:
    """A listener for ``count`` actions; its events may come from any thread."""
    if quiet or not can_show_bar():
        guard = threading.Lock()
        yield lambda event: None if quiet else _print_action_end(event, guard)
        return
    with show_progress_bar("applying", count) as advance:
        yield lambda event: _advance_bar(event, advance)


def can_show_bar() -> bool:
    """Whether standard error is a terminal that can draw a bar."""
    return sys.stderr.isatty() and detect_render_options(sys.stderr).colour


@contextlib.contextmanager
def show_progress_bar(what: str, count: int) -> Iterator[Callable[..., None]]:
    """A bar of ``count`` steps; the function given advances it and changes its text."""
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
        # The tables of results are no part of a probe.
        from edgectl.views.results import format_action_result

        with guard:
            print_progress_line(
                f"{event.action} {event.task}: {event.result.outcome} ({format_action_result(event.result)})"
            )


def print_progress_line(text: str) -> None:
    """One line on standard error; on a terminal, broken between words."""
    with contextlib.suppress(BrokenPipeError):
        sys.stderr.write(wrap_text(escape_unprintable(text), detect_render_options(sys.stderr)))
        sys.stderr.flush()
