# SPDX-License-Identifier: Apache-2.0
"""Readers of standby copies and of the state that a move takes along; tables of their keys."""

from collections.abc import Iterable, Mapping
from typing import Any

from edgectl.config.check_readers import check_reader, hook_reader, read_ros_name
from edgectl.config.fields import Fields, read_fields, record_reader
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.quantities import demand_parser
from edgectl.config.scalars import INVALID, NodeReader, enum_reader, integer_reader, quantity_reader
from edgectl.config.schema import build_object_schema, describe_as
from edgectl.model.check import Check, CheckLocation
from edgectl.model.demand import Demand
from edgectl.model.resource import CPU, MEMORY
from edgectl.model.standby import Activation, SaveMoment, StandbyRule, StateRule
from edgectl.units import parse_bytes

MAX_STANDBY_HOSTS = 8
NO_STANDBY = "none"
_PAIR_HINT = "write activate: COMMAND and deactivate: COMMAND, or ros_lifecycle: /NODE"


@describe_as(
    lambda: {
        "anyOf": [
            {"const": NO_STANDBY},
            build_object_schema(STANDBY_KEYS)
            | {"anyOf": [{"required": ["activate", "deactivate"]}, {"required": ["ros_lifecycle"]}]},
        ]
    }
)
def read_standby(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The word ``none``, or a mapping that says how a waiting copy becomes active."""
    if node.value == NO_STANDBY:
        return None
    if isinstance(node.value, str):
        message = f"standby: {node.text} does not say how a copy becomes active"
        problems.add(node.mark, ProblemCode.WORD, message, _PAIR_HINT)
        return INVALID
    fields = read_fields(node, problems, STANDBY_KEYS, what="standby")
    if not isinstance(node.value, dict) or not _check_pair(fields, problems):
        return INVALID
    values = fields.values
    _check_locations(fields, ("activate", "deactivate", "ready"), problems)
    demand = {each.name: values[each.demand_key] for each in _DEMAND_RESOURCES if each.demand_key in values}
    activation = Activation(
        activate=values.get("activate"),
        deactivate=values.get("deactivate"),
        lifecycle=values.get("ros_lifecycle"),
        ready=values.get("ready"),
    )
    return StandbyRule(activation=activation, hosts=values.get("warm", 1), demand=Demand(demand))


def _check_pair(fields: Fields, problems: Problems) -> bool:
    """Two commands, or a lifecycle; not both, and not one of the commands."""
    pair = [key for key in ("activate", "deactivate") if key in fields]
    if "ros_lifecycle" in fields and pair:
        message = f"{pair[0]} and ros_lifecycle do not go together"
        mark = fields.node.key_mark(pair[0])
        problems.add(mark, ProblemCode.CONTRADICTION, message, f"remove {pair[0]} or ros_lifecycle")
        return False
    if "ros_lifecycle" not in fields and len(pair) < 2:
        missing = [key for key in ("activate", "deactivate") if key not in pair]
        message = f"standby needs {' and '.join(missing)}"
        problems.add(fields.node.mark, ProblemCode.MISSING, message, _PAIR_HINT)
        return False
    return "ros_lifecycle" in fields.values or all(key in fields.values for key in pair)


def _check_locations(fields: Fields, keys: Iterable[str], problems: Problems) -> None:
    """These commands act on an instance, so they run where it is."""
    for key in keys:
        check = fields.values.get(key)
        if isinstance(check, Check) and check.on is CheckLocation.ROBOT:
            message = f"{key} runs on the host of the instance, not on the robot"
            mark = fields.at(key).key_mark("on")
            problems.add(mark, ProblemCode.CONTRADICTION, message, "remove on: robot")


@describe_as(
    lambda: (
        build_object_schema(STATE_KEYS) | {"anyOf": [{"required": ["save", "load"]}, {"required": ["topic"]}]}
    )
)
def read_state(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """Commands that print and read the state, or a latched topic."""
    fields = read_fields(node, problems, STATE_KEYS, what="state")
    if not isinstance(node.value, dict):
        return INVALID
    commands = [key for key in ("save", "load") if key in fields]
    if "topic" in fields and commands:
        mark = fields.node.key_mark(commands[0])
        message = f"{commands[0]} and topic do not go together"
        problems.add(mark, ProblemCode.CONTRADICTION, message, f"remove {commands[0]} or topic")
        return INVALID
    if "topic" not in fields and len(commands) < 2:
        hint = "write save: COMMAND and load: COMMAND, or topic: /NAME"
        problems.add(fields.node.mark, ProblemCode.MISSING, "state needs save and load, or topic", hint)
        return INVALID
    if not all(key in fields.values for key in (*commands, *(["topic"] if "topic" in fields else []))):
        return INVALID
    _check_locations(fields, commands, problems)
    return StateRule(**{_STATE_FIELDS[key]: value for key, value in fields.values.items()})


_DEMAND_RESOURCES = (CPU, MEMORY)
STANDBY_KEYS: Mapping[str, NodeReader] = {
    "warm": record_reader({"hosts": integer_reader(1, MAX_STANDBY_HOSTS)}, lambda hosts=1: hosts, "warm"),
    "activate": hook_reader(CheckLocation.HOST),
    "deactivate": hook_reader(CheckLocation.HOST),
    "ros_lifecycle": read_ros_name,
    "ready": check_reader(CheckLocation.HOST),
    **{
        resource.demand_key: quantity_reader(demand_parser(resource.unit.parse, resource.unit.example))
        for resource in _DEMAND_RESOURCES
    },
}
STATE_KEYS: Mapping[str, NodeReader] = {
    "save": hook_reader(CheckLocation.HOST),
    "load": hook_reader(CheckLocation.HOST),
    "topic": read_ros_name,
    "save_when": enum_reader(SaveMoment),
    "max_size": quantity_reader(parse_bytes, above_zero=True),
}
_STATE_FIELDS = {key: key for key in STATE_KEYS} | {"save_when": "moment", "max_size": "max_bytes"}
