# SPDX-License-Identifier: Apache-2.0
"""Reader of ``cycles:`` in scenario files."""

from collections.abc import Mapping

from edgectl.config.fields import Fields, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import Problems
from edgectl.config.scalars import NodeReader, quantity_reader, read_name, read_text, report_wrong_type
from edgectl.config.schema import Schema, build_object_schema, describe_as
from edgectl.experiments.files.fleet_files import check_name_exists
from edgectl.experiments.model.scenario import SimCycle
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from edgectl.units import QuantityError, parse_bytes, parse_duration


@describe_as(lambda: {"type": "number"})
def parse_number(raw: object) -> float:
    """A plain number.

    Raises:
        QuantityError: it is another value.
    """
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise QuantityError("must be a number", "write 3.5")
    return float(raw)


_read_cpu_s = quantity_reader(parse_duration)
CYCLE_KEYS: Mapping[str, NodeReader] = {
    "for_each": read_text,
    "rate": quantity_reader(parse_number, above_zero=True),
    "cpu": _read_cpu_s,
    "transfer": quantity_reader(parse_bytes),
    "source": read_name,
    "source_cpu": _read_cpu_s,
}
_REQUIRED_KEYS = ("rate", "cpu")


def build_cycles_schema() -> Schema:
    """JSON Schema of the key."""
    return {"type": "object", "additionalProperties": build_object_schema(CYCLE_KEYS, _REQUIRED_KEYS)}


def read_cycles(node: Node, inventory: Inventory, tasks: Tasks, problems: Problems) -> dict[str, SimCycle]:
    """The cycles by task; one with ``for_each: robot`` holds for each task NAME-ROBOT."""
    if not isinstance(node.value, dict):
        report_wrong_type(node, problems, "cycles must be a mapping", "write detection: {rate: 5, cpu: 30ms}")
        return {}
    found = {}
    for key, inner in node.value.items():
        fields = read_fields(inner, problems, CYCLE_KEYS, required=_REQUIRED_KEYS, what="a cycle")
        if not all(required in fields.values for required in _REQUIRED_KEYS):
            continue
        endings = [f"-{robot.name}" for robot in inventory.robots] if "for_each" in fields else [""]
        for ending in endings:
            if check_name_exists(node, f"{key}{ending}", tasks.tasks, "task", problems):
                found[f"{key}{ending}"] = _build_cycle(fields, ending, tasks, problems)
    return found


def _build_cycle(fields: Fields, ending: str, tasks: Tasks, problems: Problems) -> SimCycle:
    values = {key: value for key, value in fields.values.items() if key != "for_each"}
    if "source" in values:
        values["source"] += ending
        check_name_exists(fields.at("source"), values["source"], tasks.tasks, "task", problems)
    return SimCycle(**values)
