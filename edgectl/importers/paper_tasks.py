# SPDX-License-Identifier: Apache-2.0
"""Requirement file of the paper's authors (``task_req.yaml``) as a task file.

Its keys: ``task_seq`` (order), ``task_req`` (CPU, memory and throughput in percent), ``task_req_seq``
(predecessors), ``weights`` (variants), ``commands``.
"""

import re
from collections.abc import Mapping, Sequence

from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.importers.launch_values import Launch
from edgectl.importers.ros_tasks import ImportedFiles, to_host_name
from edgectl.importers.yaml_text import FileEntry, FileText
from edgectl.names import suggest_name

_KEYS = ("task_seq", "task_req", "task_req_seq", "weights", "commands")
_RESOURCES = ("cpu", "memory", "throughput")
_ROBOT = re.compile(r"([Rr][0-9]+)_")
_BACKGROUND = re.compile(r"(?:\s*(?:[12]?>>?|&>)\s*\S+)*\s*&\s*$")
# Variants that have the same name as a word of edgectl, with its weights.
_PRESETS = {
    "cpu": (1.0, 0.0, 0.0, 0.0),
    "memory": (0.0, 1.0, 0.0, 0.0),
    "network": (0.0, 0.0, 1.0, 0.0),
    "nodes": (0.0, 0.0, 0.0, 1.0),
    "all": (0.25, 0.25, 0.25, 0.25),
}


def build_paper_files(root: Node, title: str, fleet: str, problems: Problems, notes: Launch) -> ImportedFiles:
    """The task file and an inventory with the robots that its names state; problems are collected."""
    sections = _read_sections(root, problems)
    demands, commands = sections["task_req"], sections["commands"]
    order = _read_order(root, demands, problems)
    robots = list(dict.fromkeys(robot for name in demands if (robot := find_robot(name))))
    entries = []
    for name, node in demands.items():
        values: dict[str, object] = {
            "command": _read_command(name, commands.get(name), root, notes),
            "demand": _read_demand(name, node, problems),
        }
        needs = _read_needs(name, sections["task_req_seq"].get(name), demands, problems, notes)
        values |= _choose_robots(name, needs)
        if str(values["command"]).startswith("roslaunch "):
            values["stop"] = "ros"
        if name in order:
            values["priority"] = len(order) - order.index(name)
        else:
            notes.note(root.inner("task_req").key_mark(name), f"{name} is not in task_seq: it has priority 0")
        if needs:
            values["needs"] = [to_host_name(need) for need in needs]
        entries.append(FileEntry(name=to_host_name(name), values=values, comments=(name,)))
    _note_weights(sections["weights"], problems, notes)
    about = f"Imported from {title}."
    tasks = FileText(comments=(about,), keys={"version": 1, "weights": "all"}, sections={"tasks": entries})
    return ImportedFiles(inventory=_build_inventory(robots, about, fleet), tasks=tasks)


def find_robot(name: str) -> str:
    """The robot that the name of a task states, as in ``R1_SLAM``; empty if none."""
    found = _ROBOT.match(name)
    return found[1].lower() if found else ""


def _read_sections(root: Node, problems: Problems) -> dict[str, Mapping[str, Node]]:
    """The mappings of the file; those that are missing or of another type are empty."""
    found: dict[str, Mapping[str, Node]] = {key: {} for key in _KEYS}
    if not isinstance(root.value, dict) or "task_req" not in root.value:
        problems.add(
            root.mark, ProblemCode.MISSING, "the file has no task_req", "name a file of the paper's authors"
        )
        return found
    for key, node in root.value.items():
        if key not in _KEYS:
            match = suggest_name(key, _KEYS)
            hint = f"did you mean {match}?" if match else f"known are {', '.join(_KEYS)}"
            problems.add(root.key_mark(key), ProblemCode.UNKNOWN_KEY, f"unknown key {key}", hint)
        elif key != "task_seq" and not isinstance(node.value, dict):
            problems.add(
                node.mark,
                ProblemCode.TYPE,
                f"{key} must be a mapping of tasks",
                f"write {key}: {{R1_SLAM: ..}}",
            )
        elif isinstance(node.value, dict):
            found[key] = node.value
    return found


def _read_order(root: Node, demands: Mapping[str, Node], problems: Problems) -> list[str]:
    node = root.value.get("task_seq") if isinstance(root.value, dict) else None
    if node is None:
        return []
    if not isinstance(node.value, list):
        problems.add(
            node.mark, ProblemCode.TYPE, "task_seq must be a list of tasks", "write task_seq: [R1_SLAM]"
        )
        return []
    order = []
    for each in node.value:
        if each.text not in demands:
            _add_unknown_task(each, demands, problems)
        order.append(each.text)
    return order


