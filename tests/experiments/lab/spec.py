# SPDX-License-Identifier: Apache-2.0
"""Other forms of the shipped spec."""

import json

import yaml


def shortened(text: str, *, repetitions: int, policies: str = "", weights: str = "", every: str = "") -> str:
    """The spec with fewer trials."""
    # YAML 1.1 takes the key ``on`` for a truth value; here all values are texts, but for the whole numbers.
    spec = yaml.load(text, Loader=yaml.BaseLoader)
    spec |= {"version": 1, "repetitions": repetitions}
    for key, words in (("policies", policies), ("weights", weights)):
        if words:
            spec["schemes"][key] = words.split(",")
    if every:
        spec["every"] = every
    return json.dumps(spec, indent=1)
