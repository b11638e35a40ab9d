# SPDX-License-Identifier: Apache-2.0
"""Nodes of a ``.launch.py``, from the record of its child process (``standin/_edgectl_run.py``)."""

import posixpath
from collections.abc import Mapping, Sequence
from typing import Any

from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.importers.fault import collect_fault
from edgectl.importers.launch_values import Launch, RosNode, Workspace, expand_packages, join_names
from edgectl.importers.ros2_launch import Ros2Scope, read_included_launch
from edgectl.names import format_name_list, suggest_name

Record = Mapping[str, Any]


def add_python_launch(
    record: Record,
    path: str,
    arguments: Mapping[str, str],
    workspace: Workspace,
    packages: Mapping[str, str],
    launch: Launch,
) -> None:
    """Add what the child process noted of the file ``path``; problems are collected.

    ``packages``: directories of packages that it was told; they are other ones on the hosts.
    """
    marks = _Marks(workspace)
    if "fault" in record:
        fault = record["fault"]
        launch.problems.add(
            marks.find(fault["file"], fault["line"]), ProblemCode.PYTHON, fault["message"], fault["hint"]
        )
        return
    launch.note(
        marks.find(path, 1, shown=False),
        "this file is a program: it was run here, in a child process, to see what it starts",
    )
    for name in sorted(arguments.keys() - set(record["declared"])):
        match = suggest_name(name, record["declared"])
        known = (
            f"its arguments are {format_name_list(record['declared'])}"
            if record["declared"]
            else "it has none"
        )
        launch.problems.add(
            marks.find(path, 1), ProblemCode.UNKNOWN_NAME, f"the file declares no argument {name}",
            f"did you mean {match}?" if match else known)  # fmt: skip
    for note in record["notes"]:
        launch.note(marks.find(note["file"], note["line"], shown=False), note["message"], note["hint"])
    orders: dict[int, list[int]] = {}
    for number, process in enumerate(record["processes"]):
        before = len(launch.nodes)
        mark = marks.find(*process["place"])
        with collect_fault(launch.problems):
            _add_process(process, mark, packages, workspace, launch)
        orders[number] = [node.order for node in launch.nodes[before:]]
        for node in launch.nodes[before:]:
            node.needs = tuple(
                (order, state) for needed, state in process["needs"] for order in orders.get(needed, [])
            )


class _Marks:
    """Positions in Python files, whose lines are shown."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.sources: dict[str, Source] = {}

    def find(self, file: str, line: int, *, shown: bool = True) -> Mark:
        if shown and file not in self.sources:
            source = self.workspace.read(file, Problems()) if file else None
            self.sources[file] = source or Source(file=file, text="", lines=())
        source = self.sources.get(file) or Source(file=file, text="", lines=())
        text = source.line(line)
        column = len(text) - len(text.lstrip()) + 1
        return Mark(source, line, column, max(1, len(text.strip())))


def _add_process(
    process: Record, mark: Mark, packages: Mapping[str, str], workspace: Workspace, launch: Launch
) -> None:
    if process["kind"] == "include":
        _add_include(process, mark, workspace, launch)
        return
    values = _mark_packages(process, packages)
    words: Sequence[str] = values.get("words", ())
    if not words and not values.get("package"):
        launch.problems.add(mark, ProblemCode.MISSING, "the command is empty", "write cmd=[..]")
        return
    launch.add_node(
        RosNode(
            version=2,
            mark=mark,
            package=values.get("package", ""),
            executable=values.get("executable") or words[0],
            name=values["name"] or (posixpath.basename(words[0]) if words else ""),
            namespace=values["namespace"],
            arguments=tuple(values.get("arguments", words[1:])),
            ros_arguments=tuple(values.get("ros_arguments", ())),
            remaps=tuple((source, target) for source, target in values.get("remaps", ())),
            parameters=dict(values.get("parameters", {})),
            parameter_files=tuple((file, "") for file in values.get("parameter_files", ())),
            env=dict(values["env"]),
            respawn=values["respawn"],
            prefix=values["prefix"],
            workdir=values["workdir"],
        )
    )


def _mark_packages(value: Any, packages: Mapping[str, str]) -> Any:  # noqa: ANN401 - any JSON
    """``value`` with the directories of packages replaced by marks: on the hosts they are other ones."""
    if isinstance(value, str):
        for name in sorted(packages, key=lambda each: -len(packages[each])):
            directory = packages[name]
            if value == directory or value.startswith(f"{directory}/"):
                return f"\ue000share:{name}\ue001{value[len(directory) :]}"
        return value
    if isinstance(value, Mapping):
        return {key: _mark_packages(each, packages) for key, each in value.items()}
    return [_mark_packages(each, packages) for each in value] if isinstance(value, list) else value


def _add_include(process: Record, mark: Mark, workspace: Workspace, launch: Launch) -> None:
    """Read a launch file in XML or YAML that the program includes."""
    path = posixpath.normpath(expand_packages(process["file"], workspace, mark))
    scope = Ros2Scope(
        file=path,
        arguments=dict(process["arguments"]),
        namespace=join_names("/", process["namespace"]),
        env=dict(process["env"]),
        remaps=tuple((source, target) for source, target in process["remaps"]),
        parameters=dict(process["parameters"]),
    )
    read_included_launch(scope, mark, workspace, launch)
