"""The order of names: ``edge2`` before ``edge10``."""

import re

_DIGITS = re.compile(r"([0-9]+)")


def natural_key(name: str) -> tuple[tuple[str | int, ...], str]:
    """Sort key by which runs of digits compare as numbers; the name itself separates ``e1`` from ``e01``."""
    parts = _DIGITS.split(name)
    return tuple(int(part) if position % 2 else part for position, part in enumerate(parts)), name
