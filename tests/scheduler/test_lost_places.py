# SPDX-License-Identifier: Apache-2.0
"""Tasks of hosts that left the inventory, or have another address: held until their place is seen or fenced
(ADR 0040).
"""

from dataclasses import replace

import pytest

from edgectl.cli import exit_codes
from edgectl.errors import ExitCode
from edgectl.executor.diff import plan_from_assignment
from edgectl.executor.manager_state_update import update_manager_state
from edgectl.model.inventory import Connection, Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Plan
from edgectl.model.result import Results
from edgectl.model.snapshot import DeviceSample, HostSample, MachineIdentity, Snapshot
from edgectl.rules.lost_places import find_shared_machine, list_fence_marks, list_shared_machines
from edgectl.scheduler.assign import assign
from edgectl.views.notes import list_lost_task_notes
from edgectl.views.reasons import describe_reason
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, silent, some_tasks
from tests.e2e.bench import a_slice

OLD, NEW = "ana@10.0.0.1", "10.0.0.9"
TASKS = some_tasks(a_task("slam", cpu=1.0))
PLACED = Placement(host="edge1", since=NOW, generation=5, address=OLD, machine="m1/1000/a")


def seen(address: str = "", machine: str = "", generation: int | None = None, given: int = 0) -> HostSample:
    """A host that runs ``slam`` with ``generation``, or that was once given the generation ``given`` of it."""
    tasks = {} if generation is None else {"slam": a_run(generation=generation, spec_hash="hash-slam")}
    recalled = {"slam": given} if given else {}
    return replace(a_sample(tasks=tasks), address=address, machine=machine, generations=recalled)


def plan_after(placement: Placement, fenced: frozenset[str] = frozenset(), **hosts: HostSample) -> Plan:
    inventory = an_inventory(*(an_edge(name) for name in hosts))
    manager = ManagerState(managed=True, placements={"slam": placement}, fenced=fenced)
    snapshot = a_snapshot(hosts, memory=manager)
    policy = TASKS.policy
    return plan_from_assignment(
        inventory, TASKS, snapshot, manager, assign(inventory, TASKS, snapshot, manager, policy, NOW)
    )


LEFT = "hold: ran on edge1, which is no longer in the inventory: put it back and drain it, or edgectl fence edge1"
MOVED = (
    "hold: ran on edge1 at ana@10.0.0.1, which the inventory no longer states: "
    "put that back and drain it, or edgectl fence edge1"
)


@pytest.mark.parametrize(
    ("hosts", "fenced", "action", "reason"),
    [
        # The defect: a host was renamed or removed, and its tasks were started a second time.
        ({"edge2": seen()}, (), Action.HOLD, LEFT),
        ({"edge2": seen()}, ("edge1",), Action.START, ""),
        # Seen elsewhere: the newest copy is known; an older copy is not the newest.
        ({"edge2": seen(generation=5)}, (), Action.KEEP, ""),
        ({"edge2": seen(generation=4)}, (), Action.HOLD, LEFT),
        # The same name with another address or login.
        ({"edge1": seen(NEW, "m2/1000/a"), "edge2": seen()}, (), Action.HOLD, MOVED),
        ({"edge1": seen(OLD.replace("ana", "root"), "m1/0/b"), "edge2": seen()}, (), Action.HOLD, MOVED),
        ({"edge1": seen(NEW, "m2/1000/a"), "edge2": seen()}, ("edge1",), Action.HOLD, MOVED),
        ({"edge1": seen(NEW, "m2/1000/a"), "edge2": seen()}, (OLD,), Action.START, ""),
        # The same login of the same machine under another address: what is not seen there is gone.
        ({"edge1": seen(NEW, "m1/1000/a", given=5)}, (), Action.START, ""),
        ({"edge9": seen(NEW, "m1/1000/a", given=6)}, (), Action.START, ""),
        # Another machine from a copy of the same image: it was never given the placed generation.
        ({"edge1": seen(NEW, "m1/1000/a")}, (), Action.HOLD, MOVED),
        ({"edge1": seen(NEW, "m1/1000/a", given=4)}, (), Action.HOLD, MOVED),
        ({"edge9": seen(NEW, "m1/1000/a", given=4)}, (), Action.HOLD, LEFT),
        ({"edge1": seen(NEW, "")}, (), Action.HOLD, MOVED),
        ({"edge1": replace(silent(), address=NEW), "edge2": seen()}, (), Action.HOLD, MOVED),
        # The same address, or one that nobody noted.
        ({"edge1": seen(OLD, "m9/1000/a")}, (), Action.START, ""),
        ({"edge1": seen("", "")}, (), Action.START, ""),
    ],
)
def test_a_task_at_a_lost_place_is_held_until_its_place_is_seen_or_fenced(
    hosts: dict[str, HostSample], fenced: tuple[str, ...], action: Action, reason: str
) -> None:
    plan = plan_after(PLACED, frozenset(fenced), **hosts)
    (step,) = plan.steps
    assert step.action is action
    held = action is Action.HOLD
    if held:
        assert describe_reason(step) == reason
    assert exit_codes.of_plan(plan, detailed=False, allow_unreachable=True) is (
        ExitCode.PARTLY if held and "slam" not in hosts.get("edge2", seen()).tasks else ExitCode.DONE
    )
    after = update_manager_state(plan.snapshot.manager or ManagerState(), plan, TASKS, NOTHING, {}, NOW)
    if held:
        assert after.placements == {"slam": PLACED}


