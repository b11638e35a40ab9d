# SPDX-License-Identifier: Apache-2.0
"""Explanation of YAML parser errors, with hints."""

import re

from edgectl.config.problems import Mark, Source
from edgectl.config.yaml_library import yaml

_KEY_VALUE_PATTERN = r"^\s*(?:- )?([\w.-]+): +(.*?)\s*$"
# words of the parser -> (message, hint)
_EXPLANATIONS = (
    (
        "expected ',' or '}'",
        "{ is not closed, or its content needs a comma",
        "close it with }, or put text with { } , in quotes",
    ),
    (
        "expected ',' or ']'",
        "[ is not closed, or its content needs a comma",
        "close it with ], or put text with [ ] , in quotes",
    ),
    ("unexpected end of stream", "a quote is not closed", "close the quote"),
    ("unexpected document indicator", "a quote is not closed", "close the quote"),
    (
        "unknown escape character",
        "unknown escape after a backslash in double quotes",
        "use single quotes instead",
    ),
    (
        "expected key",
        "this line does not match the indentation around it",
        "indent it exactly like the keys beside it",
    ),
    (
        "expected '-' indicator",
        "this line does not match the list above it",
        "indent it like the other entries of the list, with a leading -",
    ),
    (
        "could not find expected ':'",
        "a key without a colon",
        "write key: value, with a space after the colon",
    ),
    ("expected alphabetic or numeric", "* and & begin an alias or an anchor", "put the text in quotes"),
    ("expected URI", "! begins a tag", "put the text in quotes"),
    ("undefined tag handle", "! begins a tag", "put the text in quotes"),
    ("while parsing a tag", "! begins a tag", "put the text in quotes"),
    ("sequence entries", "a - is not allowed here", "begin the list on the next line, or write [..]"),
)


# unclosed brackets and quotes are reported where they are opened
_MARKED_AT_START = (
    "expected ',' or",
    "unexpected end of stream",
    "unexpected document indicator",
    "could not find expected ':'",
)


def explain_yaml_error(source: Source, error: yaml.YAMLError) -> tuple[Mark, str, str]:
    """Position, message and hint for a file that is not YAML."""
    said = f"{getattr(error, 'problem', None) or error} {getattr(error, 'context', None) or ''}".strip()
    mark = _find_error_mark(source, error, begin=any(words in said for words in _MARKED_AT_START))
    line = source.line(mark.line)
    if "\t" in line[: len(line) - len(line.lstrip())] or line[mark.column - 1 : mark.column] == "\t":
        return mark, "a tab cannot indent YAML", "use spaces"
    if "mapping values are not allowed" in said:
        return mark, 'a second ": " on one line', _suggest_quoted_value(line)
    if "cannot start any token" in said:
        return (
            mark,
            f"{line[mark.column - 1 : mark.column]} cannot begin an unquoted text",
            _suggest_quoted_value(line),
        )
    if "expected key" in said and line[: mark.column - 1].strip():
        return mark, "text after a closing bracket or quote", _suggest_quoted_value(line)
    for words, message, hint in _EXPLANATIONS:
        if words in said:
            return mark, message, _suggest_quoted_value(line) if hint == "put the text in quotes" else hint
    return mark, f"not YAML: {said}", "check quotes, brackets and indentation"


def _find_error_mark(source: Source, error: yaml.YAMLError, *, begin: bool) -> Mark:
    marks = [getattr(error, name, None) for name in ("context_mark", "problem_mark")]
    found = next((mark for mark in (marks if begin else marks[::-1]) if mark is not None), None)
    if found is None:
        return Mark(source, 1, 1)
    last = len(source.lines)
    if found.line >= last or (found.line == last - 1 and not source.lines[-1]):
        last -= not source.lines[-1] and last > 1
        return Mark(source, last, len(source.lines[last - 1]) + 1)
    return Mark(source, found.line + 1, found.column + 1)


def _suggest_quoted_value(line: str) -> str:
    match = re.match(_KEY_VALUE_PATTERN, line)
    if match is None or not match[2]:
        return "put the text in quotes"
    quoted = match[2].replace("'", "''")
    return f"put the text in quotes: {match[1]}: '{quoted}'"
