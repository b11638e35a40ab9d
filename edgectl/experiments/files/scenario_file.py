# SPDX-License-Identifier: Apache-2.0
"""Reader of scenario files (``edgectl simulate``)."""

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from edgectl.agent.link import protocol
from edgectl.config.fields import (
    Fields,
    keep_node,
    list_reader,
    list_reader_with_nodes,
    mapping_reader,
    read_fields,
    record_reader,
)
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import (
    NodeReader,
    enum_reader,
    integer_reader,
    quantity_reader,
    read_bool,
    read_name,
    read_safe_argument,
    read_text,
    read_version,
    report_wrong_type,
)
from edgectl.config.schema import Schema, build_file_schema, build_object_schema
from edgectl.config.source import read_source
from edgectl.config.yaml_parser import parse_yaml
from edgectl.experiments.files.cycle_reader import build_cycles_schema, parse_number, read_cycles
from edgectl.experiments.files.event_keys import SCENARIO_EVENT_KEYS, build_events_schema
from edgectl.experiments.files.event_readers import read_scenario_events
from edgectl.experiments.files.fleet_files import check_name_exists, resolve_fleet_files
from edgectl.experiments.model.scenario import Radio, Scenario, SimCycle, SimHost, SimJob, SimLink, SimTiming
from edgectl.model.inventory import Inventory, Role
from edgectl.model.task import Tasks
from edgectl.units import parse_bytes, parse_cores, parse_duration, parse_rate, parse_share

_TASK_NAME_PATTERN = re.compile(protocol.NAME_PATTERN)
_PUBLISHED_NAME_PATTERN = re.compile(r"[A-Za-z][A-Za-z0-9 ._-]{0,62}")
_read_duration_s = quantity_reader(parse_duration)


_read_number = quantity_reader(parse_number)
SIM_HOST_KEYS: Mapping[str, NodeReader] = {
    "cores": quantity_reader(parse_cores, above_zero=True),
    "memory": quantity_reader(parse_bytes, above_zero=True),
    "base_cores": quantity_reader(parse_cores),
    "base_memory": quantity_reader(parse_bytes),
    "period": _read_duration_s,
}
JOB_KEYS: Mapping[str, NodeReader] = {
    "for_each": read_text,
    "task": read_name,
    "work": quantity_reader(parse_duration, above_zero=True),
    "after": list_reader_with_nodes(read_name),
    "spread": quantity_reader(parse_share),
    "senses": list_reader_with_nodes(read_name),
    "fresh": quantity_reader(parse_duration, above_zero=True),
}
TIMING_KEYS: Mapping[str, NodeReader] = {
    "start": _read_duration_s,
    "stop": _read_duration_s,
    "every": quantity_reader(parse_duration, above_zero=True),
    "noise": quantity_reader(parse_share),
    "bursts": quantity_reader(parse_share),
    "limit": quantity_reader(parse_duration, above_zero=True),
    "probe": _read_duration_s,
    "plan": _read_duration_s,
    "prepare": _read_duration_s,
    "apply": _read_duration_s,
    "paced": read_bool,
    "by_reading": read_bool,
}
LINK_KEYS: Mapping[str, NodeReader] = {
    "edge": read_name,
    "robot": read_name,
    "throughput": quantity_reader(parse_rate),
    "after": list_reader(read_name),
}
SCENARIO_KEYS: Mapping[str, NodeReader] = {
    "version": read_version,
    "name": read_name,
    "inventory": read_safe_argument,
    "tasks": read_safe_argument,
    "assumptions": list_reader(read_text),
    "hosts": keep_node,
    "jobs": keep_node,
    "placed": mapping_reader(_TASK_NAME_PATTERN, "a task", read_name),
    "rate": mapping_reader(_TASK_NAME_PATTERN, "a task", _read_number),
    "timing": record_reader(TIMING_KEYS, SimTiming, "timing"),
    "links": list_reader_with_nodes(
        record_reader(LINK_KEYS, SimLink, "a link", ("edge", "robot", "throughput"))
    ),
    "live_links": read_bool,
    "events": keep_node,
    "radio": enum_reader(Radio),
    "cycles": keep_node,
    "published": mapping_reader(
        _PUBLISHED_NAME_PATTERN,
        "a scheme",
        mapping_reader(_PUBLISHED_NAME_PATTERN, "a metric", list_reader(_read_number)),
    ),
    "published_std": mapping_reader(_PUBLISHED_NAME_PATTERN, "a scheme", _read_number),
    "published_runs": integer_reader(1, 1000),
}


