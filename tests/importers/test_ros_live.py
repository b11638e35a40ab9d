# SPDX-License-Identifier: Apache-2.0
"""Running graphs become task files that edgectl accepts; whatever is not known is said."""

import re
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.importers.ros_live import build_live_tasks
from edgectl.importers.yaml_text import render_file
from edgectl.model.ros import GraphNode, RosGraph
from edgectl.model.task import DetectRule, Need, Task, Tasks
from tests.builders import a_task

INVENTORY = """
version: 1
fleet: lab
defaults: {connection: local, ros: {version: 1, master: "http://127.0.0.1:11311"}}
edges: {edge1: {}, edge2: {}}
robots: {robot1: {host: 127.0.0.1}}
"""


def a_node(name: str, *, pid: int = 7, here: bool = True, **fields: object) -> GraphNode:
    defaults = {"words": ("/usr/bin/python3", f"/opt/{name.rpartition('/')[2]}.py")} if pid else {}
    return GraphNode(name=name, pid=pid, here=here, **{**defaults, **fields})  # type: ignore[arg-type]


def import_nodes(
    *nodes: GraphNode, known: tuple[Task, ...] = (), folder: Path | None = None, left_out: int = 0
) -> tuple[Tasks, list[str], str]:
    """The tasks as edgectl loads them, the notes, and the text."""
    graphs = {"edge1": RosGraph(nodes=nodes, left_out=left_out)}
    file, notes = build_live_tasks(graphs, "lab", ["robot1"], {task.name: task for task in known})
    text = render_file(file)
    said = [note.message for note in notes]
    if folder is None or not file.sections["tasks"]:
        return Tasks(tasks={}), said, text
    (folder / "fleet.yaml").write_text(INVENTORY)
    (folder / "tasks.yaml").write_text(text)
    _, tasks, warnings = load_inventory_and_tasks(folder / "fleet.yaml", [folder / "tasks.yaml"])
    assert not warnings
    return tasks, said, text


def test_a_node_is_found_by_its_name_or_by_its_command_line(tmp_path: Path) -> None:
    tasks, notes, _ = import_nodes(
        a_node("/robot1/slam", pid=1, named=True),
        a_node("/map", pid=2, words=("/usr/bin/python3", "/opt/a b/map (1).py", "--rate=[5]", "{robot}")),
        folder=tmp_path,
    )
    assert notes == []
    slam, found = tasks.tasks["slam"], tasks.tasks["map"]
    assert (slam.managed, slam.robots, slam.detect) == (
        False,
        ("robot1",),
        DetectRule(ros_node="/robot1/slam"),
    )
    assert found.detect == DetectRule(
        cmdline=r"^/usr/bin/python3 /opt/a b/map \(1\)\.py --rate=\[5\] \{robot\}( |$)"
    )


def test_needs_follow_the_topics_and_the_master(tmp_path: Path) -> None:
    tasks, notes, text = import_nodes(
        a_node("", pid=1),
        a_node("/camera", pid=2, publishes=("/image", "/rosout")),
        a_node("/slam", pid=3, subscribes=("/image",), publishes=("/map",)),
        a_node("/log", pid=4, subscribes=("/rosout", "/rosout_agg")),
        folder=tmp_path,
    )
    assert notes == []
    assert tasks.tasks["slam"].needs == (Need(task="camera"), Need(task="roscore"))
    assert tasks.tasks["log"].needs == tasks.tasks["camera"].needs == (Need(task="roscore"),)
    assert "  # publishes /map\n  # subscribes to /image\n  slam:" in text


def test_nodes_that_hear_each_other_do_not_need_each_other(tmp_path: Path) -> None:
    tasks, notes, _ = import_nodes(
        a_node("/a", pid=1, publishes=("/x",), subscribes=("/z",)),
        a_node("/b", pid=2, publishes=("/y",), subscribes=("/x",)),
        a_node("/c", pid=3, publishes=("/z",), subscribes=("/y",)),
        a_node("/d", pid=4, subscribes=("/z",)),
        folder=tmp_path,
    )
    assert notes == ["a, b, c depend on each other: no needs are written between them"]
    assert [tasks.tasks[name].needs for name in "abcd"] == [(), (), (), (Need(task="c"),)]


