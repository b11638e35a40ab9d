# SPDX-License-Identifier: Apache-2.0
"""Weights (omega of eq. (4)) as people write them: a preset, text or a mapping."""

from collections.abc import Mapping

from edgectl.model.policy import WEIGHT_PRESETS, Weights
from edgectl.model.resource import TERMS
from edgectl.units import QuantityError

_WEIGHT_FORMS = f"write one of {', '.join(WEIGHT_PRESETS)}, or weights such as cpu=.5,network=.5"


def parse_weights(raw: object) -> Weights:
    """Weights, summing to 1, from a preset's name, text such as ``cpu=.5,network=.5`` or a mapping of
    numbers.

    A weight that is not named is 0.

    Raises:
        QuantityError: unknown name, not a finite number >= 0, or all 0.
    """
    if isinstance(raw, Mapping):
        return _weights_from_mapping(raw)
    if not isinstance(raw, str):
        raise QuantityError(f"cannot be read as weights: {raw!r}", _WEIGHT_FORMS)
    text = raw.strip()
    if text in WEIGHT_PRESETS:
        return WEIGHT_PRESETS[text]
    if "=" not in text:
        raise QuantityError(f"unknown weights {text!r}", _WEIGHT_FORMS)
    return _weights_from_mapping(_parse_weight_pairs(text))


def _parse_weight_pairs(text: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = part.partition("=")
        name = name.strip()
        if name in found:
            raise QuantityError(f"weight {name} is given twice", _WEIGHT_FORMS)
        try:
            found[name] = float(number)
        except ValueError:
            raise QuantityError(
                f"weight {name} must be a number, got {number.strip()!r}", _WEIGHT_FORMS
            ) from None
    return found


def _weights_from_mapping(raw: Mapping[object, object] | Mapping[str, float]) -> Weights:
    values = dict.fromkeys(TERMS, 0.0)
    for name, value in raw.items():
        if name not in values:
            raise QuantityError(f"unknown weight {name!r}", f"the weights are {', '.join(TERMS)}")
        values[str(name)] = _parse_weight(str(name), value)
    try:
        return Weights(values).normalised()
    except ValueError as error:
        raise QuantityError(str(error), _WEIGHT_FORMS) from None


def _parse_weight(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise QuantityError(f"weight {name} must be a number, got {value!r}", _WEIGHT_FORMS)
    try:
        return float(value)
    except OverflowError:
        raise QuantityError(f"weight {name} is too large", _WEIGHT_FORMS) from None
