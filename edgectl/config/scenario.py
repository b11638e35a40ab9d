"""Scenario files of ``edgectl simulate``: computers, a mission and timing, for an inventory and its tasks."""

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from edgectl.config.fields import Fields, as_node, bare, items, pairs, read_fields, record
from edgectl.config.node import Node
from edgectl.config.problems import Code, Problems
from edgectl.config.scalars import Read, amount, name, path_text, text, version, wrong_type
from edgectl.config.source import read_source
from edgectl.config.yaml12 import parse_yaml
from edgectl.model.inventory import Inventory, Role
from edgectl.model.scenario import Job, Scenario, SimHost, Timing
from edgectl.model.task import Tasks
from edgectl.units import parse_bytes, parse_cores, parse_duration, parse_share

_WORD = re.compile(r"[a-z0-9][a-z0-9._-]{0,62}")
_PUBLISHED = re.compile(r"[A-Za-z][A-Za-z0-9 ._-]{0,62}")
_SECONDS = amount(parse_duration)


def _number(raw: object) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise ValueError("must be a number; write 3.5")
    return float(raw)


_NUMBER = amount(_number)
HOST: Mapping[str, Read] = {
    "cores": amount(parse_cores, above_zero=True),
    "memory": amount(parse_bytes, above_zero=True),
    "base_cores": amount(parse_cores),
    "base_memory": amount(parse_bytes),
}
JOB: Mapping[str, Read] = {
    "for_each": text, "task": name, "work": amount(parse_duration, above_zero=True), "after": items(name), "spread": amount(parse_share),
}  # fmt: skip
TIMING: Mapping[str, Read] = {
    "start": _SECONDS, "stop": _SECONDS, "every": amount(parse_duration, above_zero=True), "noise": amount(parse_share),
    "limit": amount(parse_duration, above_zero=True),
}  # fmt: skip
SCENARIO: Mapping[str, Read] = {
    "version": version,
    "name": name,
    "inventory": path_text,
    "tasks": path_text,
    "assumptions": bare(text),
    "hosts": as_node,
    "jobs": as_node,
    "placed": pairs(_WORD, "a task", name),
    "rate": pairs(_WORD, "a task", _NUMBER),
    "timing": record(TIMING, Timing, "timing"),
    "published": pairs(_PUBLISHED, "a scheme", pairs(_PUBLISHED, "a metric", bare(_NUMBER))),
}


def scenario_files(path: Path) -> tuple[Path | None, Path | None]:
    """The inventory and the task files that a scenario names, beside itself; None where it names none.

    Raises:
        InputError: everything that is wrong with the file's form.
    """
    fields, problems = _fields(path)
    problems.check()
    named = (fields.values.get(key) for key in ("inventory", "tasks")) if fields else ()
    inventory, tasks = (None if word is None else path.parent / word for word in (*named, None, None)[:2])
    return inventory, tasks


def load_scenario(path: Path, inventory: Inventory, tasks: Tasks) -> Scenario:
    """The scenario in a file, for this fleet.

    Raises:
        InputError: everything that is wrong with it.
    """
    fields, problems = _fields(path)
    scenario = _scenario(fields, inventory, tasks, problems) if fields else None
    problems.check()
    assert scenario is not None  # noqa: S101 - without a problem there is one
    return scenario


def _fields(path: Path) -> tuple[Fields | None, Problems]:
    problems = Problems()
    source = read_source(path, problems, maker="")
    node = parse_yaml(source, problems) if source is not None else None
    required = ("version", "name", "hosts", "jobs")
    return (None if node is None else read_fields(node, problems, SCENARIO, required=required, what="a scenario")), problems


def _scenario(fields: Fields, inventory: Inventory, tasks: Tasks, problems: Problems) -> Scenario:
    values = fields.values
    for key in ("placed", "rate"):
        for task in values.get(key, {}):
            _check_known(fields.at(key), task, tasks.tasks, "task", problems)
    for task, host in values.get("placed", {}).items():
        _check_known(fields.at("placed").inner(task), host, inventory.hosts, "host", problems)
    return Scenario(
        name=values.get("name", ""),
        assumptions=values.get("assumptions", ()),
        hosts=_hosts(fields.at("hosts"), inventory, problems) if "hosts" in fields else {},
        jobs=tuple(_jobs(fields.at("jobs"), inventory, tasks, problems)) if "jobs" in fields else (),
        timing=values.get("timing", Timing()),
        placed=values.get("placed", {}),
        rate=values.get("rate", {}),
        published=values.get("published", {}),
    )


