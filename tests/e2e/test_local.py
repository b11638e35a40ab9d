# SPDX-License-Identifier: Apache-2.0
"""A whole deployment on this machine: two edges and a robot as slices of it, with real processes."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from edgectl.errors import LockBusyError, StalePlanError
from edgectl.formats.kinds import PLAN_KIND
from edgectl.model.check import Check, CheckLocation
from edgectl.model.plan import Action
from edgectl.model.result import Outcome
from edgectl.model.snapshot import TaskState
from edgectl.model.task import HandoffContract, TaskKind
from edgectl.usecases.apply import ApplyOptions, apply_saved_plan, plan_and_apply
from edgectl.usecases.logs import read_log
from edgectl.usecases.probe import measure_links
from edgectl.usecases.stop import restart_tasks
from tests.builders import a_robot, a_task, an_edge, an_inventory
from tests.e2e.bench import (
    BY_CPU,
    EAGER,
    GENTLE,
    QUICK,
    Bench,
    a_local,
    a_mark,
    a_sleeper,
    kill_processes,
    list_sleepers,
    open_bench,
    wait_for_sleepers,
)
from tests.pace import patience

EDGES = [a_local(an_edge("edge1"), "127.0.0.31"), a_local(an_edge("edge2"), "127.0.0.32")]
ROBOT = a_local(a_robot("robot1"), "127.0.0.41")
LINKS = {("edge1", "robot1"): 10e6, ("edge2", "robot1"): 10e6}


@pytest.fixture
def bench(tmp_path: Path, isolated: Path) -> Iterator[Bench]:
    with open_bench(an_inventory(*EDGES, ROBOT, links=LINKS), tmp_path / "manager", isolated) as running:
        yield running


@pytest.fixture
def pair(tmp_path: Path, isolated: Path) -> Iterator[Bench]:
    """The edges alone: what needs no robot asks two hosts instead of three."""
    with open_bench(an_inventory(*EDGES), tmp_path / "manager", isolated) as running:
        yield running


def test_probe_plan_apply_status_and_nothing_more_to_do(bench: Bench) -> None:
    slam, navigation = a_mark(), a_mark()
    ready = Check(command="true", timeout=patience(10.0))
    bench = bench.using(
        a_sleeper("slam", slam, ready=ready, robots=("robot1",)),
        a_sleeper("navigation", navigation, robots=("robot1",), needs=a_task("x", needs=["slam"]).needs),
    )
    assert bench.plan().summary == {Action.START: 2}
    applied = bench.apply()
    assert applied.results is not None
    assert [result.outcome for result in applied.results.actions] == [Outcome.DONE] * 2
    assert len(wait_for_sleepers(slam)) == len(wait_for_sleepers(navigation)) == 2
    assert (bench.sample("slam").state, bench.sample("navigation").state) == (
        TaskState.READY,
        TaskState.RUNNING,
    )
    assert not bench.plan().changes
    assert bench.apply().results is None
    assert read_log(bench.fleet, "slam").splitlines() == ["up"]
    bench.stop()
    assert list_sleepers(slam) == list_sleepers(navigation) == []
    assert bench.where() == {}


def test_what_is_killed_by_hand_is_started_by_the_next_apply(pair: Bench) -> None:
    mark = a_mark()
    bench = pair.using(a_sleeper("slam", mark, restart=a_task("x").restart.NEVER))
    bench.apply()
    main = bench.sample("slam").pid
    supervisor = int(Path(f"/proc/{main}/stat").read_text().rpartition(")")[2].split()[1])
    kill_processes([supervisor, main, *wait_for_sleepers(mark)])
    assert bench.actions() == {"slam": Action.START}
    bench.apply()
    assert len(wait_for_sleepers(mark)) == 2
    assert bench.actions() == {"slam": Action.KEEP}


def test_what_failed_under_restart_never_is_started_on_a_word_only(pair: Bench) -> None:
    mark = a_mark()
    bench = pair.using(a_sleeper("slam", mark, restart=a_task("x").restart.NEVER))
    bench.apply()
    kill_processes([bench.sample("slam").pid, *wait_for_sleepers(mark)])
    for _ in range(2):
        assert bench.actions() == {"slam": Action.UNPLACED}
        assert bench.apply().results is None
    assert list_sleepers(mark) == []
    restart_tasks(bench.fleet, ["slam"], options=ApplyOptions(probe=QUICK))
    assert len(wait_for_sleepers(mark)) == 2
    assert bench.actions() == {"slam": Action.KEEP}


def test_a_load_that_rises_moves_a_task(pair: Bench) -> None:
    mark = a_mark()
    slam = a_sleeper("slam", mark, priority=1.0)  # decided first, with everything measured on edge1
    pair.using(slam).apply(BY_CPU)
    assert pair.where() == {"slam": "edge1"}
    busy = f"{sys.executable} -c 'while True: pass'"
    burner = a_task("burner", command=f"{busy} & {busy} & wait", stop=GENTLE, pin="edge1")
    loaded = pair.using(slam, burner)
    loaded.apply(BY_CPU)
    # On a busy machine Python takes its time to start, and one window may see little of it.
    deadline = time.monotonic() + patience(30)
    while (applied := loaded.apply(BY_CPU)).results is None:
        assert time.monotonic() < deadline, "the load moves nothing"
    (moved,) = applied.results.actions
    assert (moved.previous_host, moved.host) == ("edge1", "edge2")
    assert moved.downtime_s is not None
    assert loaded.where() == {"slam": "edge2", "burner": "edge1"}
    assert len(wait_for_sleepers(mark)) == 2
    assert loaded.actions(BY_CPU) == {"slam": Action.KEEP, "burner": Action.KEEP}


def test_a_move_that_fails_restores_the_old_instance(bench: Bench, tmp_path: Path) -> None:
    mark = a_mark()
    hooks: dict[str, Any] = {
        name: Check(command=f"echo {name} >> {tmp_path}/hooks", on=CheckLocation.ROBOT)
        for name in ("safe_when", "hold", "release")
    }
    ready = Check(command='test "$EDGECTL_HOST" = edge1', timeout=patience(5.0))
    task = a_sleeper("slam", mark, robots=("robot1",), ready=ready, handoff=HandoffContract(**hooks))
    bench.using(task).apply()
    elsewhere = replace(task, hosts=replace(task.hosts, never=("edge1",)))
    applied = plan_and_apply(bench.using(elsewhere).fleet, EAGER, options=ApplyOptions(probe=QUICK))
    assert applied.results is not None
    (result,) = applied.results.actions
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge1")
    assert result.error == f"slam was not ready on edge2 within {ready.timeout:.3g} s; restored on edge1"
    assert bench.where() == {"slam": "edge1"}
    assert len(wait_for_sleepers(mark)) == 2
    assert (tmp_path / "hooks").read_text().split() == ["safe_when", "hold", "release"]


def test_a_stale_plan_is_refused(pair: Bench) -> None:
    mark = a_mark()
    bench = pair.using(a_sleeper("slam", mark))
    bench.apply()
    made = PLAN_KIND.decode(
        PLAN_KIND.encode(bench.using(a_sleeper("slam", mark), a_sleeper("camera", a_mark())).plan())
    )
    restart_tasks(bench.fleet, ["slam"], options=ApplyOptions(probe=QUICK))
    with pytest.raises(StalePlanError, match="slam was restarted on edge1"):
        apply_saved_plan(
            bench.using(a_sleeper("slam", mark), a_sleeper("camera", a_mark())).fleet,
            made,
            ApplyOptions(probe=QUICK),
        )


def test_of_two_applies_at_once_one_is_told_to_come_again(pair: Bench) -> None:
    bench = pair.using(a_sleeper("slam", a_mark()))

    def confirm(_plan: object) -> bool:
        with pytest.raises(LockBusyError) as caught:
            bench.apply()
        assert caught.value.exit_code == 75
        return True

    assert plan_and_apply(bench.fleet, EAGER, confirm, ApplyOptions(probe=QUICK)).results is not None


def test_a_job_completes_and_a_mission_is_done_when_its_robot_says_so(bench: Bench, tmp_path: Path) -> None:
    mark = a_mark()
    done = Check(command=f"test -e {tmp_path}/home", on=CheckLocation.ROBOT)
    bench = bench.using(
        a_task("job", command="true", kind=TaskKind.JOB),
        a_sleeper("mission", mark, robots=("robot1",), done_when=done),
    )
    bench.apply()
    assert bench.actions() == {"job": Action.NONE, "mission": Action.KEEP}
    (tmp_path / "home").touch()
    assert bench.actions()["mission"] is Action.COMPLETE
    bench.apply()
    assert list_sleepers(mark) == []
    assert bench.actions() == {"job": Action.NONE, "mission": Action.NONE}


def test_tasks_outlive_a_manager_that_is_killed(bench: Bench, tmp_path: Path) -> None:
    """kill -9 after the first start was acknowledged: the task runs, and the next apply finds it."""
    script = tmp_path / "killed.py"
    mark, other = a_mark(), a_mark()
    script.write_text(
        "import os, signal, sys\nfrom pathlib import Path\nfrom edgectl.state import failpoints\nfrom tests.e2e import test_local as t\n"
        "from tests.e2e.bench import Bench, a_sleeper\nfrom edgectl.usecases.fleet import Fleet\nfrom edgectl.transport.fleet_transport import FleetTransport\n"
        "from tests.builders import an_inventory\nfrom edgectl.model.task import Tasks\n"
        "failpoints.install_hook(lambda point: os.kill(os.getpid(), signal.SIGKILL) if point == 'start acknowledged' else None)\n"
        "inventory = an_inventory(*t.EDGES, t.ROBOT, links=t.LINKS)\n"
        "fleet = Fleet(inventory=inventory, tasks=Tasks(tasks={}), transport=FleetTransport(), state=Path(sys.argv[1]))\n"
        "Bench(fleet).using(a_sleeper('slam', sys.argv[2]), a_sleeper('camera', sys.argv[3])).apply()\n"
    )
    root = Path(__file__).parents[2]
    command = [sys.executable, str(script), str(bench.fleet.state), mark, other]
    killed = subprocess.run(
        command, cwd=root, env={**os.environ, "PYTHONPATH": str(root)}, check=False, timeout=patience(60)
    )
    assert killed.returncode == -9
    bench = bench.using(a_sleeper("slam", mark), a_sleeper("camera", other))
    bench.apply()
    assert any("was interrupted while it changed" in text for text in bench.said)
    assert (len(wait_for_sleepers(mark)), len(wait_for_sleepers(other))) == (2, 2)


def test_a_link_is_measured_by_sending(bench: Bench) -> None:
    inventory = an_inventory(*EDGES, ROBOT)
    bench = bench.using(inventory=inventory)
    found = measure_links(bench.fleet, seconds=0.3)
    assert [measured.error for measured in found] == ["", ""]
    link = bench.probe().hosts["edge1"].links["robot1"]
    assert (link.capacity_source, link.capacity_bytes_per_s) == ("measured", found[0].bytes_per_s)
