# SPDX-License-Identifier: Apache-2.0
"""Annotations of a GitHub Actions job, one line per problem."""

from collections.abc import Iterable

from edgectl.errors import Problem


def problems(values: Iterable[Problem]) -> str:
    """One annotation per problem, at its place in the file."""
    return "".join(_format_annotation(value) for value in values)


def _format_annotation(value: Problem) -> str:
    place = f"file={_escape_annotation_property(value.file)}"
    if value.line:
        place += f",line={value.line},col={value.column},endColumn={value.column + value.length}"
    message = value.message + (f" (hint: {value.hint})" if value.hint else "")
    level, title = "warning" if value.warning else "error", _escape_annotation_property(value.code)
    return f"::{level} {place},title={title}::{_escape_annotation_text(message)}\n"


def _escape_annotation_text(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _escape_annotation_property(text: str) -> str:
    return _escape_annotation_text(text).replace(":", "%3A").replace(",", "%2C")