def _check_known(node: Node, word: str, known: Iterable[str], what: str, problems: Problems) -> bool:
    if word in known:
        return True
    problems.add(node.key_mark(word), Code.UNKNOWN_NAME, f"unknown {what} {word}", problems.did_you_mean(word, known, f"{what}s:"))
    return False


def _hosts(node: Node, inventory: Inventory, problems: Problems) -> dict[str, SimHost]:
    """Every host of the inventory: by its own name, else as ``edges`` or ``robots`` say."""
    if not isinstance(node.value, dict):
        wrong_type(node, problems, "hosts must be a mapping", "write edges: {cores: 4, memory: 4Gi}")
        return {}
    read = record(HOST, SimHost, "a computer", ("cores", "memory"))
    for key in node.value:
        _check_known(node, key, (*inventory.hosts, "edges", "robots"), "host", problems)
    stated = {key: read(inner, problems) for key, inner in node.value.items()}
    found = {}
    for host in inventory.hosts.values():
        value = stated.get(host.name, stated.get("edges" if host.role is Role.EDGE else "robots"))
        if value is None:
            problems.add(node.mark, Code.MISSING, f"nothing is said of {host.name}", "add edges: or robots: for all of a kind")
        elif isinstance(value, SimHost):
            found[host.name] = value
    return found


def _jobs(node: Node, inventory: Inventory, tasks: Tasks, problems: Problems) -> Iterator[Job]:
    """The jobs; those with ``for_each: robot`` once per robot, named JOB-ROBOT, with ``{robot}`` as it were in the task's name."""
    if not isinstance(node.value, dict):
        wrong_type(node, problems, "jobs must be a mapping", "write map: {task: slam, work: 5m}")
        return
    read = {key: read_fields(inner, problems, JOB, required=("task", "work"), what="a job") for key, inner in node.value.items()}
    if problems.errors:
        return
    robots = [robot.name for robot in inventory.robots]
    names = {key: [f"{key}-{robot}" for robot in robots] if "for_each" in fields else [key] for key, fields in read.items()}
    _check_order(node, read, problems)
    for key, fields in read.items():
        for index, job in enumerate(names[key]):
            task = f"{fields.values['task']}-{robots[index]}" if "for_each" in fields else fields.values["task"]
            if not _check_known(fields.at("task"), task, tasks.tasks, "task", problems):
                continue
            before = [
                _before(names[other], index, both="for_each" in fields and "for_each" in read[other])
                for other in _after(fields)
                if other in read
            ]
            yield Job(
                name=job, task=task, work=fields.values["work"], after=tuple(word for words in before for word in words),
                spread=fields.values.get("spread", 0.0),
            )  # fmt: skip


def _before(names: list[str], index: int, *, both: bool) -> list[str]:
    """The same robot's where both are for each robot, else all of them."""
    return [names[index]] if both else names


def _after(fields: Fields) -> list[str]:
    return [word for word, _ in fields.values.get("after", ())]


def _check_order(node: Node, read: Mapping[str, Fields], problems: Problems) -> None:
    """Every job that is waited for is there, and none waits for itself."""
    for fields in read.values():
        for word, inner in fields.values.get("after", ()):
            if word not in read:
                problems.add(inner.mark, Code.UNKNOWN_NAME, f"no job is named {word}", problems.did_you_mean(word, read, "jobs:"))
    left: dict[str, Any] = {key: set(_after(fields)) & set(read) for key, fields in read.items()}
    while ready := [key for key, before in left.items() if not before & set(left)]:
        for key in ready:
            del left[key]
    if left:
        first = next(iter(left))
        problems.add(node.key_mark(first), Code.CYCLE, f"{first} waits for itself, through {', '.join(left)}", "remove one of their after")
