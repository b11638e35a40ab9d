"""Spec files of ``edgectl experiment run``: the schemes, how often, until when, and what is measured besides."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from edgectl.config.fields import Fields, items, pairs, read_fields, record
from edgectl.config.node import Node
from edgectl.config.problems import Code, Problems
from edgectl.config.scalars import INVALID, NAME, Read, amount, check_name, integer, name, path_text, text, version, word
from edgectl.config.source import read_source
from edgectl.config.yaml12 import parse_yaml
from edgectl.model.evidence import Variant
from edgectl.model.experiment import Experiment, MapPair, Summary
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import Kind, Task, Tasks
from edgectl.model.variants import variants
from edgectl.model.weights import parse_weights
from edgectl.units import parse_duration, parse_share

Entries = tuple[tuple[Any, Node], ...]

SHORTEST_S, MOST_REPETITIONS = 0.5, 1000
# As for ``edgectl simulate`` without options.
POLICIES = (PolicyName.LOCAL, PolicyName.STATIC, PolicyName.UTILITY)
WEIGHTS = ("cpu", "memory", "network", "all")
_METRIC = re.compile(r"[A-Za-z_][A-Za-z0-9_.:/-]{0,62}")
_COLUMN = re.compile(r"[A-Za-z][A-Za-z0-9 ._-]{0,62}")


def _weights(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    """A preset, or a set such as ``cpu=.5,task=1``; given back as it is written."""
    value = text(node, problems)
    if value is INVALID:
        return INVALID
    try:
        parse_weights(value)
    except ValueError as error:
        message, _, hint = str(error).partition("; ")
        problems.add(node.mark, Code.WORD, message, hint)
        return INVALID
    return value.strip()


def _every(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    value = amount(parse_duration, above_zero=True)(node, problems)
    if value is not INVALID and value < SHORTEST_S:
        problems.add(node.mark, Code.QUANTITY, f"{node.text} is too often", "write 500ms or more")
        return INVALID
    return value


def _idle(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    value = amount(parse_share)(node, problems)
    if value is not INVALID and not 0.0 < value <= 1.0:
        problems.add(node.mark, Code.QUANTITY, f"must be above 0% and at most 100%, not {node.text}", "write 25%")
        return INVALID
    return value


SCHEMES: Mapping[str, Read] = {"policies": items(word(PolicyName)), "weights": items(_weights)}
MAP: Mapping[str, Read] = {"task": name, "file": path_text, "truth": path_text}


def _schemes(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    return read_fields(node, problems, SCHEMES, required=("policies",), what="schemes")


EXPERIMENT: Mapping[str, Read] = {
    "version": version,
    "name": name,
    "inventory": path_text,
    "tasks": path_text,
    "schemes": _schemes,
    "repetitions": integer(1, MOST_REPETITIONS),
    "every": _every,
    "limit": amount(parse_duration, above_zero=True),
    "until": items(name),
    "idle": _idle,
    "metrics": pairs(_METRIC, "a metric", word(Summary)),
    "maps": pairs(_COLUMN, "a column", record(MAP, MapPair, "a map", ("task", "file", "truth"))),
}


def experiment_files(path: Path) -> tuple[Path | None, Path | None]:
    """The inventory and the task files that a spec names, beside itself; None where it names none.

    Raises:
        InputError: everything that is wrong with the file's form.
    """
    fields, problems = _fields(path)
    problems.check()
    named = [fields.values.get(key) if fields else None for key in ("inventory", "tasks")]
    inventory, tasks = (None if word is None else path.parent / word for word in named)
    return inventory, tasks


def load_experiment(path: Path, tasks: Tasks) -> Experiment:
    """The experiment in a file, for this fleet. The ``truth`` of its maps is as written: beside the file.

    Raises:
        InputError: everything that is wrong with it.
    """
    fields, problems = _fields(path)
    experiment = _experiment(fields, path.parent, tasks, problems) if fields else None
    problems.check()
    assert experiment is not None  # noqa: S101 - without a problem there is one
    return experiment


def _fields(path: Path) -> tuple[Fields | None, Problems]:
    problems = Problems()
    source = read_source(path, problems)
    node = parse_yaml(source, problems) if source is not None else None
    required = ("version", "name", "until")
    return (None if node is None else read_fields(node, problems, EXPERIMENT, required=required, what="an experiment")), problems


def _experiment(fields: Fields, beside: Path, tasks: Tasks, problems: Problems) -> Experiment:
    values = fields.values
    if "name" in values and not NAME.fullmatch(values["name"]):
        check_name(values["name"], fields.at("name"), problems, "an experiment")
    _check_maps(fields.at("maps"), values.get("maps", {}), beside, tasks, problems)
    stated = {key: values[key] for key in ("repetitions", "every", "limit", "idle", "metrics", "maps") if key in values}
    return Experiment(
        name=values.get("name", ""),
        variants=_variants(values.get("schemes"), tasks.policy, problems),
        until=tuple(dict.fromkeys(_until(fields, tasks, problems))),
        **stated,
    )


def _variants(schemes: Fields | None, base: Policy, problems: Problems) -> tuple[Variant, ...]:
    if schemes is None:
        return variants(base, POLICIES, WEIGHTS, [])
    policies, weights = (list(_once(schemes.values.get(key, ()), problems)) for key in ("policies", "weights"))
    if schemes.values.get("policies") == ():
        problems.add(schemes.at("policies").mark, Code.MISSING, "there is no scheme to try", "write policies: [local, static, utility]")
    return variants(base, policies, weights, [])


def _until(fields: Fields, tasks: Tasks, problems: Problems) -> Iterator[str]:
    """The tasks whose completion ends a trial: each is there, and can complete. A template stands for all that it makes."""
    entries: Entries = fields.values.get("until", ())
    if fields.values.get("until") == ():
        problems.add(fields.at("until").mark, Code.MISSING, "nothing ends a trial", "name a task that completes")
    for wanted in _once(entries, problems):
        node = next(inner for each, inner in entries if each == wanted)
        named = [task for task in tasks.tasks.values() if wanted in (task.name, task.template)]
        if not named:
            _known(node, wanted, tasks, problems)
        elif not all(map(_completes, named)):
            message = f"{wanted} never completes, so no trial would end"
            problems.add(node.mark, Code.CONTRADICTION, message, "name a task with kind: job or done_when, or give it one of them")
        yield from (task.name for task in named)


def _completes(task: Task) -> bool:
    return task.managed and (task.kind is Kind.JOB or task.done_when is not None)


def _check_maps(node: Node, maps: Mapping[str, MapPair], beside: Path, tasks: Tasks, problems: Problems) -> None:
    """Every map is of a task that is there, and has its truth."""
    for column, pair in maps.items():
        at = node.inner(column)
        _known(at.inner("task"), pair.task, tasks, problems)
        if not (beside / pair.truth).is_file():
            message = f"there is no file {beside / pair.truth}"
            problems.add(at.inner("truth").mark, Code.UNREADABLE, message, "name a map, as from this file: .yaml, .pgm or .png")


def _known(node: Node, task: str, tasks: Tasks, problems: Problems) -> bool:
    if task not in tasks.tasks:
        problems.add(node.mark, Code.UNKNOWN_NAME, f"no task is named {task}", problems.did_you_mean(task, tasks.tasks, "tasks:"))
    return task in tasks.tasks


def _once(entries: Entries, problems: Problems) -> Iterator[Any]:
    """The values, each once."""
    seen = set()
    for value, node in entries:
        if value in seen:
            problems.add(node.mark, Code.TAKEN, f"{value} stands here twice", "remove it once")
        else:
            seen.add(value)
            yield value
