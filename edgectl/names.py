# SPDX-License-Identifier: Apache-2.0
"""Lookup of names that a user typed, with suggestions, and their natural order."""

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache

from edgectl.errors import UsageError

_MAX_WORD, _MAX_NAMES_LISTED = 100, 12


def suggest_name(word: str, known: Iterable[str]) -> str:
    """The most similar known name, or an empty string."""
    import difflib

    by_folded = {candidate.lower(): candidate for candidate in known}
    matches = difflib.get_close_matches(word.lower()[:_MAX_WORD], list(by_folded), n=1, cutoff=0.6)
    return by_folded[matches[0]] if matches else ""


def format_name_list(words: Sequence[str]) -> str:
    """The first words of a list that may be long, comma-separated."""
    return ", ".join(words[:_MAX_NAMES_LISTED]) + (", .." if len(words) > _MAX_NAMES_LISTED else "")


def format_alternatives(words: Sequence[str]) -> str:
    """``a, b or c``."""
    return " or ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)


def check_known_names(names: Iterable[str], among: Iterable[str], what: str, *, every: bool = False) -> None:
    """Check that every name exists; ``what`` names their kind. ``every``: list all of them, however many.

    Raises:
        UsageError: names are unknown; all are named, and the hint suggests the nearest of each, or lists the
            known ones.
    """
    known = dict.fromkeys(among)
    unknown = [name for name in dict.fromkeys(names) if name not in known]
    if not unknown:
        return
    nearest = {name: _find_nearest(name, known) for name in unknown}
    alone = len(unknown) == 1
    meant = [near if alone else f"{near} for {name}" for name, near in nearest.items() if near]
    hint = f"did you mean {format_name_list(meant)}?" if meant else ""
    if len(meant) < len(unknown):
        listed = ", ".join(known) if every else format_name_list(list(known))
        hint = f"{hint} {f'known: {listed}' if known else f'there is no {what}'}".strip()
    kind, space, rest = what.partition(" ")
    kinds = f"{kind}{'' if alone else 's'}{space}{rest}"
    raise UsageError(f"unknown {kinds} {format_name_list([repr(name) for name in unknown])}", hint=hint)


def _find_nearest(name: str, known: Iterable[str]) -> str:
    """The most similar known name, or one that begins with it; or an empty string."""
    return suggest_name(name, known) or next((each for each in known if name and each.startswith(name)), "")


_DIGITS = re.compile(r"([0-9]+)")


@lru_cache(maxsize=100_000)  # names of hosts and tasks, which every plan sorts again
def natural_key(name: str) -> tuple[tuple[str | int, ...], str]:
    """Sort key by which runs of digits compare as numbers; the name itself separates ``e1`` from ``e01``."""
    parts = _DIGITS.split(name)
    return tuple(int(part) if position % 2 else part for position, part in enumerate(parts)), name
