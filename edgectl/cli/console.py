"""Standard output for data, standard error for everything else."""

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from io import TextIOWrapper
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from edgectl.errors import Problem
    from edgectl.views.form import Form
    from edgectl.views.text import Look


def show(form: "Form", what: str, *values: object) -> None:
    """Print ``values`` on standard output in ``form``."""
    from edgectl.views.form import view
    from edgectl.views.text import look_of

    put(view(form, what)(*values, look_of(sys.stdout)))


def show_all(form: "Form", what: str, series: Iterable[tuple[object, ...]]) -> None:
    """Print one after the other as they come, as long as somebody reads."""
    from edgectl.views.form import view
    from edgectl.views.text import look_of

    for values in series:
        if not _put_more(view(form, what)(*values, look_of(sys.stdout))):
            return


def rendered(form: "Form", what: str, *values: object) -> str:
    """``values`` in ``form`` as they stand in a file: no colour, nothing wrapped."""
    from edgectl.views.form import view

    return view(form, what)(*values)


def put(text: str) -> None:
    """Data to standard output. A reader that has gone away is no error: what is done goes on, unseen."""
    with _pipe(sys.stdout) as stream:
        stream.write(text)
        stream.flush()


def put_lines(lines: Iterable[str]) -> None:
    """Data to standard output, as it comes; no more once nobody reads."""
    with _pipe(sys.stdout) as stream:
        stream.writelines(lines)
        stream.flush()


def put_log(data: bytes) -> bool:
    """Raw bytes of a task's log to standard output, control characters written out; False once nobody reads any more."""
    from edgectl.views.text import log_text

    return _put_more(log_text(data))


def _put_more(text: str) -> bool:
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        _silence(sys.stdout)
        return False
    return True


def tell(text: str) -> None:
    """A line for people, on standard error."""
    from edgectl.views.text import harmless

    say(harmless(text) + "\n")


def say(text: str) -> None:
    """Text for people, on standard error, as it stands."""
    with _pipe(sys.stderr) as stream:
        stream.write(text)


def error_look() -> "Look":
    """What standard error can show."""
    from edgectl.views.text import look_of

    return look_of(sys.stderr)


def warn(problems: Iterable["Problem"]) -> None:
    """Warnings about files that are good enough to go on with."""
    from edgectl.views import errors

    say("".join(errors.problem(problem, error_look()) for problem in problems))


@contextlib.contextmanager
def _pipe(stream: TextIO) -> Iterator[TextIO]:
    try:
        yield stream
    except BrokenPipeError:
        _silence(stream)


@contextlib.contextmanager
def quiet_pipes() -> Iterator[None]:
    """Help and the last flush go straight to standard output: a closed pipe there is no error either, nor is a narrow encoding."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        _silence(sys.stdout)
    except OSError:
        try:
            sys.stdout.flush()
        except OSError:
            # The interpreter would try once more, and end with words and an exit code of its own.
            _silence(sys.stdout)
        raise


def _silence(stream: TextIO) -> None:
    """Let everything that still follows on ``stream``, and the interpreter's own last flush, go nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
