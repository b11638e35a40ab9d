# SPDX-License-Identifier: Apache-2.0
"""Parsing and formatting of quantities: cores, bytes, bytes per second, shares, durations, instants.

Parsers take a YAML value (number or string) and raise ``QuantityError``, whose hint names the accepted forms.
"""

import math
import re
from collections.abc import Callable
from datetime import UTC, datetime

from edgectl.dataclass import dataclass

_BYTE_UNITS = {
    "": 1,
    "B": 1,
    "k": 10**3,
    "K": 10**3,
    "M": 10**6,
    "G": 10**9,
    "T": 10**12,
    "kB": 10**3,
    "KB": 10**3,
    "MB": 10**6,
    "GB": 10**9,
    "TB": 10**12,
    "Ki": 2**10,
    "Mi": 2**20,
    "Gi": 2**30,
    "Ti": 2**40,
    "KiB": 2**10,
    "MiB": 2**20,
    "GiB": 2**30,
    "TiB": 2**40,
}
_BIT_UNITS = {"bit": 1, "kbit": 10**3, "Kbit": 10**3, "Mbit": 10**6, "Gbit": 10**9}
_SECONDS_PER_UNIT = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_NUMBER = r"([0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{1,3})?)"
_WITH_UNIT = re.compile(_NUMBER + r"\s*([A-Za-z/]*)")
_DURATION = re.compile(r"(?:[0-9]+(?:\.[0-9]+)?(?:ms|s|m|h|d))+")
_DURATION_PART = re.compile(r"([0-9]+(?:\.[0-9]+)?)(ms|s|m|h|d)")
# How quantities are written as text, for JSON Schemas.
CORES_PATTERN = rf"{_NUMBER}\s*m?"
BYTES_PATTERN = rf"{_NUMBER}\s*(?:{'|'.join(filter(None, _BYTE_UNITS))})?"
RATE_PATTERN = rf"{_NUMBER}\s*(?:(?:{'|'.join((*filter(None, _BYTE_UNITS), *_BIT_UNITS))})/s)?"
SHARE_PATTERN = rf"{_NUMBER}\s*%"
DURATION_PATTERN = _DURATION.pattern
_INSTANT = re.compile(r"\d{4}-\d{2}-\d{2}[Tt]\d{2}:\d{2}:\d{2}(?:\.\d{1,6})?(?:[Zz]|[+-]\d{2}:\d{2})")
# Of years that have four digits in every time zone.
_FIRST_INSTANT_S, _LAST_INSTANT_S = -62_135_500_000.0, 253_402_200_000.0


