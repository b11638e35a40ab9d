# SPDX-License-Identifier: Apache-2.0
"""Reader of sweep files (``edgectl simulate sweep``)."""

from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from edgectl.config.fields import Fields, list_reader_with_nodes, read_fields
from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.quantities import parse_margin
from edgectl.config.scalars import (
    INVALID,
    NodeReader,
    enum_reader,
    integer_reader,
    quantity_reader,
    read_name,
    read_safe_argument,
    read_version,
    report_wrong_type,
)
from edgectl.config.schema import Schema, build_file_schema, build_object_schema, describe_as
from edgectl.config.source import read_source
from edgectl.config.yaml_parser import parse_yaml
from edgectl.errors import UsageError
from edgectl.experiments.files.experiment_file import build_listed_schemes, read_schemes
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.files.sweep_worlds import SETTINGS, World, build_world
from edgectl.experiments.model.scenario import Radio
from edgectl.experiments.model.sweep import Sweep, SweepBounds, SweepWorld
from edgectl.model.task import Tasks
from edgectl.units import QuantityError, parse_cores, parse_duration, parse_share

MAX_SWEEP_RUNS, MAX_WORLDS = 1000, 100_000
DEFAULT_RUNS = 20
_INVENTORY = "inventory"


@describe_as(lambda: {"type": "number", "minimum": 1})
def _parse_ratio(raw: object) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not 1 <= raw <= 1e6:
        raise QuantityError("must be a number from 1", "write 10 for a tenth")
    return float(raw)


VARY_KEYS: Mapping[str, NodeReader] = {
    key: list_reader_with_nodes(read)
    for key, read in {
        "robot_cores": quantity_reader(parse_cores, above_zero=True),
        "link_ratio": quantity_reader(_parse_ratio),
        "radio": enum_reader(Radio),
        "noise": quantity_reader(parse_share),
        "every": quantity_reader(parse_duration, above_zero=True),
        "margin": quantity_reader(parse_margin),
        "dwell": quantity_reader(parse_duration),
        _INVENTORY: read_safe_argument,
    }.items()
}