def test_known_tasks_are_needed_and_not_imported_again() -> None:
    known = (
        a_task("camera"),
        a_task("slam", managed=False, command="", detect=DetectRule(ros_node="/slam")),
        a_task("nav", managed=False, command="", detect=DetectRule(cmdline=r"nav\.py")),
        a_task("brake", needs=(Need(task="stop"),)),
    )
    nodes = (
        a_node("/camera", pid=1, task="lab/edge1/camera", publishes=("/image",)),
        a_node("/slam", pid=2, publishes=("/map",)),
        a_node("/nav", pid=3, words=("/opt/nav.py",)),
        a_node("/brake", pid=4, task="lab/edge1/brake", publishes=("/brakes",)),
        a_node("/view", pid=5, subscribes=("/image", "/map")),
        a_node("/stop", pid=6, subscribes=("/brakes",)),
        a_node("/theirs", pid=7, task="other/edge1/theirs"),
    )
    _, notes, text = import_nodes(*nodes, known=known)
    assert [line.strip() for line in text.splitlines() if line.endswith(":")] == ["tasks:", "stop:", "view:"]
    assert "    needs: [camera, slam]\n" in text
    assert (
        notes
        == [
            "brake, stop depend on each other: no needs are written between them",
            "/theirs is task theirs of the fleet other",
        ][::-1]
    )


def test_several_nodes_of_one_process_are_one_task(tmp_path: Path) -> None:
    tasks, _, text = import_nodes(
        a_node("/container", pid=5, named=True), a_node("/lens", pid=5, publishes=("/x",)), folder=tmp_path
    )
    assert list(tasks.tasks) == ["container"]
    assert "# /container, /lens on edge1\n  # publishes /x" in text


def test_names_tell_namespaces_apart_and_leave_out_what_differs_from_start_to_start(tmp_path: Path) -> None:
    tasks, _, _ = import_nodes(
        a_node("/robot1/slam", pid=1, named=True),
        a_node("/robot2/slam", pid=2, named=True),
        a_node("/slam", pid=3, named=True),
        a_node("/Listener_4711_1700000000000", pid=4, named=True),
        folder=tmp_path,
    )
    assert sorted(tasks.tasks) == ["listener", "robot1-slam", "robot2-slam", "slam"]
    assert tasks.tasks["listener"].detect == DetectRule(
        cmdline=r"^/usr/bin/python3 /opt/Listener_4711_1700000000000\.py( |$)"
    )


@pytest.mark.parametrize(
    ("node", "note"),
    [
        (a_node("/far", pid=0, here=False, address="10.0.0.9"), "/far runs on another host at 10.0.0.9"),
        (a_node("/far", pid=0, here=False), "/far runs on another host"),
        (
            a_node("/dead", pid=0, fault="does not answer: refused"),
            "/dead is registered and does not answer: refused",
        ),
        (a_node("/box", pid=0), "the process of /box is not known"),
        (a_node("/a b", pid=3), "'/a b' is no name of a node"),
        (a_node("no-slash", pid=3), "'no-slash' is no name of a node"),
        (a_node("/odd", pid=3, words=()), "the command line of /odd cannot be read"),
    ],
)
def test_what_cannot_be_known_is_said(node: GraphNode, note: str) -> None:
    _, notes, text = import_nodes(node)
    assert notes == [note]
    assert "managed: false" not in text


def test_a_command_line_that_others_have_too_is_said(tmp_path: Path) -> None:
    tasks, notes, _ = import_nodes(a_node("/a", alike=2), folder=tmp_path)
    assert list(tasks.tasks) == ["a"]
    assert notes == ["2 other processes have the command line of /a: its task counts them too"]


def test_nodes_of_a_second_host_are_found_there() -> None:
    far, near = a_node("/far", pid=0, here=False), a_node("/far", pid=9, named=True)
    graphs = {"edge1": RosGraph(nodes=(far,)), "edge2": RosGraph(nodes=(near,), left_out=3)}
    file, notes = build_live_tasks(graphs, "lab", [], {})
    assert "# /far on edge2" in render_file(file)
    assert [note.message for note in notes] == [
        "3 more nodes are left out: the graph is too large for one reply"
    ]


def test_text_of_a_hostile_host_stays_text(tmp_path: Path) -> None:
    """Whatever a host says of topics and command lines, the file has the tasks that it has."""
    evil = "x\n  evil:\n    command: rm -rf /\n"
    words = ("/opt/a'b", "': {", "}]", "# no", "{robot}", "(a+)+$", "\\")
    tasks, _, _ = import_nodes(
        a_node("/a", pid=1, words=words, publishes=(evil, "/y: [", "'")),
        a_node("/b", pid=2, address=evil),
        folder=tmp_path,
    )
    assert sorted(tasks.tasks) == ["a", "b"]
    rule = tasks.tasks["a"].detect
    assert rule is not None
    assert rule.cmdline is not None
    assert re.search(rule.cmdline, " ".join(words))
    assert not re.search(rule.cmdline, " ".join((*words[:-1], "a")))
