"""Standard output for data, standard error for everything else."""

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from io import TextIOWrapper
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from edgectl.errors import Problem
    from edgectl.views.output_format import OutputFormat
    from edgectl.views.text import RenderOptions


def print_view(form: "OutputFormat", what: str, *values: object) -> None:
    """Print ``values`` on standard output in ``form``."""
    from edgectl.views.output_format import get_renderer
    from edgectl.views.text import detect_render_options

    print_text(get_renderer(form, what)(*values, detect_render_options(sys.stdout)))


def print_view_series(form: "OutputFormat", what: str, series: Iterable[tuple[object, ...]]) -> None:
    """Print one after the other as they come, as long as somebody reads."""
    from edgectl.views.output_format import get_renderer
    from edgectl.views.text import detect_render_options

    for values in series:
        if not _try_print(get_renderer(form, what)(*values, detect_render_options(sys.stdout))):
            return


def render_view(form: "OutputFormat", what: str, *values: object) -> str:
    """``values`` in ``form`` as they stand in a file: no colour, nothing wrapped."""
    from edgectl.views.output_format import get_renderer

    return get_renderer(form, what)(*values)


def print_text(text: str) -> None:
    """Data to standard output. A reader that has gone away is no error: what is done goes on, unseen."""
    with _ignore_closed_pipe(sys.stdout) as stream:
        stream.write(text)
        stream.flush()


def print_lines(lines: Iterable[str]) -> None:
    """Data to standard output, as it comes; no more once nobody reads."""
    with _ignore_closed_pipe(sys.stdout) as stream:
        stream.writelines(lines)
        stream.flush()


def print_log(data: bytes) -> bool:
    """Raw bytes of a task's log to standard output, control characters written out; False once nobody reads any more."""
    from edgectl.views.text import decode_log_output

    return _try_print(decode_log_output(data))


def _try_print(text: str) -> bool:
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        _redirect_to_devnull(sys.stdout)
        return False
    return True


def print_message(text: str) -> None:
    """A line for people, on standard error."""
    from edgectl.views.text import escape_unprintable

    print_stderr(escape_unprintable(text) + "\n")


def print_stderr(text: str) -> None:
    """Text for people, on standard error, as it stands."""
    with _ignore_closed_pipe(sys.stderr) as stream:
        stream.write(text)


def get_stderr_render_options() -> "RenderOptions":
    """What standard error can show."""
    from edgectl.views.text import detect_render_options

    return detect_render_options(sys.stderr)


def print_input_warnings(problems: Iterable["Problem"]) -> None:
    """Warnings about files that are good enough to go on with."""
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
    """Help and the last flush go straight to standard output: a closed pipe there is no error either, nor is a narrow encoding."""
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
            # The interpreter would try once more, and end with words and an exit code of its own.
            _redirect_to_devnull(sys.stdout)
        raise


def _redirect_to_devnull(stream: TextIO) -> None:
    """Let everything that still follows on ``stream``, and the interpreter's own last flush, go nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
