# SPDX-License-Identifier: Apache-2.0
"""Label selectors, in kubectl's grammar."""

import re
from collections.abc import Mapping

from edgectl.errors import UsageError

_KEY = r"[A-Za-z0-9][A-Za-z0-9._/-]*"
_REQUIREMENT = re.compile(
    rf"(?P<absent>!\s*)?(?P<key>{_KEY})"
    r"(?:\s*(?P<sign>==|=|!=)\s*(?P<value>[^\s,()=!]*)|\s+(?P<word>in|notin)\s*\((?P<values>[^()]*)\))?"
)
_COMMA = re.compile(r",(?![^()]*\))")  # outside of brackets
_SYNTAX_HINT = "write a=b, a!=b, a in (b,c), a notin (b,c), a or !a, joined by commas"


# A label of several values, such as the robots of a task, has each of them.
Labels = Mapping[str, str | tuple[str, ...]]


def matches_selector(selector: str, labels: Labels) -> bool:
    """Whether labels satisfy every part of ``selector``; ``!=`` and ``notin`` hold if the label is missing.

    Raises:
        UsageError: a part cannot be parsed.
    """
    parts = [_parse_requirement(part.strip()) for part in _COMMA.split(selector)]
    return all(_is_requirement_met(part, labels) for part in parts)


def _parse_requirement(part: str) -> re.Match[str]:
    found = _REQUIREMENT.fullmatch(part)
    if found is None or (found["absent"] and (found["sign"] or found["word"])):
        raise UsageError(f"cannot parse the selector {part!r}", hint=_SYNTAX_HINT)
    return found


def _is_requirement_met(part: re.Match[str], labels: Labels) -> bool:
    found = labels.get(part["key"], ())
    values = {found} if isinstance(found, str) else set(found)
    if part["word"]:
        wanted = {each.strip() for each in part["values"].split(",")}
        return values.isdisjoint(wanted) == (part["word"] == "notin")
    if part["sign"]:
        return (part["value"] in values) == (part["sign"] != "!=")
    return bool(values) != bool(part["absent"])
