# SPDX-License-Identifier: Apache-2.0
"""Output of data on stdout and of messages on stderr."""

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from io import TextIOWrapper
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from edgectl.errors import Problem
    from edgectl.views.output import View
    from edgectl.views.output_format import OutputFormat
    from edgectl.views.text import RenderOptions


def print_view(view: "View", form: "OutputFormat", *, fleet: str = "") -> None:
    """Print ``view`` on stdout in ``form``, and the notes of a table on stderr.

    ``fleet``: its name, the first line of a table on a terminal; programs read tables without it.
    """
    from edgectl.views.output import render_view
    from edgectl.views.output_format import HUMAN_FORMATS
    from edgectl.views.text import detect_render_options, render_fleet_line

    look = detect_render_options(sys.stdout)
    text = render_view(view, form, look)
    print_text((render_fleet_line(fleet, look) if text and form in HUMAN_FORMATS else "") + text)
    _print_notes(view, form)


def _print_notes(view: "View", form: "OutputFormat") -> None:
    from edgectl.views.output_format import HUMAN_FORMATS

    if form in HUMAN_FORMATS:
        print_notes(view.notes())


def print_notes(lines: Iterable[str]) -> None:
    """Print notes on stderr."""
    from edgectl.views.notes import render_notes

    print_stderr(render_notes(lines, get_stderr_render_options()))


def print_view_series(views: "Iterable[View]", form: "OutputFormat", *, fleet: str = "") -> None:
    """Print one view after the other, until the reader closes stdout. JSON is one object per line.

    ``fleet``: as of ``print_view``, once.
    """
    from edgectl.views.output import render_view
    from edgectl.views.output_format import HUMAN_FORMATS, OutputFormat
    from edgectl.views.text import detect_render_options, render_fleet_line

    shown = OutputFormat.JSONL if form is OutputFormat.JSON else form
    if form in HUMAN_FORMATS:
        print_text(render_fleet_line(fleet, detect_render_options(sys.stdout)))
    for view in views:
        if not print_part(render_view(view, shown, detect_render_options(sys.stdout))):
            return
        _print_notes(view, shown)


def print_text(text: str) -> None:
    """Print data on stdout. A closed pipe is no error: the command continues without output."""
    with _ignore_closed_pipe(sys.stdout) as stream:
        stream.write(text)
        stream.flush()


def print_lines(lines: Iterable[str]) -> None:
    """Print lines on stdout as they come, until the reader closes it."""
    with _ignore_closed_pipe(sys.stdout) as stream:
        stream.writelines(lines)
        stream.flush()


def print_part(text: str) -> bool:
    """Print a part of a longer output on stdout as it is; False once the reader has closed it."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        _redirect_to_devnull(sys.stdout)
        return False
    return True


def print_message(text: str) -> None:
    """Print a message line on stderr."""
    from edgectl.views.text import escape_unprintable

    print_stderr(escape_unprintable(text) + "\n")


def print_stderr(text: str) -> None:
    """Print text on stderr unchanged."""
    with _ignore_closed_pipe(sys.stderr) as stream:
        stream.write(text)


def get_stderr_render_options() -> "RenderOptions":
    """Render options of stderr."""
    from edgectl.views.text import detect_render_options

    return detect_render_options(sys.stderr)


def print_input_warnings(problems: Iterable["Problem"]) -> None:
    """Print warnings about input files that are valid."""
    problems = list(problems)
    if not problems:
        return
    from edgectl.views import errors

    print_stderr("".join(errors.render_problem(problem, get_stderr_render_options()) for problem in problems))


@contextlib.contextmanager
def _ignore_closed_pipe(stream: TextIO) -> Iterator[TextIO]:
    try:
        yield stream
    except BrokenPipeError:
        _redirect_to_devnull(stream)


@contextlib.contextmanager
def guard_standard_streams() -> Iterator[None]:
    """Handle closed pipes and narrow encodings of help texts and of the final flush."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        _redirect_to_devnull(sys.stdout)
    except OSError:
        try:
            sys.stdout.flush()
        except OSError:
            # The interpreter would flush again and fail with its own message and exit code.
            _redirect_to_devnull(sys.stdout)
        raise


def _redirect_to_devnull(stream: TextIO) -> None:
    """Discard further output on ``stream`` and the interpreter's final flush."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
