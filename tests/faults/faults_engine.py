# SPDX-License-Identifier: Apache-2.0
"""Faults of container engines: killed, restarted, frozen, their shims killed, containers of others and by others."""

import subprocess

from tests.containers.docker_engine import IMAGE
from tests.faults import scan
from tests.faults.command_result import ExpectationError
from tests.faults.computer_engine import ComputerEngine
from tests.faults.faults_failpoints import (
    APPLY_ONE,
    change_all_tasks,
    choose_failpoints,
    count_failpoints,
    kill_at_failpoint,
)
from tests.faults.faults_host import start_tasks
from tests.faults.faults_link import prepare_changes
from tests.faults.faults_warm_move import strike_at_point
from tests.faults.fleet import APPLY, FaultFleet
from tests.faults.hosts import wait_for
from tests.faults.registry import CONTAINERS, fault

SAMPLED = 6


def draw_engine(fleet: FaultFleet) -> ComputerEngine:
    """Draw one of the engines whose hosts have work."""
    return fleet.engines[fleet.random.choice(fleet.edges[:3])]


def get_container(fleet: FaultFleet, host: str, task: str) -> str:
    """The name of the container of a task."""
    # In a swarm, that of its service with a number and an id.
    names = fleet.engines[host].list_containers()
    (name,) = [each for each in names if each.partition(".")[0].endswith(f"-{task}")]
    return name


@fault("engine killed and manager killed at a point of an apply", kinds=CONTAINERS, quick=True, full=2)
def kill_engine_and_manager(fleet: FaultFleet) -> None:
    """Each time, another engine dies with the manager; it is back for the next apply."""
    start_tasks(fleet)
    points = choose_failpoints(fleet, count_failpoints(fleet, change_all_tasks, 0))
    for number, point in enumerate(fleet.random.sample(points, min(SAMPLED, len(points))), start=1):
        words = change_all_tasks(fleet, number)
        kill_at_failpoint(fleet, words, point)
        engine = draw_engine(fleet)
        engine.kill()
        engine.start()
        fleet.run_edgectl(*words).expect_exit(0)
        fleet.check_verdict()


@fault("engine restarted at a point of an apply", kinds=CONTAINERS, full=2)
def restart_at_points(fleet: FaultFleet) -> None:
    """The manager waits at the point while the engine is killed, or ended, and started again."""
    start_tasks(fleet)
    points = choose_failpoints(fleet, count_failpoints(fleet, change_all_tasks, 0))
    for number, point in enumerate(fleet.random.sample(points, min(SAMPLED, len(points))), start=1):
        words = change_all_tasks(fleet, number)
        strike_at_point(fleet, words, point, lambda: restart_engine(fleet))
        fleet.run_edgectl(*APPLY_ONE).expect_exit(0)
        fleet.check_verdict()


def restart_engine(fleet: FaultFleet) -> None:
    engine = draw_engine(fleet)
    fleet.random.choice([engine.kill, engine.stop])()
    engine.start()


@fault("engine killed while tasks run", kinds=CONTAINERS, full=3)
def kill_engine(fleet: FaultFleet) -> None:
    """Its containers run on; where it is told to keep them, they do so once it is back, too."""
    start_tasks(fleet)
    engine = fleet.engines[fleet.first]
    engine.kill()
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})
    fleet.run_edgectl("status").expect_exit(0, 4)
    engine.start()
    fleet.pin_task("slam", fleet.first)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()
    if engine.live_restore and fleet.count_launches("slam") != 1:
        raise ExpectationError("slam was started again")


def start_changes(fleet: FaultFleet) -> "subprocess.Popen[str]":
    """Start an apply that starts, stops and moves tasks, and wait for a random moment of it."""
    prepare_changes(fleet)
    running = fleet.start_edgectl(*APPLY)
    fleet.wait(fleet.random.uniform(0.3, 4.0))
    return running


@fault("engine killed at a random moment of an apply", kinds=CONTAINERS, full=6)
def kill_engine_during_apply(fleet: FaultFleet) -> None:
    running, engine = start_changes(fleet), draw_engine(fleet)
    engine.kill()
    fleet.wait(fleet.random.uniform(0.0, 3.0))
    engine.start()
    fleet.wait_for_edgectl(running).expect_exit(0, 1, 4)