NOTHING = Results(revision=1, actions=(), seconds=0.0)


def test_status_names_a_lost_task_that_no_file_lists() -> None:
    manager = ManagerState(placements={"old": PLACED})
    snapshot = a_snapshot(edge2=seen(), memory=manager)
    assert list_lost_task_notes(snapshot) == [f"old {LEFT.removeprefix('hold: ')}"]
    assert exit_codes.of_snapshot(snapshot, an_inventory(an_edge("edge2"))) is ExitCode.PARTLY


def test_a_running_task_remembers_the_address_at_which_it_was_seen() -> None:
    plan = plan_after(Placement(host="edge1", since=NOW), edge1=seen(NEW, "m2/1/a", generation=1))
    after = update_manager_state(plan.snapshot.manager or ManagerState(), plan, TASKS, NOTHING, {}, NOW)
    assert (after.placements["slam"].address, after.placements["slam"].machine) == (NEW, "m2/1/a")


def test_a_fence_of_a_host_with_another_address_marks_the_former_one() -> None:
    manager = ManagerState(placements={"slam": PLACED})
    assert list_fence_marks("edge1", an_inventory(an_edge("edge1")), manager) == {OLD}
    assert list_fence_marks("edge1", an_inventory(an_edge("edge2")), manager) == {"edge1"}
    assert list_fence_marks("edge2", an_inventory(an_edge("edge2")), manager) == {"edge2"}


def answer_from(machine: str, boot: str, processes: str = "") -> HostSample:
    place = f"{machine}/1000/a" if machine else ""
    return replace(a_sample(), machine=place, device=DeviceSample(boot_id=boot, pid_namespace=processes))


WHOLE = an_inventory(an_edge("a"), an_edge("b"), an_edge("c"))


@pytest.mark.parametrize(
    ("inventory", "one", "other", "shared"),
    [
        (WHOLE, ("m", "x"), ("m", "x"), ("a", "c")),
        (an_inventory(an_edge("a"), an_edge("b"), a_slice(an_edge("c"))), ("m", "x"), ("m", "x"), None),
        (an_inventory(an_edge("a"), an_edge("c", connection=Connection.LOCAL)), ("m", "x"), ("m", "x"), None),
        # A copied image, and containers of one machine.
        (WHOLE, ("m", "x"), ("m", "y"), None),
        (WHOLE, ("m", "x", "p"), ("n", "x", "p"), None),
        # Without a machine id: one machine, one of whose names does not tell, two containers, copied images, agents
        # that do not tell.
        (WHOLE, ("", "x", "p"), ("", "x", "p"), ("a", "c")),
        (WHOLE, ("m", "x", "p"), ("", "x", "p"), ("a", "c")),
        (WHOLE, ("", "x", "p"), ("", "x", "q"), None),
        (WHOLE, ("", "x", "p"), ("", "y", "p"), None),
        (WHOLE, ("", "x"), ("", "x"), None),
    ],
)
def test_one_machine_under_two_names_is_found(
    inventory: Inventory, one: tuple[str, ...], other: tuple[str, ...], shared: tuple[str, str] | None
) -> None:
    hosts = {"a": answer_from(*one), "b": answer_from("o", "x", "o"), "c": answer_from(*other)}
    assert find_shared_machine(inventory, Snapshot(taken_at=NOW, hosts=hosts)) == shared


def test_each_further_name_of_a_machine_is_listed_after_the_first() -> None:
    one, other = MachineIdentity(boot_id="x", machine_id="m"), MachineIdentity(boot_id="y", machine_id="m")
    inventory = an_inventory(*map(an_edge, "fedcba"))
    seen = {"f": one, "e": other, "d": one, "c": MachineIdentity(), "b": other, "a": one}
    assert list(list_shared_machines(inventory, seen)) == [("f", "d"), ("e", "b"), ("f", "a")]
