# SPDX-License-Identifier: Apache-2.0
"""Readers of the demand of a task."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from edgectl.config.fields import (
    record_reader,
)
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.quantities import absolute_demand_parser, demand_parser
from edgectl.config.scalars import (
    INVALID,
    NodeReader,
    quantity_reader,
)
from edgectl.config.schema import (
    Schema,
    build_object_schema,
    describe_as,
    describe_reader,
    get_reader_schema,
)
from edgectl.model.demand import Demand, Quantity
from edgectl.model.resource import RESOURCES, TASK_RESOURCES, Resource

MEASURED_WORD = "measured"
MEASURED = Quantity(value=0.0, measured=True)


@describe_as(lambda: {"anyOf": [{"const": MEASURED_WORD}, build_object_schema(DEMAND_KEYS)]})
def read_demand(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The word ``measured``, or a mapping by resource."""
    if node.value == MEASURED_WORD:
        return Demand({resource.name: MEASURED for resource in TASK_RESOURCES})
    return record_reader(DEMAND_KEYS, _build_demand, "demand")(node, problems)


def _build_demand(**quantities: Quantity) -> Demand:
    """A demand out of its keys in the file."""
    return Demand(
        {
            resource.name: quantities[resource.demand_key]
            for resource in RESOURCES
            if resource.demand_key in quantities
        }
    )


def _demand_quantity_reader(parse: Callable[[object], Quantity]) -> NodeReader:
    """One demand: a quantity, the word ``measured``, or a quantity that counts until then."""
    quantity = quantity_reader(parse)

    def describe() -> Schema:
        stated = get_reader_schema(quantity)
        until_measured = build_object_schema({"until_measured": quantity}, ("until_measured",))
        return {"anyOf": [{"const": MEASURED_WORD}, *stated["anyOf"], until_measured]}

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if node.value == MEASURED_WORD:
            return MEASURED
        if isinstance(node.value, str) and node.value.isalpha():
            hint = problems.did_you_mean(node.value, [MEASURED_WORD], "write a quantity, or")
            problems.add(node.mark, ProblemCode.WORD, f"unknown word {node.value!r}", hint)
            return INVALID
        if not isinstance(node.value, dict):
            return quantity(node, problems)
        until = record_reader(
            {"until_measured": quantity}, _mark_measured, "a measured demand", ("until_measured",)
        )
        return until(node, problems)

    return describe_reader(read, describe)


def _mark_measured(*, until_measured: Quantity) -> Quantity:
    return replace(until_measured, measured=True)


def _build_demand_reader(resource: Resource) -> NodeReader:
    """What no host can tell of one task is stated, and never as a share of a host."""
    if not resource.optional:
        return _demand_quantity_reader(demand_parser(resource.unit.parse, resource.unit.example))
    return quantity_reader(absolute_demand_parser(resource.unit.parse))


DEMAND_KEYS: Mapping[str, NodeReader] = {
    resource.demand_key: _build_demand_reader(resource) for resource in RESOURCES
}