_REQUIRED_KEYS = ("version", "name", "hosts", "jobs")


def build_scenario_schema() -> Schema:
    """JSON Schema of a scenario file."""
    host = build_object_schema(SIM_HOST_KEYS, ("cores", "memory"))
    job = build_object_schema(JOB_KEYS, ("task", "work"))
    schema = build_object_schema(
        SCENARIO_KEYS,
        _REQUIRED_KEYS,
        hosts={"type": "object", "additionalProperties": host},
        jobs={"type": "object", "additionalProperties": job},
        cycles=build_cycles_schema(),
        events=build_events_schema(SCENARIO_EVENT_KEYS),
    )
    return build_file_schema("scenario", schema)


def load_scenario_paths(path: Path) -> tuple[Path | None, Path | None]:
    """Paths of the inventory and the task file named in the scenario, relative to it; None if not named.

    Raises:
        InputError: all faults of the file's structure.
    """
    return resolve_fleet_files(path, *_read_scenario_fields(path))


def load_scenario(path: Path, inventory: Inventory, tasks: Tasks) -> Scenario:
    """The scenario in a file, for a fleet.

    Raises:
        InputError: all faults of the file.
    """
    fields, problems = _read_scenario_fields(path)
    scenario = _build_scenario(fields, inventory, tasks, problems) if fields else None
    problems.check()
    assert scenario is not None  # noqa: S101 - no problems: it was read
    return scenario


def _read_scenario_fields(path: Path) -> tuple[Fields | None, Problems]:
    problems = Problems()
    source = read_source(path, problems, maker="")
    node = parse_yaml(source, problems) if source is not None else None
    return (
        None
        if node is None
        else read_fields(node, problems, SCENARIO_KEYS, required=_REQUIRED_KEYS, what="a scenario")
    ), problems


def _build_scenario(fields: Fields, inventory: Inventory, tasks: Tasks, problems: Problems) -> Scenario:
    values = fields.values
    for key in ("placed", "rate"):
        for task in values.get(key, {}):
            check_name_exists(fields.at(key), task, tasks.tasks, "task", problems)
    for task, host in values.get("placed", {}).items():
        check_name_exists(fields.at("placed").inner(task), host, inventory.hosts, "host", problems)
    cycles = read_cycles(fields.at("cycles"), inventory, tasks, problems) if "cycles" in fields else {}
    jobs = (
        tuple(_read_jobs(fields.at("jobs"), inventory, tasks, cycles, problems)) if "jobs" in fields else ()
    )
    return Scenario(
        name=values.get("name", ""),
        assumptions=values.get("assumptions", ()),
        hosts=_read_sim_hosts(fields.at("hosts"), inventory, problems) if "hosts" in fields else {},
        jobs=jobs,
        timing=values.get("timing", SimTiming()),
        placed=values.get("placed", {}),
        rate=values.get("rate", {}),
        published=values.get("published", {}),
        published_std=values.get("published_std", {}),
        published_runs=values.get("published_runs", 1),
        links=tuple(_check_links(values.get("links", ()), inventory, jobs, problems)),
        live_links=values.get("live_links", True),
        radio=values.get("radio", Radio.SEPARATE),
        events=read_scenario_events(fields.at("events"), inventory, tasks, jobs, problems)
        if "events" in fields
        else (),
        cycles=cycles,
    )


def _check_links(
    links: Iterable[tuple[SimLink, Node]], inventory: Inventory, jobs: Iterable[SimJob], problems: Problems
) -> Iterator[SimLink]:
    """The links of which edge, robot and jobs exist."""
    names = [job.name for job in jobs]
    for link, node in links:
        known = [
            check_name_exists(node, link.edge, [host.name for host in inventory.edges], "edge", problems),
            check_name_exists(node, link.robot, [host.name for host in inventory.robots], "robot", problems),
            *(check_name_exists(node, job, names, "job", problems) for job in link.after),
        ]
        if all(known):
            yield link


