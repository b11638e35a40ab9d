# SPDX-License-Identifier: Apache-2.0
"""Suggestions for quantities that cannot be read, and demands, which may be shares."""

import re
from collections.abc import Callable
from math import nan

from edgectl.config.schema import build_quantity_schema, describe_as, describe_reader, get_reader_schema
from edgectl.model.demand import Quantity
from edgectl.units import SHARE_PATTERN, QuantityError, is_percent, parse_share

MAX_COST = 1e6
# Bounds of the highest temperature that a host may be given.
_LEAST_MAXIMUM_C, _MOST_MAXIMUM_C = 30.0, 120.0
_NUMBER_PATTERN = re.compile(r"\s*([0-9]+(?:[.,][0-9]+)?)\s*([A-Za-z/%]*)\s*")
_UNIT_SPELLINGS = {
    "min": "m",
    "mins": "m",
    "minute": "m",
    "minutes": "m",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "hour": "h",
    "hours": "h",
    "hr": "h",
    "hrs": "h",
    "day": "d",
    "days": "d",
    "core": "",
    "cores": "",
    "cpu": "",
    "cpus": "",
    "millicores": "m",
    "kbps": "kbit/s",
    "mbps": "Mbit/s",
    "gbps": "Gbit/s",
    "mb/s": "MB/s",
    "kb/s": "kB/s",
    "gb/s": "GB/s",
    "kbit": "kbit/s",
    "mbit": "Mbit/s",
    "gbit": "Gbit/s",
    "mbit/s": "Mbit/s",
    "mib/s": "MiB/s",
    "mb": "MB",
    "kb": "kB",
    "gb": "GB",
    "mib": "Mi",
    "gib": "Gi",
    "kib": "Ki",
    "mi": "Mi",
    "gi": "Gi",
    "ki": "Ki",
    "m": "M",
    "g": "G",
    "percent": "%",
}
_EXACT_SPELLINGS = {
    "MBps": "MB/s",
    "kBps": "kB/s",
    "KBps": "kB/s",
    "GBps": "GB/s",
    "MB": "MB/s",
    "kB": "kB/s",
}


def suggest_quantity(raw: object, parse: Callable[[object], object]) -> str:
    """A hint that writes ``raw`` with a unit that ``parse`` accepts, or nothing."""
    match = (
        _NUMBER_PATTERN.fullmatch(str(raw))
        if isinstance(raw, int | float | str) and not isinstance(raw, bool)
        else None
    )
    if match is None:
        return ""
    number, unit = match[1].replace(",", "."), match[2]
    for candidate in (
        _EXACT_SPELLINGS.get(unit),
        _UNIT_SPELLINGS.get(unit.lower()),
        unit,
        None if unit else "%",
    ):
        if candidate is not None and _can_parse(parse, number + candidate) and number + candidate != raw:
            return (
                f"write {_format_percentage(number) if not unit and candidate == '%' else number + candidate}"
            )
    return ""


def _format_percentage(number: str) -> str:
    """A bare number as a percentage: 0.8 means 80 %, 1.2 means 120 %, 80 means 80 %."""
    factor = float(number) <= 1 or ("." in number and float(number) < 10)
    return f"{float(number) * 100:g}%" if factor else f"{number}%"


def _can_parse(parse: Callable[[object], object], text: str) -> bool:
    try:
        parse(text)
    except QuantityError:
        return False
    return True


def demand_parser(parse: Callable[[object], float], example: str) -> Callable[[object], Quantity]:
    """Reads ``60%`` (of the measured capacity, at most 100 %) or an absolute quantity by ``parse``."""

    def read(raw: object) -> Quantity:
        if not is_percent(raw):
            return Quantity(value=parse(raw))
        share = parse_share(raw)
        if share > 1:
            raise QuantityError(
                f"a demand is at most 100% of a host, not {raw}",
                f"write an absolute amount, such as {example}",
            )
        return Quantity(value=share, relative=True)

    share = build_quantity_schema(SHARE_PATTERN, bare_numbers=False)
    return describe_reader(read, lambda: {"anyOf": [*get_reader_schema(parse)["anyOf"], share]})


def absolute_demand_parser(parse: Callable[[object], float]) -> Callable[[object], Quantity]:
    """Reads an absolute quantity by ``parse``."""
    return describe_reader(lambda raw: Quantity(value=parse(raw)), lambda: get_reader_schema(parse))


def parse_temperature(raw: object) -> float:
    """Degrees Celsius from 30 to 120, from ``85`` or ``"85C"``."""
    text = raw.strip().removesuffix("C") if isinstance(raw, str) else raw
    try:
        value = float(text) if isinstance(text, int | float | str) and not isinstance(raw, bool) else nan
    except ValueError:
        value = nan
    if not _LEAST_MAXIMUM_C <= value <= _MOST_MAXIMUM_C:
        raise QuantityError(f"must be degrees Celsius from 30 to 120, not {raw!r}", "write 85 or 85C")
    return value


describe_reader(
    parse_temperature,
    lambda: {
        "anyOf": [
            {"type": "number", "minimum": _LEAST_MAXIMUM_C, "maximum": _MOST_MAXIMUM_C},
            {"type": "string", "pattern": r"^\s*[0-9]+(\.[0-9]+)?C?\s*$"},
        ]
    },
)


@describe_as(lambda: {"type": "number", "minimum": 0, "maximum": 1})
def parse_margin(raw: object) -> float:
    """A utility from 0 to 1."""
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not 0 <= raw <= 1:
        raise QuantityError(f"must be a number from 0 to 1, not {raw!r}", "write 0.1")
    return float(raw)


@describe_as(lambda: {"type": "number", "minimum": 0, "maximum": MAX_COST})
def parse_cost(raw: object) -> float:
    """A utility per second, finite and 0 or more."""
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not 0 <= raw <= MAX_COST:
        raise QuantityError(f"must be a number from 0 to {MAX_COST:g}, not {raw!r}", "write 0.5")
    return float(raw)
