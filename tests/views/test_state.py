# SPDX-License-Identifier: Apache-2.0
"""States in words: crash loops, last words, limits."""

from dataclasses import replace

from edgectl.cli.exit_codes import of_status
from edgectl.errors import ExitCode
from edgectl.model.check import AliveRule, Check
from edgectl.model.ros import RosCheck
from edgectl.model.snapshot import TaskState
from edgectl.views.describe_task import TaskDetailsView
from edgectl.views.output_format import OutputFormat
from edgectl.views.state import format_task_state
from edgectl.views.status import StatusView
from tests.builders import a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.views.fixtures import fleet, show


def test_crash_loop_is_a_failure_with_its_figures() -> None:
    given_up = a_run(
        TaskState.CRASHLOOP,
        restarts=5,
        last_exit=1,
        exit_code=1,
        detail="exited with 1; 5 restarts in 10 minutes",
    )
    assert format_task_state(given_up) == "failed (5 restarts, last exit 1)"
    assert (
        format_task_state(a_run(TaskState.FAILED, detail="fenced: no manager call for 60 s"))
        == "failed (fenced: no manager call for 60 s)"
    )
    assert format_task_state(a_run()) == "ready"
    assert (
        format_task_state(a_run(TaskState.FAILED, detail="exited with 0", exit_code=0))
        == "exited (exit code 0)"
    )


def test_status_ends_with_last_words_and_limits_that_do_not_hold() -> None:
    inventory, tasks, snapshot = fleet()
    host = next(name for name, each in snapshot.hosts.items() if each.ok)
    runs = {
        "broken": a_run(
            TaskState.CRASHLOOP,
            pid=0,
            restarts=5,
            last_exit=1,
            given_up=True,
            log_tail=("Traceback", "\x1b[31mboom"),
        ),
        "limited": a_run(limits="not enforced: lingering is off for edge"),
        "held": a_run(limits="enforced"),
    }
    snapshot = replace(snapshot, hosts={**snapshot.hosts, host: replace(snapshot.hosts[host], tasks=runs)})
    lines = show(StatusView(snapshot, inventory, tasks)).splitlines()
    assert any(line.startswith("broken") and "failed (5 restarts, last exit 1)" in line for line in lines)
    assert f"note: broken on {host}: last output: Traceback" in lines
    assert "note: broken is given up; edgectl restart broken, or a changed spec, starts it again" in lines
    assert f"note: limited on {host}: limits: not enforced: lingering is off for edge" in lines
    assert not any("\x1b" in line or "held on" in line for line in lines)


def test_status_says_first_what_is_not_alive_and_counts_it_as_a_failure() -> None:
    """Its processes run, so nothing else would."""
    inventory, tasks = an_inventory(an_edge("edge1")), some_tasks(a_task("slam"), a_task("nav"))
    sick = a_run(TaskState.UNHEALTHY, detail="node /slam is not registered")
    shown = {}
    for run in (sick, a_run()):
        seen = a_snapshot({"edge1": a_sample(tasks={"slam": run})})
        line = show(StatusView(seen, inventory, tasks)).splitlines()[1]
        shown[run.state] = (
            line == "1 of 2 tasks unhealthy: slam on edge1",
            of_status(seen, inventory, tasks),
        )
    assert shown == {
        TaskState.UNHEALTHY: (True, ExitCode.PARTLY),
        TaskState.READY: (False, ExitCode.DONE),
    }
    assert format_task_state(sick) == "unhealthy (node /slam is not registered)"


def test_a_task_that_crashes_again_and_again_is_a_problem_and_does_not_count_as_running() -> None:
    """Its supervisor restarts it, so the exit code waits until it gives up; a slow first start is none."""
    inventory, tasks = an_inventory(an_edge("edge2"), an_edge("edge1")), some_tasks(a_task("slam"))
    crashed = a_run(
        TaskState.STARTING, pid=0, restarts=4, last_exit=3, detail="exited with 3; restarting in 6 s"
    )
    shown = {}
    for name, run in (
        ("crashed", crashed),
        ("first", a_run(TaskState.STARTING)),
        ("up again", replace(crashed, state=TaskState.READY)),
    ):
        seen = a_snapshot({"edge2": a_sample(), "edge1": a_sample(tasks={"slam": run})})
        view = StatusView(seen, inventory, tasks)
        first, second = show(view).splitlines()[:2]
        assert of_status(seen, inventory, tasks) is ExitCode.DONE
        shown[name] = (first.partition(", ")[2], second, view.items()[0]["attention"])
    assert shown["crashed"] == (
        "0/1 tasks run, 2/2 hosts answer, 1 problem:",
        "1 of 1 tasks restarting after a crash: slam on edge1 (4 restarts, last exit 3)",
        "restarts after a crash (4 restarts, last exit 3)",
    )
    well = ("1/1 tasks run, 2/2 hosts answer, no problem", "", None)
    assert (shown["first"], shown["up again"]) == (well, well)


def test_the_nodes_of_a_task_are_those_that_it_states() -> None:
    inventory = an_inventory(an_edge("edge1"))
    alive = AliveRule(check=Check(ros=RosCheck(node="/robot1/odom")))
    tasks = some_tasks(
        a_task("slam", command="rosrun gmapping slam __name:=slam __ns:=/robot1", alive=alive),
        a_task("launched", command="roslaunch lab all.launch"),
    )
    seen = a_snapshot({"edge1": a_sample(tasks={"slam": a_run(), "stranger": a_run()})})
    view = StatusView(seen, inventory, tasks)
    lines = show(view, OutputFormat.WIDE).splitlines()[2:]
    assert lines[0].split()[-1] == "NODES"
    assert {line.split()[0]: line.partition("0B/s")[2].split()[-2:] for line in lines[1:2]} == {
        "slam": ["/robot1/slam,", "/robot1/odom"]
    }
    assert [(line.split()[0], line.split()[-1]) for line in lines[2:4]] == [
        ("stranger", "-"),
        ("launched", "-"),
    ]
    assert "NODES" not in show(view)
    items = {str(item["task"]): item.get("node_names") for item in view.items()}
    assert items == {"slam": ["/robot1/slam", "/robot1/odom"], "stranger": None, "launched": None}
    shown = TaskDetailsView("slam", seen, inventory, tasks, None, None)
    assert "/robot1/slam, /robot1/odom" in show(shown)
    assert "node /robot1/odom is alive on host within 20s" in show(shown)