def _read_sim_hosts(node: Node, inventory: Inventory, problems: Problems) -> dict[str, SimHost]:
    """The simulated hosts: under their own name, or else under ``edges`` or ``robots``."""
    if not isinstance(node.value, dict):
        report_wrong_type(node, problems, "hosts must be a mapping", "write edges: {cores: 4, memory: 4Gi}")
        return {}
    read = record_reader(SIM_HOST_KEYS, SimHost, "a computer", ("cores", "memory"))
    for key in node.value:
        check_name_exists(node, key, (*inventory.hosts, "edges", "robots"), "host", problems)
    given = {key: read(inner, problems) for key, inner in node.value.items()}
    found = {}
    for host in inventory.hosts.values():
        value = given.get(host.name, given.get("edges" if host.role is Role.EDGE else "robots"))
        if value is None:
            problems.add(
                node.mark,
                ProblemCode.MISSING,
                f"no values for {host.name}",
                "add its name, or edges: or robots: for all hosts of a kind",
            )
        elif isinstance(value, SimHost):
            found[host.name] = value
    return found


def _read_jobs(
    node: Node, inventory: Inventory, tasks: Tasks, cycles: Mapping[str, SimCycle], problems: Problems
) -> Iterator[SimJob]:
    """The jobs.

    One with ``for_each: robot`` is repeated for each robot as JOB-ROBOT, with the task TASK-ROBOT.
    """
    if not isinstance(node.value, dict):
        report_wrong_type(node, problems, "jobs must be a mapping", "write map: {task: slam, work: 5m}")
        return
    read = {
        key: read_fields(inner, problems, JOB_KEYS, required=("task", "work"), what="a job")
        for key, inner in node.value.items()
    }
    if problems.errors:
        return
    robots = [robot.name for robot in inventory.robots]
    names = {
        key: [f"{key}-{robot}" for robot in robots] if "for_each" in fields else [key]
        for key, fields in read.items()
    }
    _check_order(node, read, problems)
    for key, fields in read.items():
        for index, job in enumerate(names[key]):
            ending = f"-{robots[index]}" if "for_each" in fields else ""
            task = fields.values["task"] + ending
            if not check_name_exists(fields.at("task"), task, tasks.tasks, "task", problems):
                continue
            before = [
                _select_predecessors(
                    names[other], index, both="for_each" in fields and "for_each" in read[other]
                )
                for other in _list_predecessor_keys(fields)
                if other in read
            ]
            yield SimJob(
                name=job,
                task=task,
                work=fields.values["work"],
                after=tuple(name for jobs in before for name in jobs),
                spread=fields.values.get("spread", 0.0),
                senses=tuple(_read_senses(fields, ending, cycles, problems)),
                fresh=fields.values.get("fresh", 0.5),
            )


def _read_senses(
    fields: Fields, ending: str, cycles: Mapping[str, SimCycle], problems: Problems
) -> Iterator[str]:
    """The tasks, of the same robot, of which the job needs results: each has cycles."""
    for word, node in fields.values.get("senses", ()):
        if check_name_exists(node, f"{word}{ending}", cycles, "task with cycles", problems):
            yield f"{word}{ending}"


def _select_predecessors(names: list[str], index: int, *, both: bool) -> list[str]:
    """The job of the same robot if both are repeated for each robot, otherwise all."""
    return [names[index]] if both else names


def _list_predecessor_keys(fields: Fields) -> list[str]:
    return [word for word, _ in fields.values.get("after", ())]


def _check_order(node: Node, read: Mapping[str, Fields], problems: Problems) -> None:
    """All predecessors exist, and there is no cycle."""
    for fields in read.values():
        for word, inner in fields.values.get("after", ()):
            if word not in read:
                problems.add(
                    inner.mark,
                    ProblemCode.UNKNOWN_NAME,
                    f"unknown job {word}",
                    problems.did_you_mean(word, read, "jobs:"),
                )
    left: dict[str, Any] = {
        key: set(_list_predecessor_keys(fields)) & set(read) for key, fields in read.items()
    }
    while ready := [key for key, before in left.items() if not before & set(left)]:
        for key in ready:
            del left[key]
    if left:
        first = next(iter(left))
        problems.add(
            node.key_mark(first),
            ProblemCode.CYCLE,
            f"cycle of jobs: {', '.join(left)}",
            "remove an after: of one of them",
        )
