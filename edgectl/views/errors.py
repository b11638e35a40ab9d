# SPDX-License-Identifier: Apache-2.0
"""Errors as text with position, line, caret and hint, and as JSON."""

from collections.abc import Iterable

from edgectl.errors import EdgectlError, HostError, InputError, Problem, StalePlanError
from edgectl.formats.document import Document, dump_document
from edgectl.views.text import PLAIN, RenderOptions, escape_unprintable, style_text


def render_error(error: EdgectlError, look: RenderOptions = PLAIN) -> str:
    """The error for people, every problem with its place."""
    if isinstance(error, InputError):
        return "\n".join(render_problem(each, look) for each in error.problems)
    if isinstance(error, StalePlanError):
        changes = "".join(f"  {escape_unprintable(change)}\n" for change in error.changes)
        return (
            _render_message_line("error", "saved plan is stale; since it was made:", look)
            + changes
            + _render_hint(error.hint, look)
        )
    return _render_message_line("error", _format_error_message(error), look) + _render_hint(error.hint, look)


def _format_error_message(error: EdgectlError) -> str:
    """The message, with the host of a host error where the message does not name it."""
    host = error.host if isinstance(error, HostError) else ""
    return f"{host}: {error.message}" if host and host not in error.message else error.message


def render_problem(value: Problem, look: RenderOptions = PLAIN) -> str:
    """One problem: ``error[EC012]: FILE:LINE:COLUMN: message``, the line, a caret, a hint."""
    word = ("warning" if value.warning else "error") + (f"[{value.code}]" if value.code else "")
    return (
        _render_message_line(word, f"{_format_problem_position(value)}{value.message}", look)
        + _render_source_excerpt(value)
        + _render_hint(value.hint, look)
    )


def _format_problem_position(value: Problem) -> str:
    if not value.line:
        return f"{value.file}: " if value.file else ""
    return f"{value.file}:{value.line}:{value.column}: "


def _render_message_line(word: str, message: str, look: RenderOptions) -> str:
    return (
        style_text(f"{word}:", "warn" if word.startswith("warning") else "bad", look)
        + f" {escape_unprintable(message)}\n"
    )


def _render_source_excerpt(value: Problem) -> str:
    if not value.source.strip() or not value.line:
        return ""
    number = f"{value.line:>5}"
    before = len(escape_unprintable(value.source[: max(0, value.column - 1)]))
    marked = max(1, len(escape_unprintable(value.source[max(0, value.column - 1) :][: value.length])))
    return (
        f"{number} | {escape_unprintable(value.source)}\n{' ' * len(number)} | {' ' * before}{'^' * marked}\n"
    )


def _render_hint(hint: str, look: RenderOptions) -> str:
    return f"{style_text('hint:', 'name', look)} {escape_unprintable(hint)}\n" if hint else ""


def render_error_json(error: EdgectlError) -> str:
    """The error for programs."""
    body: Document = {
        "error": {
            "kind": format_error_kind(error),
            "message": _format_error_message(error),
            "hint": error.hint,
            "exit_code": int(error.exit_code),
        }
    }
    if isinstance(error, InputError):
        body["problems"] = [_encode_problem(each) for each in error.problems]
    if isinstance(error, StalePlanError):
        body["changes"] = list(error.changes)
    return dump_document(body)


def render_problems_json(problems: Iterable[Problem]) -> str:
    """Problems alone (warnings of files that are good)."""
    return dump_document({"problems": [_encode_problem(each) for each in problems]})


def format_error_kind(error: EdgectlError) -> str:
    """A stable word for the class of the error: ``input``, ``lock-busy``, ``stale-plan``."""
    name = type(error).__name__.removesuffix("Error")
    return "".join(f"-{letter.lower()}" if letter.isupper() else letter for letter in name).lstrip("-")


def _encode_problem(value: Problem) -> Document:
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