@fault("engine frozen at a random moment of an apply", kinds=CONTAINERS, full=4)
def freeze_engine_during_apply(fleet: FaultFleet) -> None:
    """It thaws after the apply, and does then what it was asked for."""
    running, engine = start_changes(fleet), draw_engine(fleet)
    engine.freeze()
    fleet.wait_for_edgectl(running).expect_exit(0, 1, 4)
    engine.thaw()
    fleet.wait(3.0)


@fault("engine away while a task should leave it", kinds=CONTAINERS, full=3)
def move_without_engine(fleet: FaultFleet) -> None:
    """Nobody else may end the processes of another user: the move fails, and the task runs where it was."""
    start_tasks(fleet)
    fleet.engines[fleet.first].kill()
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(4)
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})


@fault("shims of the engine killed", kinds=CONTAINERS, full=2)
def kill_shims(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.pin_task("slam", fleet.first)
    scan.kill_processes(fleet.engines[fleet.first].list_shims())
    wait_for(
        lambda: fleet.count_launches("slam") > 1, "a second start of slam: did it run in a container?", 60
    )
    fleet.check_verdict()
    if fleet.count_launches("slam") != 2:
        raise ExpectationError(f"slam was started {fleet.count_launches('slam')} times")


@fault("engine, supervisors and runners killed at once", kinds=CONTAINERS, full=3)
def kill_all_of_ours(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    for name in fleet.edges[:2]:
        found = fleet.hosts[name].processes()
        scan.kill_processes([each for each in found if fleet.mark not in each.command])
        fleet.engines[name].kill()
        fleet.engines[name].start()


@fault("host without power while its task goes elsewhere", kinds=CONTAINERS, full=4)
def leave_dead_container(fleet: FaultFleet) -> None:
    """The dead container is removed beside the next apply; nothing runs there for that."""
    start_tasks(fleet)
    fleet.hosts[fleet.first].power_off()
    fleet.hosts[fleet.first].boot()
    fleet.pin_task("slam", fleet.second)
    fleet.apply_and_check()
    engine = fleet.engines[fleet.first]
    wait_for(lambda: not engine.list_containers(), "the removal of the dead container", 60)


@fault("containers killed, removed or restarted by somebody else", kinds=CONTAINERS, full=3)
def meddle(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    for task, host in (("slam", fleet.first), ("nav", fleet.second), ("grip", fleet.third)):
        how = fleet.random.choice(
            [("kill",), ("rm", "--force"), ("restart", "--time", "1"), ("stop", "--time", "1")]
        )
        fleet.engines[host].call(*how, get_container(fleet, host, task))
    fleet.wait(2.0)


@fault("a foreign container has the name of the task's", kinds=CONTAINERS, full=2)
def occupy_name(fleet: FaultFleet) -> None:
    """The start is refused, and the other container, or service of a swarm, is neither stopped nor removed."""
    start_tasks(fleet)
    name = get_container(fleet, fleet.first, "slam").partition(".")[0].replace(fleet.first, fleet.second)
    if fleet.swarm:
        occupy_name_in_swarm(fleet, name)
        return
    engine = fleet.engines[fleet.second]
    engine.call("run", "--detach", "--network=host", "--name", name, IMAGE, "/opt/busybox", "sleep", "600")
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(1, 4).expect_output("not touched")
    shown = engine.call("inspect", "--format", "{{.State.Running}} {{.RestartCount}}", name)
    if shown != "true 0":
        raise ExpectationError(f"the foreign container was touched: {shown}")
    engine.call("rm", "--force", name)


def occupy_name_in_swarm(fleet: FaultFleet, name: str) -> None:
    engine = fleet.engines[fleet.first]
    place = f"--constraint=node.hostname=={fleet.second}"
    how = ("--detach", "--no-resolve-image", "--name", name, place, IMAGE, "/opt/busybox", "sleep", "600")
    engine.call("service", "create", *how)
    version = ("service", "inspect", "--format", "{{.ID}} {{.Version.Index}}", name)
    before = engine.call(*version)
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(1, 4).expect_output("not touched")
    if engine.call(*version) != before:
        raise ExpectationError(f"the foreign service was touched: {before}, {engine.call(*version)}")
    engine.call("service", "rm", name)
