"""omega of eq. (4): presets, what people write, and normalisation to sum 1."""

import math
from collections.abc import Mapping
from types import MappingProxyType

from edgectl.model.policy import Weights

WEIGHT_NAMES = ("cpu", "memory", "network", "task")
WEIGHT_PRESETS: Mapping[str, Weights] = MappingProxyType(
    {
        "cpu": Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0),
        "memory": Weights(cpu=0.0, memory=1.0, network=0.0, task=0.0),
        "network": Weights(cpu=0.0, memory=0.0, network=1.0, task=0.0),
        "task": Weights(cpu=0.0, memory=0.0, network=0.0, task=1.0),
        "all": Weights(cpu=0.25, memory=0.25, network=0.25, task=0.25),
        "resources": Weights(cpu=1 / 3, memory=1 / 3, network=1 / 3, task=0.0),
    }
)
_WEIGHT_FORMS = f"write one of {', '.join(WEIGHT_PRESETS)}, or weights such as cpu=.5,network=.5"


def parse_weights(raw: object) -> Weights:
    """Weights, summing to 1, from a preset's name, text such as ``cpu=.5,network=.5`` or a mapping of numbers.

    A weight that is not named is 0.

    Raises:
        ValueError: unknown name, not a finite number >= 0, or all 0.
    """
    if isinstance(raw, Weights):
        return normalise_weights(raw)
    if isinstance(raw, Mapping):
        return _weights_from_mapping(raw)
    if not isinstance(raw, str):
        raise ValueError(f"cannot be read as weights: {raw!r}; {_WEIGHT_FORMS}")
    text = raw.strip()
    if text in WEIGHT_PRESETS:
        return WEIGHT_PRESETS[text]
    if "=" not in text:
        raise ValueError(f"unknown weights {text!r}; {_WEIGHT_FORMS}")
    return _weights_from_mapping(_parse_weight_pairs(text))


def normalise_weights(weights: Weights) -> Weights:
    """The same proportions with sum 1.

    Raises:
        ValueError: a weight is negative or not finite, or all are 0.
    """
    values = [getattr(weights, name) for name in WEIGHT_NAMES]
    for name, value in zip(WEIGHT_NAMES, values, strict=True):
        if not math.isfinite(value) or value < 0:
            raise ValueError(
                f"weight {name} must be a finite number, 0 or more, got {value!r}; {_WEIGHT_FORMS}"
            )
    largest = max(values)
    if largest == 0:
        raise ValueError(f"at least one weight must be more than 0; {_WEIGHT_FORMS}")
    if not math.isfinite(sum(values)):
        values = [value / largest for value in values]
    total = math.fsum(values)
    return Weights(**{name: value / total for name, value in zip(WEIGHT_NAMES, values, strict=True)})


def _parse_weight_pairs(text: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = part.partition("=")
        name = name.strip()
        if name in found:
            raise ValueError(f"weight {name} is given twice; {_WEIGHT_FORMS}")
        try:
            found[name] = float(number)
        except ValueError:
            raise ValueError(
                f"weight {name} must be a number, got {number.strip()!r}; {_WEIGHT_FORMS}"
            ) from None
    return found


def _weights_from_mapping(raw: Mapping[object, object] | Mapping[str, float]) -> Weights:
    values = dict.fromkeys(WEIGHT_NAMES, 0.0)
    for name, value in raw.items():
        if name not in values:
            raise ValueError(f"unknown weight {name!r}; the weights are {', '.join(WEIGHT_NAMES)}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"weight {name} must be a number, got {value!r}; {_WEIGHT_FORMS}")
        values[str(name)] = _weight_to_float(str(name), value)
    return normalise_weights(Weights(**values))


def _weight_to_float(name: str, value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"weight {name} is too large; {_WEIGHT_FORMS}") from None
