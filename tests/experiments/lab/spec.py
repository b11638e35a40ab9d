# SPDX-License-Identifier: Apache-2.0
"""Other forms of the shipped spec."""

import json

import yaml


def shortened(text: str, *, repetitions: int, policies: str = "", weights: str = "", every: str = "") -> str:
    """The spec with fewer trials."""
    spec = yaml.safe_load(text)
    spec["repetitions"] = repetitions
    for key, words in (("policies", policies), ("weights", weights)):
        if words:
            spec["schemes"][key] = words.split(",")
    if every:
        spec["every"] = every
    return json.dumps(spec, indent=1)
