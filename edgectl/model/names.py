"""Names that a person wrote: whether there is such a thing, and which one was probably meant."""

import difflib
from collections.abc import Iterable, Sequence

from edgectl.errors import UsageError

_LONGEST, _LISTED = 100, 12


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that was probably meant, or nothing."""
    by_folded = {candidate.lower(): candidate for candidate in known}
    matches = difflib.get_close_matches(word.lower()[:_LONGEST], list(by_folded), n=1, cutoff=0.6)
    return by_folded[matches[0]] if matches else ""


def listed(words: Sequence[str]) -> str:
    """The first words of a list that may be long."""
    return ", ".join(words[:_LISTED]) + (", .." if len(words) > _LISTED else "")


def either(words: Sequence[str]) -> str:
    """``a, b or c``."""
    return " or ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)


def known(names: Iterable[str], among: Iterable[str], what: str) -> None:
    """Refuse names of the command line that do not exist; ``what`` says of which kind they are.

    Raises:
        UsageError: with the nearest name, or the list of them, as hint.
    """
    every = list(dict.fromkeys(among))
    for name in names:
        if name not in every:
            match = nearest(name, every) or next((each for each in every if name and each.startswith(name)), "")
            hint = f"did you mean {match}?" if match else f"known: {listed(every)}" if every else f"there is no {what} at all"
            raise UsageError(f"unknown {what} {name!r}", hint=hint)