def _add_unknown_task(node: Node, demands: Mapping[str, Node], problems: Problems) -> None:
    hint = problems.did_you_mean(node.text, demands)
    problems.add(node.mark, ProblemCode.UNKNOWN_NAME, f"{node.text or 'this'} has no entry in task_req", hint)


def _read_command(name: str, node: Node | None, root: Node, notes: Launch) -> str:
    """The command without nohup and the background, in which edgectl's supervisor could not see it."""
    if node is None or not isinstance(node.value, str) or not node.value.strip():
        mark = node.mark if node is not None else root.inner("task_req").key_mark(name)
        notes.note(mark, f"{name} has no command", "write command: in the task file")
        return f"echo 'write the command of {to_host_name(name)}' >&2; false"
    return _BACKGROUND.sub("", node.value.strip().removeprefix("nohup ")).strip()


def _read_demand(name: str, node: Node, problems: Problems) -> dict[str, object]:
    numbers = node.value if isinstance(node.value, list) else []
    good = [
        each.value
        for each in numbers
        if isinstance(each.value, int | float) and not isinstance(each.value, bool)
    ]
    if len(good) != len(_RESOURCES) or len(numbers) != len(_RESOURCES):
        message = f"the demand of {name} must be three numbers: CPU, memory and throughput in percent"
        problems.add(node.mark, ProblemCode.TYPE, message, "write [35.2, 2.5, 2.53]")
        return {}
    for each, value in zip(numbers, good, strict=True):
        if not 0 <= value <= 100:
            problems.add(
                each.mark,
                ProblemCode.QUANTITY,
                f"{each.text} % is not between 0 and 100",
                "correct the share",
            )
    return {key: f"{value:g}%" for key, value in zip(_RESOURCES, good, strict=True)}


def _read_needs(
    name: str, node: Node | None, demands: Mapping[str, Node], problems: Problems, notes: Launch
) -> list[str]:
    if node is None:
        return []
    if not isinstance(node.value, list):
        problems.add(
            node.mark, ProblemCode.TYPE, f"the predecessors of {name} must be a list", "write [R1_SLAM]"
        )
        return []
    needs = []
    for each in node.value:
        if each.text == name:  # the code of the paper lists a task among its own predecessors
            continue
        if each.text not in demands:
            _add_unknown_task(each, demands, problems)
            continue
        own, other = find_robot(name), find_robot(each.text)
        if own and other and own != other:
            notes.note(
                each.mark,
                f"{name} needs {each.text}, a task of another robot",
                "correct the needs of the task if that is a mistake",
            )
        needs.append(each.text)
    return list(dict.fromkeys(needs))


def _choose_robots(name: str, needs: Sequence[str]) -> dict[str, object]:
    """The robot in the task's name, else those of its predecessors."""
    if robot := find_robot(name):
        return {"robot": robot}
    robots = list(dict.fromkeys(robot for need in needs if (robot := find_robot(need))))
    return {"robots": robots} if robots else {}


def _note_weights(variants: Mapping[str, Node], problems: Problems, notes: Launch) -> None:
    for name, node in variants.items():
        numbers = node.value if isinstance(node.value, list) else []
        values = [float(each.value) for each in numbers if isinstance(each.value, int | float)]
        if len(values) != 4 or sum(values) <= 0 or min(values) < 0:
            message = f"the weights {name} must be four numbers: CPU, memory, network, nodes"
            problems.add(node.mark, ProblemCode.TYPE, message, "write [0.25, 0.25, 0.25, 0.25]")
            continue
        share = tuple(value / sum(values) for value in values)
        preset = _PRESETS.get(name.lower())
        if preset is None or any(abs(a - b) > 1e-6 for a, b in zip(share, preset, strict=True)):
            text = ", ".join(
                f"{key}: {value:.3g}"
                for key, value in zip(("cpu", "memory", "network", "task"), share, strict=True)
            )
            notes.note(node.mark, f"the weights {name} are not imported", f"write weights: {{{text}}}")


def _build_inventory(robots: Sequence[str], about: str, fleet: str) -> FileText:
    edges = [
        FileEntry(
            name="edge1",
            values={"connection": "local"},
            comments=("This machine. Write the edges of the lab instead.",),
        )
    ]
    entries = [
        FileEntry(
            name=robot,
            values={"host": robot, "probe": False},
            comments=("Write its address; remove probe: false if it has SSH.",),
        )
        for robot in robots
    ]
    return FileText(
        comments=(about,), keys={"version": 1, "fleet": fleet}, sections={"edges": edges, "robots": entries}
    )
