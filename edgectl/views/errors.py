"""How every error of ours is shown: text with position, line, caret and hint, or JSON."""

from collections.abc import Iterable

from edgectl.errors import EdgectlError, HostError, InputError, Problem, StalePlanError
from edgectl.formats.base import Document, dumps
from edgectl.views.text import PLAIN, Look, harmless, paint


def text(error: EdgectlError, look: Look = PLAIN) -> str:
    """The error for people, every problem with its place."""
    if isinstance(error, InputError):
        return "\n".join(problem(each, look) for each in error.problems)
    if isinstance(error, StalePlanError):
        changes = "".join(f"  {harmless(change)}\n" for change in error.changes)
        return _line("error", "saved plan is stale; since it was made:", look) + changes + _hint(error.hint, look)
    return _line("error", _message(error), look) + _hint(error.hint, look)


def _message(error: EdgectlError) -> str:
    """The message, with the host where it is about one and does not say so itself."""
    host = error.host if isinstance(error, HostError) else ""
    return f"{host}: {error.message}" if host and host not in error.message else error.message


def problem(value: Problem, look: Look = PLAIN) -> str:
    """One problem: ``error[EC012]: FILE:LINE:COLUMN: message``, the line, a caret, a hint."""
    word = ("warning" if value.warning else "error") + (f"[{value.code}]" if value.code else "")
    return _line(word, f"{_place(value)}{value.message}", look) + _excerpt(value) + _hint(value.hint, look)


def _place(value: Problem) -> str:
    if not value.line:
        return f"{value.file}: " if value.file else ""
    return f"{value.file}:{value.line}:{value.column}: "


def _line(word: str, message: str, look: Look) -> str:
    return paint(f"{word}:", "warn" if word.startswith("warning") else "bad", look) + f" {harmless(message)}\n"


def _excerpt(value: Problem) -> str:
    if not value.source.strip() or not value.line:
        return ""
    number = f"{value.line:>5}"
    before = len(harmless(value.source[: max(0, value.column - 1)]))
    marked = max(1, len(harmless(value.source[max(0, value.column - 1) :][: value.length])))
    return f"{number} | {harmless(value.source)}\n{' ' * len(number)} | {' ' * before}{'^' * marked}\n"


def _hint(hint: str, look: Look) -> str:
    return f"{paint('hint:', 'name', look)} {harmless(hint)}\n" if hint else ""


def json(error: EdgectlError) -> str:
    """The error for programs."""
    body: Document = {"error": {"kind": kind(error), "message": _message(error), "hint": error.hint, "exit_code": int(error.exit_code)}}
    if isinstance(error, InputError):
        body["problems"] = [_document(each) for each in error.problems]
    if isinstance(error, StalePlanError):
        body["changes"] = list(error.changes)
    return dumps(body)


def problems_json(problems: Iterable[Problem]) -> str:
    """Problems alone (warnings of files that are good)."""
    return dumps({"problems": [_document(each) for each in problems]})


def kind(error: EdgectlError) -> str:
    """A stable word for the class of the error: ``input``, ``lock-busy``, ``stale-plan``."""
    name = type(error).__name__.removesuffix("Error")
    return "".join(f"-{letter.lower()}" if letter.isupper() else letter for letter in name).lstrip("-")


def _document(value: Problem) -> Document:
    return {
        "file": value.file,
        "line": value.line,
        "column": value.column,
        "length": value.length,
        "code": value.code,
        "level": "warning" if value.warning else "error",
        "message": value.message,
        "hint": value.hint,
        "source": value.source,
    }
