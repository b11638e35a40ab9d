# SPDX-License-Identifier: Apache-2.0
"""A deployment over real sshd: sessions that end; hosts that are down, misreport, print noise or are behind a
jump host.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.model.check import Check
from edgectl.model.inventory import Connection, Inventory, Role
from edgectl.model.plan import Action
from edgectl.model.result import Outcome
from edgectl.model.snapshot import HostStatus
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.logs import follow_log
from edgectl.usecases.stop import restart_tasks
from tests.builders import a_robot, an_inventory
from tests.e2e.bench import (
    EAGER,
    QUICK,
    Bench,
    a_mark,
    a_sleeper,
    a_slice,
    list_sleepers,
    open_bench,
    wait_for_sleepers,
)
from tests.pace import patience
from tests.sshd import Lab

LINKS = {("edge1", "robot1"): 10e6, ("edge2", "robot1"): 10e6}
Managing = Callable[..., Bench]


def build_inventory(lab: Lab, **changes: object) -> Inventory:
    """The lab's three hosts as slices, reached through their ssh_config aliases."""
    edges = [a_slice(lab.host(name, **changes)) for name in ("edge1", "edge2")]
    return an_inventory(*edges, a_slice(lab.host("robot1", role=Role.ROBOT)), links=LINKS)


@pytest.fixture
def manager(lab: Lab, tmp_path: Path) -> Iterator[Callable[[Inventory], Bench]]:
    """Return a factory of managers; afterwards servers and files are as before and all tasks are stopped."""
    made: list[AbstractContextManager[Bench]] = []

    def manage(inventory: Inventory) -> Bench:
        context = open_bench(inventory, tmp_path / f"manager{len(made)}", lab)
        made.append(context)
        return context.__enter__()

    yield manage
    lab.write_files()
    for context in made:
        context.__exit__(None, None, None)


@pytest.mark.parametrize("connection", [Connection.SSH, Connection.OPENSSH])
def test_the_main_job(lab: Lab, manager: Managing, connection: Connection) -> None:
    slam, navigation = a_mark(), a_mark()
    # A name of its own: a manager that is new within the same second does not know the generations of the
    # previous one.
    name = f"slam-{connection.value}"
    ready = Check(command='test -n "$EDGECTL_ROBOT_HOST"', timeout=patience(10.0))
    bench = manager(build_inventory(lab, connection=connection)).using(
        a_sleeper(name, slam, robots=("robot1",), ready=ready),
        a_sleeper(f"{name}-navigation", navigation, robots=("robot1",)),
    )
    assert bench.apply().plan.summary == {Action.START: 2}
    assert (len(wait_for_sleepers(slam)), len(wait_for_sleepers(navigation))) == (
        2,
        2,
    )  # every session of the apply has ended
    assert bench.apply().results is None
    restart_tasks(bench.fleet, [name], options=ApplyOptions(probe=QUICK))
    assert len(wait_for_sleepers(slam)) == 2
    with closing(follow_log(bench.fleet, name)) as printed:
        assert next(printed).endswith(b"up\n")
    bench.stop()
    assert list_sleepers(slam) == list_sleepers(navigation) == []


def test_tasks_of_a_host_that_is_gone_are_held(lab: Lab, manager: Managing) -> None:
    mark = a_mark()
    bench = manager(build_inventory(lab)).using(a_sleeper("slam", mark))
    bench.apply()
    assert bench.where() == {"slam": "edge1"}
    lab["edge1"].stop()
    sample = bench.probe().hosts["edge1"]
    assert (sample.status, sample.error_kind) == (HostStatus.UNREACHABLE, "connect")
    assert bench.actions() == {"slam": Action.HOLD}
    assert bench.apply().results is None


def test_a_changed_host_key_costs_that_host_and_no_other(lab: Lab, manager: Managing) -> None:
    lab.known_hosts.write_text(lab.known_hosts.read_text().replace(lab["edge2"].key, lab["edge1"].key))
    # A fleet of its own: on that of the other tests, other managers have acted, and edge2 may run anything.
    inventory = build_inventory(lab)
    own = {name: replace(host, fleet="changed-key") for name, host in inventory.hosts.items()}
    bench = manager(replace(inventory, hosts=own, fleet="changed-key")).using(a_sleeper("slam", a_mark()))
    hosts = bench.probe().hosts
    assert {name: sample.error_kind for name, sample in hosts.items()} == {
        "edge1": "",
        "edge2": "host-key",
        "robot1": "",
    }
    assert "edgectl trust" in hosts["edge2"].hint
    bench.apply()
    assert bench.where() == {"slam": "edge1"}


def test_noise_around_the_answers_does_no_harm(lab: Lab, manager: Managing) -> None:
    noise = 'printf "Welcome\\n\\033[2J{\\"cpu\\": {\\"cores\\": 99}}\\nedgectl-frame 0 2 0\\n"; echo "mail for you" >&2\n'
    rc = lab["edge1"].home / ".bashrc"
    rc.write_text(noise)
    try:
        bench = manager(build_inventory(lab)).using(a_sleeper("slam", a_mark()))
        bench.apply()
        sample = bench.probe().hosts["edge1"]
        assert sample.measured
        assert sample.usage["cpu"].capacity == 2.0
        assert bench.where() == {"slam": "edge1"}
    finally:
        rc.unlink()


@pytest.mark.parametrize("connection", [Connection.SSH, Connection.OPENSSH])
def test_a_host_behind_another(lab: Lab, manager: Managing, connection: Connection) -> None:
    inventory = build_inventory(lab, connection=connection)
    behind = replace(inventory.hosts["edge2"], proxy_jump="edge1")
    bench = manager(
        an_inventory(inventory.hosts["edge1"], behind, a_robot("robot1", probe=False), links=LINKS)
    )
    task = a_sleeper("slam", a_mark())
    bench = bench.using(replace(task, hosts=replace(task.hosts, only=("edge2",))))
    bench.apply()
    assert bench.where() == {"slam": "edge2"}


def test_a_move_between_hosts(lab: Lab, manager: Managing) -> None:
    mark = a_mark()
    task = a_sleeper("slam", mark, robots=("robot1",))
    bench = manager(build_inventory(lab)).using(task)
    bench.apply()
    moved = bench.using(replace(task, hosts=replace(task.hosts, never=("edge1",)))).apply()
    assert moved.results is not None
    assert moved.results.actions[0].located == "edge2"
    assert len(wait_for_sleepers(mark)) == 2


def test_a_host_that_goes_between_plan_and_start_costs_its_action_only(lab: Lab, manager: Managing) -> None:
    bench = manager(build_inventory(lab)).using(
        *(
            replace(task, hosts=replace(task.hosts, only=(host,)))
            for task, host in (
                (a_sleeper("slam", a_mark()), "edge1"),
                (a_sleeper("camera", a_mark()), "edge2"),
            )
        )
    )

    def confirm(_plan: object) -> bool:
        lab["edge1"].stop()
        return True

    applied = plan_and_apply(bench.fleet, EAGER, confirm, ApplyOptions(probe=QUICK))
    assert applied.results is not None
    assert {result.task: result.outcome for result in applied.results.actions} == {
        "slam": Outcome.FAILED,
        "camera": Outcome.DONE,
    }