class QuantityError(ValueError):
    """A value that is no valid quantity. ``hint`` says how to write one; the message never contains it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


def _check_finite(value: float, forms: str) -> float:
    if not math.isfinite(value) or value < 0:
        raise QuantityError(f"must be a finite number, 0 or more, got {value!r}", forms)
    return value


def _parse_number(raw: object, forms: str) -> float | None:
    if isinstance(raw, bool):
        raise QuantityError("must not be true or false", forms)
    if not isinstance(raw, int | float):
        return None
    try:
        return _check_finite(float(raw), forms)
    except OverflowError:
        raise QuantityError("is too large", forms) from None


def _parse_scaled(raw: object, units: dict[str, float], forms: str) -> float:
    number = _parse_number(raw, forms)
    if number is not None:
        return number
    match = _WITH_UNIT.fullmatch(str(raw).strip()) if isinstance(raw, str) else None
    if match is None or match[2] not in units:
        raise QuantityError(f"cannot be read as a quantity: {raw!r}", forms)
    return _check_finite(float(match[1]) * units[match[2]], forms)


def parse_cores(raw: object) -> float:
    """Cores from ``0.5``, ``"0.5"`` or ``"500m"``."""
    return _parse_scaled(raw, {"": 1.0, "m": 0.001}, "write cores as 0.5 or 500m")


def parse_bytes(raw: object) -> float:
    """Bytes from a number or a string such as ``90Mi``, ``1.5G`` or ``800MiB``."""
    return _parse_scaled(raw, dict(_BYTE_UNITS), "write bytes as 90Mi, 1.5G or 800MiB")


def parse_rate(raw: object) -> float:
    """Bytes per second from a number or a string such as ``12MB/s``, ``300kB/s`` or ``96Mbit/s``."""
    units = {"": 1.0}
    units |= {f"{unit}/s": float(scale) for unit, scale in _BYTE_UNITS.items() if unit}
    units |= {f"{unit}/s": scale / 8 for unit, scale in _BIT_UNITS.items()}
    return _parse_scaled(raw, units, "write rates as 12MB/s, 300kB/s or 96Mbit/s")


def parse_gpus(raw: object) -> float:
    """Graphics processors from ``0.5``, ``"50%"`` (of one) or ``2``."""
    if is_percent(raw):
        return parse_share(raw)
    return _parse_scaled(raw, {"": 1.0}, "write shares of a GPU as 50% or 0.5")


def parse_watts(raw: object) -> float:
    """Watts from a number or a string such as ``15W`` or ``500mW``."""
    return _parse_scaled(raw, {"": 1.0, "W": 1.0, "mW": 0.001}, "write watts as 15W or 500mW")


def parse_charge(raw: object) -> float:
    """A share of a full battery, at most 1, from ``0.2`` or ``"20%"``."""
    forms = "write shares of a full battery as 20% or 0.2"
    value = parse_share(raw) if is_percent(raw) else _parse_scaled(raw, {"": 1.0}, forms)
    if value > 1:
        raise QuantityError(f"is more than a full battery: {raw!r}", forms)
    return value


def is_percent(raw: object) -> bool:
    """Whether ``raw`` is written as a percentage."""
    return isinstance(raw, str) and raw.strip().endswith("%")


def parse_share(raw: object) -> float:
    """A share in 0..1 (or above, for overcommit) from ``"35.2%"``."""
    match = re.fullmatch(_NUMBER + r"\s*%", raw.strip()) if isinstance(raw, str) else None
    if match is None:
        raise QuantityError(f"cannot be read as a percentage: {raw!r}", "write 80%")
    return _check_finite(float(match[1]) / 100.0, "write 80%")


def parse_duration(raw: object) -> float:
    """Seconds from a number of seconds or a string such as ``20s``, ``2m``, ``1h30m`` or ``500ms``."""
    forms = "write durations as 20s, 2m or 1h30m"
    number = _parse_number(raw, forms)
    if number is not None:
        return number
    text = str(raw).strip()
    if not isinstance(raw, str) or _DURATION.fullmatch(text) is None:
        raise QuantityError(f"cannot be read as a duration: {raw!r}", forms)
    return _check_finite(
        sum(float(n) * _SECONDS_PER_UNIT[unit] for n, unit in _DURATION_PART.findall(text)), forms
    )


def parse_instant(raw: object) -> float:
    """Seconds since 1970 (UTC) from an RFC 3339 string."""
    try:
        if isinstance(raw, str) and _INSTANT.fullmatch(raw):
            seconds = datetime.fromisoformat(raw.upper()).timestamp()
            if _FIRST_INSTANT_S <= seconds <= _LAST_INSTANT_S:
                return seconds
    except ValueError:
        pass
    raise QuantityError(f"cannot be read as an instant: {raw!r}", "write 2026-11-21T08:00:00Z")


def format_instant(epoch_s: float) -> str:
    """RFC 3339 in UTC, milliseconds only where there are any: ``2026-11-21T08:00:00Z``."""
    instant = datetime.fromtimestamp(round(epoch_s, 3), UTC)
    precision = "milliseconds" if instant.microsecond else "seconds"
    return instant.isoformat(timespec=precision).replace("+00:00", "Z")


def format_bytes(value: float) -> str:
    """Bytes for people, binary units, three significant digits: ``90.0Mi``."""
    for unit, scale in (("Ti", 2**40), ("Gi", 2**30), ("Mi", 2**20), ("Ki", 2**10)):
        if abs(value) >= scale:
            return f"{value / scale:.1f}{unit}"
    return f"{value:.0f}B"


def format_rate(value: float) -> str:
    """Bytes per second for people, decimal units: ``12.0MB/s``."""
    for unit, scale in (("GB/s", 1e9), ("MB/s", 1e6), ("kB/s", 1e3)):
        if abs(value) >= scale:
            return f"{value / scale:.1f}{unit}"
    return f"{value:.0f}B/s"


def format_cores(value: float) -> str:
    """Cores for people: ``0.52``, below a tenth in thousandths: ``3m``."""
    return f"{value * 1000:.0f}m" if abs(value) < 0.1 else f"{value:.2f}"


def format_gpus(value: float) -> str:
    """Graphics processors for people: ``0.50``."""
    return f"{value:.2f}"


def _format_gpus_in_text(value: float) -> str:
    return f"{value:.2f} GPUs"


def _format_gpus_for_file(value: float) -> str:
    return _format_rounded_up(value)


def format_watts(value: float) -> str:
    """Watts for people: ``12.5W``."""
    return f"{value:.1f}W"


def _format_watts_for_file(value: float) -> str:
    return _format_rounded_up(value) + "W"


def format_charge(value: float) -> str:
    """A share of a full battery for people: ``20%``."""
    return f"{value:.0%}"


def _format_charge_for_file(value: float) -> str:
    return _format_rounded_up(value * 100) + "%"


def format_cores_for_file(value: float) -> str:
    """Cores for a file, rounded up: ``1.36``."""
    return _format_rounded_up(max(value, 0.001) if value > 0 else 0.0)


def format_bytes_for_file(value: float) -> str:
    """Bytes for a file, rounded up: ``97.3Mi``."""
    unit, scale = next(
        ((unit, 2.0**power) for unit, power in (("Gi", 30), ("Mi", 20), ("Ki", 10)) if value >= 2**power),
        ("", 1.0),
    )
    return _format_rounded_up(value / scale) + unit


def format_rate_for_file(value: float) -> str:
    """Bytes per second for a file, rounded up: ``127kB/s``."""
    unit, scale = next(
        ((unit, scale) for unit, scale in (("GB/s", 1e9), ("MB/s", 1e6), ("kB/s", 1e3)) if value >= scale),
        ("", 1.0),
    )
    return _format_rounded_up(value / scale) + unit


def _format_rounded_up(value: float) -> str:
    """Round up to three significant digits, never below ``value``, without exponents."""
    if value <= 0:
        return "0"
    digits = max(0, 2 - math.floor(math.log10(value)))
    return (
        f"{math.ceil(value * 10**digits - 1e-9) / 10**digits:.{digits}f}".rstrip("0").rstrip(".")
        if digits
        else f"{math.ceil(value)}"
    )


def format_duration(seconds: float) -> str:
    """A duration or age for people, two units at most: ``3m12s``, ``1h03m``, ``0.4s``."""
    if seconds < 10:
        return f"{seconds:.1f}s"
    whole = round(seconds)
    for (unit, scale), (lower, step) in zip(
        (("d", 86400), ("h", 3600), ("m", 60)), (("h", 3600), ("m", 60), ("s", 1)), strict=True
    ):
        if whole >= scale:
            return f"{whole // scale}{unit}{whole % scale // step:02d}{lower}"
    return f"{whole}s"


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """A unit of measurement: parser and formats of its amounts.

    ``name``: the unit in documents. ``example``: an amount as a task file states it; ``pattern``: all such
    texts, for JSON Schemas. ``format``: for columns; ``format_in_text``: for sentences, with the unit;
    ``format_exact``: for comparisons in sentences; ``format_for_file``: rounded up, as ``parse`` reads it.
    """

    name: str
    example: str
    pattern: str
    parse: Callable[[object], float]
    format: Callable[[float], str]
    format_in_text: Callable[[float], str]
    format_exact: Callable[[float], str]
    format_for_file: Callable[[float], str]


def _format_cores_in_text(value: float) -> str:
    return f"{value:.{2 if abs(value) >= 0.1 else 3}f} cores"


def _format_exact_cores(value: float) -> str:
    return f"{value:.3f} cores"


CORES = Unit(
    name="cores", example="1.5", pattern=CORES_PATTERN, parse=parse_cores,
    format=format_cores, format_in_text=_format_cores_in_text,
    format_exact=_format_exact_cores, format_for_file=format_cores_for_file,
)  # fmt: skip
BYTES = Unit(
    name="bytes", example="900Mi", pattern=BYTES_PATTERN, parse=parse_bytes,
    format=format_bytes, format_in_text=format_bytes,
    format_exact=format_bytes, format_for_file=format_bytes_for_file,
)  # fmt: skip
BYTES_PER_S = Unit(
    name="bytes_per_s", example="12MB/s", pattern=RATE_PATTERN, parse=parse_rate,
    format=format_rate, format_in_text=format_rate,
    format_exact=format_rate, format_for_file=format_rate_for_file,
)  # fmt: skip
GPUS = Unit(
    name="gpus", example="0.5", pattern=rf"{_NUMBER}\s*%?", parse=parse_gpus,
    format=format_gpus, format_in_text=_format_gpus_in_text,
    format_exact=_format_gpus_in_text, format_for_file=_format_gpus_for_file,
)  # fmt: skip
WATTS = Unit(
    name="watts", example="10W", pattern=rf"{_NUMBER}\s*m?W?", parse=parse_watts,
    format=format_watts, format_in_text=format_watts,
    format_exact=format_watts, format_for_file=_format_watts_for_file,
)  # fmt: skip
CHARGE = Unit(
    name="charge", example="5%", pattern=rf"{_NUMBER}\s*%?", parse=parse_charge,
    format=format_charge, format_in_text=format_charge,
    format_exact=format_charge, format_for_file=_format_charge_for_file,
)  # fmt: skip
