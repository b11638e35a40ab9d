"""Reader of experiment files (``edgectl experiment run``)."""

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from edgectl.agent.link import protocol
from edgectl.config.fields import (
    Fields,
    keep_node,
    list_reader_with_nodes,
    mapping_reader,
    read_fields,
    record_reader,
)
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import (
    INVALID,
    NAME_PATTERN,
    NodeReader,
    check_name,
    enum_reader,
    integer_reader,
    quantity_reader,
    read_name,
    read_safe_argument,
    read_text,
    read_version,
)
from edgectl.config.schema import (
    Schema,
    build_file_schema,
    build_object_schema,
    describe_as,
    get_reader_schema,
    limit_quantity_schema,
)
from edgectl.config.source import read_source
from edgectl.config.weights import parse_weights
from edgectl.config.yaml_parser import parse_yaml
from edgectl.experiments.files.event_keys import EXPERIMENT_EVENT_KEYS, build_events_schema
from edgectl.experiments.files.event_readers import can_complete, read_experiment_events
from edgectl.experiments.files.fleet_files import resolve_fleet_files
from edgectl.experiments.model.experiment import Experiment, MapPair, MetricAggregation
from edgectl.experiments.model.schemes import Scheme, build_schemes
from edgectl.model.inventory import Inventory
from edgectl.model.policy import WEIGHT_PRESETS, Policy, PolicyName, Weights
from edgectl.model.task import Tasks
from edgectl.units import QuantityError, parse_duration, parse_share

EntriesWithNodes = tuple[tuple[Any, Node], ...]

MIN_SAMPLE_PERIOD_S, MAX_REPETITIONS = 0.5, 1000
# The same as for ``edgectl simulate`` without options.
DEFAULT_POLICIES = (PolicyName.LOCAL, PolicyName.STATIC, PolicyName.UTILITY)
DEFAULT_WEIGHTS = ("cpu", "memory", "network", "all")
_METRIC_NAME_PATTERN = re.compile(protocol.METRIC_NAME_PATTERN)
_MAP_NAME_PATTERN = re.compile(r"[A-Za-z][A-Za-z0-9 ._-]{0,62}")


