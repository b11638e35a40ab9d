# SPDX-License-Identifier: Apache-2.0
"""PyYAML and its parser of events in C; what it has in Python beside it is imported when it is used."""

from typing import Any

from edgectl.deferred_imports import import_deferred

import_deferred("yaml")
import yaml as yaml  # noqa: E402 - what is deferred is chosen before

EVENT_PARSER: Any  # the stubs know it as no loader
try:
    from yaml._yaml import CParser

    EVENT_PARSER = CParser
except ImportError:
    EVENT_PARSER = yaml.SafeLoader