@describe_as(lambda: {"type": "array", "items": build_object_schema(VARY_KEYS, ())})
def _read_blocks(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A list of mappings; each stands for all combinations of its values."""
    if not isinstance(node.value, list):
        hint = "write - {link_ratio: [1, 10]} on a line of its own"
        return report_wrong_type(node, problems, "vary must be a list of mappings", hint)
    blocks = [read_fields(inner, problems, VARY_KEYS, what="a block of vary") for inner in node.value]
    for block in blocks:
        for key, values in block.values.items():
            if not values:
                problems.add(
                    block.at(key).mark,
                    ProblemCode.MISSING,
                    f"no values of {key}",
                    "write a value, or remove it",
                )
    return tuple(blocks)


@describe_as(lambda: {"type": ["string", "number"]})
def _read_error(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    value = quantity_reader(parse_share)(node, problems)
    if value is not INVALID and not 0.0 < value <= 0.5:
        message = f"must be above 0% and at most 50%, not {node.text}"
        problems.add(node.mark, ProblemCode.QUANTITY, message, "write 5%")
        return INVALID
    return value


SWEEP_KEYS: Mapping[str, NodeReader] = {
    "version": read_version,
    "name": read_name,
    "scenario": read_safe_argument,
    "schemes": read_schemes,
    "runs": integer_reader(1, MAX_SWEEP_RUNS),
    "seed": integer_reader(0, 2**31),
    "error": _read_error,
    "vary": _read_blocks,
}
_REQUIRED_KEYS = ("version", "name", "scenario")


def build_sweep_schema() -> Schema:
    """JSON Schema of a sweep file."""
    return build_file_schema("sweep", build_object_schema(SWEEP_KEYS, _REQUIRED_KEYS))


class _Value(NamedTuple):
    """One value of a setting, its place, and how the file writes it."""

    key: str
    value: Any
    node: Node

    @property
    def text(self) -> str:
        return self.value if self.key == _INVENTORY else self.node.text


def load_sweep(path: Path) -> Sweep:
    """The sweep in a file, with its worlds in the order of the file.

    Raises:
        InputError: all faults of the file, or of a file that it names.
        UsageError: it has too many worlds.
    """
    problems = Problems()
    source = read_source(path, problems)
    node = parse_yaml(source, problems) if source is not None else None
    fields = (
        None
        if node is None
        else read_fields(node, problems, SWEEP_KEYS, required=_REQUIRED_KEYS, what="a sweep")
    )
    if fields is not None and "scenario" in fields.values:
        _check_file(path, fields.values["scenario"], fields.at("scenario"), "a scenario file", problems)
    for block in fields.values.get("vary", ()) if fields is not None else ():
        for name, inner in block.values.get(_INVENTORY, ()):
            _check_file(path, name, inner, "an inventory", problems)
    problems.check()
    assert fields is not None  # noqa: S101 - no problems: it was read
    return _build_sweep(path, fields, problems)


def _check_file(path: Path, name: str, node: Node, what: str, problems: Problems) -> None:
    if not (path.parent / name).is_file():
        hint = f"name {what}, relative to this file"
        problems.add(node.mark, ProblemCode.UNREADABLE, f"file not found: {path.parent / name}", hint)


def _build_sweep(path: Path, fields: Fields, problems: Problems) -> Sweep:
    values = fields.values
    bounds = SweepBounds(
        runs=values.get("runs", DEFAULT_RUNS), seed=values.get("seed", 1), error=values.get("error")
    )
    blocks: tuple[Fields, ...] = values.get("vary", ())
    combinations = list(_list_combinations(blocks))
    if len(combinations) > MAX_WORLDS:
        raise UsageError(
            f"{path}: {len(combinations)} worlds, at most {MAX_WORLDS}", hint="vary fewer settings at once"
        )
    worlds = list(_build_worlds(path, fields, combinations, bounds, problems))
    problems.check()
    axes = dict.fromkeys(key for block in blocks for key in block.values)
    return Sweep(name=values["name"], axes=tuple(axes), worlds=tuple(worlds), bounds=bounds)


def _list_combinations(blocks: tuple[Fields, ...]) -> Iterator[tuple[_Value, ...]]:
    """The settings of each world; without blocks one world as the scenario has it."""
    if not blocks:
        yield ()
    for block in blocks:
        yield from product(
            *([_Value(key, value, node) for value, node in found] for key, found in block.values.items())
        )


def _build_worlds(
    path: Path,
    fields: Fields,
    combinations: list[tuple[_Value, ...]],
    bounds: SweepBounds,
    problems: Problems,
) -> Iterator[SweepWorld]:
    origins: dict[str, tuple[World, Tasks]] = {}
    scenario = path.parent / fields.values["scenario"]
    for settings in combinations:
        named = next((each.value for each in settings if each.key == _INVENTORY), "")
        if named not in origins:
            origins[named] = _load_origin(scenario, path.parent / named if named else None)
        world, tasks = origins[named]
        for each in settings:
            if each.key in SETTINGS:
                world = SETTINGS[each.key](world, each.value)
        schemes = build_listed_schemes(fields.values.get("schemes"), world.policy, problems)
        problems.check()
        yield build_world({each.key: each.text for each in settings}, world, tasks, schemes, bounds)


def _load_origin(scenario: Path, inventory: Path | None) -> tuple[World, Tasks]:
    """The world of the scenario as it is, perhaps on another fleet."""
    named_inventory, named_tasks = load_scenario_paths(scenario)
    inventory = inventory or named_inventory
    if named_tasks is None or inventory is None:
        raise UsageError(
            f"{scenario} names no inventory and tasks", hint="add inventory: FILE and tasks: FILE to it"
        )
    fleet, tasks, _ = load_inventory_and_tasks(inventory, named_tasks)
    return World(fleet, load_scenario(scenario, fleet, tasks), tasks.policy), tasks