@describe_as(lambda: {"type": "string", "pattern": f"^ *(?:{'|'.join(WEIGHT_PRESETS)}) *$|="})
def _read_scheme_weights(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    """A preset, or a set such as ``cpu=.5,task=1``; returned as text."""
    value = read_text(node, problems)
    if value is INVALID:
        return INVALID
    try:
        parse_weights(value)
    except QuantityError as error:
        problems.add(node.mark, ProblemCode.WORD, error.message, error.hint)
        return INVALID
    return value.strip()


@describe_as(lambda: limit_quantity_schema(get_reader_schema(parse_duration), above_zero=True, at_most=None))
def _read_period(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    value = quantity_reader(parse_duration, above_zero=True)(node, problems)
    if value is not INVALID and value < MIN_SAMPLE_PERIOD_S:
        problems.add(node.mark, ProblemCode.QUANTITY, f"{node.text} is too short", "write 500ms or more")
        return INVALID
    return value


@describe_as(lambda: get_reader_schema(parse_share))
def _read_idle_share(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    value = quantity_reader(parse_share)(node, problems)
    if value is not INVALID and not 0.0 < value <= 1.0:
        problems.add(
            node.mark,
            ProblemCode.QUANTITY,
            f"must be above 0% and at most 100%, not {node.text}",
            "write 25%",
        )
        return INVALID
    return value


SCHEMES_KEYS: Mapping[str, NodeReader] = {
    "policies": list_reader_with_nodes(enum_reader(PolicyName)),
    "weights": list_reader_with_nodes(_read_scheme_weights),
}
MAP_PAIR_KEYS: Mapping[str, NodeReader] = {
    "task": read_name,
    "file": read_safe_argument,
    "truth": read_safe_argument,
}


@describe_as(lambda: build_object_schema(SCHEMES_KEYS, ("policies",)))
def _read_schemes(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    return read_fields(node, problems, SCHEMES_KEYS, required=("policies",), what="schemes")


EXPERIMENT_KEYS: Mapping[str, NodeReader] = {
    "version": read_version,
    "name": read_name,
    "inventory": read_safe_argument,
    "tasks": read_safe_argument,
    "schemes": _read_schemes,
    "repetitions": integer_reader(1, MAX_REPETITIONS),
    "every": _read_period,
    "limit": quantity_reader(parse_duration, above_zero=True),
    "until": list_reader_with_nodes(read_name),
    "idle": _read_idle_share,
    "equivalence": quantity_reader(parse_share, above_zero=True),
    "metrics": mapping_reader(_METRIC_NAME_PATTERN, "a metric", enum_reader(MetricAggregation)),
    "maps": mapping_reader(
        _MAP_NAME_PATTERN,
        "a column",
        record_reader(MAP_PAIR_KEYS, MapPair, "a map", ("task", "file", "truth")),
    ),
    "events": keep_node,
}


_REQUIRED_KEYS = ("version", "name", "until")


def build_experiment_schema() -> Schema:
    """JSON Schema of an experiment file."""
    return build_file_schema(
        "experiment",
        build_object_schema(
            EXPERIMENT_KEYS, _REQUIRED_KEYS, events=build_events_schema(EXPERIMENT_EVENT_KEYS)
        ),
    )


def load_experiment_paths(path: Path) -> tuple[Path | None, Path | None]:
    """Paths of the inventory and task file named in the experiment file, relative to it; None if not named.

    Raises:
        InputError: all faults of the file's structure.
    """
    return resolve_fleet_files(path, *_read_experiment_fields(path))


def load_experiment(
    path: Path, inventory: Inventory, tasks: Tasks, problems: Problems | None = None
) -> Experiment:
    """The experiment in a file, for a fleet; ``problems`` collects the warnings.

    Paths of ground truth maps stay relative to the file.

    Raises:
        InputError: all faults of the file.
    """
    fields, problems = _read_experiment_fields(path, problems)
    experiment = _build_experiment(fields, path.parent, inventory, tasks, problems) if fields else None
    problems.check()
    assert experiment is not None  # noqa: S101 - no problems: it was read
    return experiment


def _read_experiment_fields(path: Path, problems: Problems | None = None) -> tuple[Fields | None, Problems]:
    problems = problems or Problems()
    source = read_source(path, problems)
    node = parse_yaml(source, problems) if source is not None else None
    return (
        None
        if node is None
        else read_fields(node, problems, EXPERIMENT_KEYS, required=_REQUIRED_KEYS, what="an experiment")
    ), problems


def _build_experiment(
    fields: Fields, directory: Path, inventory: Inventory, tasks: Tasks, problems: Problems
) -> Experiment:
    values = fields.values
    if "name" in values and not NAME_PATTERN.fullmatch(values["name"]):
        check_name(values["name"], fields.at("name"), problems, "an experiment")
    _check_map_pairs(fields.at("maps"), values.get("maps", {}), directory, tasks, problems)
    given = {
        key: values[key]
        for key in ("repetitions", "every", "limit", "idle", "equivalence", "metrics", "maps")
        if key in values
    }
    return Experiment(
        name=values.get("name", ""),
        schemes=_build_experiment_schemes(values.get("schemes"), tasks.policy, problems),
        until=tuple(dict.fromkeys(_resolve_until_tasks(fields, tasks, problems))),
        events=read_experiment_events(fields.at("events"), inventory, tasks, problems)
        if "events" in fields
        else (),
        **given,
    )


def _build_experiment_schemes(schemes: Fields | None, base: Policy, problems: Problems) -> tuple[Scheme, ...]:
    if schemes is None:
        return build_schemes(base, DEFAULT_POLICIES, _parse_weight_sets(DEFAULT_WEIGHTS), [])
    policies, weights = (
        list(_drop_duplicates(schemes.values.get(key, ()), problems)) for key in ("policies", "weights")
    )
    if schemes.values.get("policies") == ():
        problems.add(
            schemes.at("policies").mark,
            ProblemCode.MISSING,
            "no policies given",
            "write policies: [local, static, utility]",
        )
    return build_schemes(base, policies, _parse_weight_sets(weights), [])


def _parse_weight_sets(names: Iterable[str]) -> dict[str, Weights]:
    return {name: parse_weights(name) for name in names}


def _resolve_until_tasks(fields: Fields, tasks: Tasks, problems: Problems) -> Iterator[str]:
    """The tasks whose completion ends a trial; each exists and can complete.

    A template stands for all its tasks.
    """
    entries: EntriesWithNodes = fields.values.get("until", ())
    if fields.values.get("until") == ():
        problems.add(
            fields.at("until").mark, ProblemCode.MISSING, "no task ends a trial", "name a task that completes"
        )
    for name in _drop_duplicates(entries, problems):
        node = next(inner for each, inner in entries if each == name)
        named = [task for task in tasks.tasks.values() if name in (task.name, task.template)]
        if not named:
            _check_task_exists(node, name, tasks, problems)
        elif not all(map(can_complete, named)):
            message = f"{name} never completes, so a trial would not end"
            problems.add(
                node.mark,
                ProblemCode.CONTRADICTION,
                message,
                "name a task with kind: job or done_when, or add one of them to the task",
            )
        yield from (task.name for task in named)


def _check_map_pairs(
    node: Node, maps: Mapping[str, MapPair], directory: Path, tasks: Tasks, problems: Problems
) -> None:
    """The task and the ground truth of every map exist."""
    for column, pair in maps.items():
        at = node.inner(column)
        _check_task_exists(at.inner("task"), pair.task, tasks, problems)
        if not (directory / pair.truth).is_file():
            message = f"file not found: {directory / pair.truth}"
            problems.add(
                at.inner("truth").mark,
                ProblemCode.UNREADABLE,
                message,
                "name a map (.yaml, .pgm or .png), relative to this file",
            )


def _check_task_exists(node: Node, task: str, tasks: Tasks, problems: Problems) -> bool:
    if task not in tasks.tasks:
        problems.add(
            node.mark,
            ProblemCode.UNKNOWN_NAME,
            f"unknown task {task}",
            problems.did_you_mean(task, tasks.tasks, "tasks:"),
        )
    return task in tasks.tasks


def _drop_duplicates(entries: EntriesWithNodes, problems: Problems) -> Iterator[Any]:
    """The values without duplicates."""
    seen = set()
    for value, node in entries:
        if value in seen:
            problems.add(node.mark, ProblemCode.TAKEN, f"duplicate value {value}", "remove one of them")
        else:
            seen.add(value)
            yield value
