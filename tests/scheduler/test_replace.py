# SPDX-License-Identifier: Apache-2.0
"""Replacement of tasks on unreachable hosts (ADR 0020): held until the copy there is certainly gone; on
return the newer copy wins.
"""

from dataclasses import dataclass, field, replace
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.executor.diff import diff_assignment, plan_from_assignment
from edgectl.executor.manager_state_update import compute_next_generations, update_manager_state
from edgectl.model.assignment import Decision, Reason, RejectionRule, Verdict
from edgectl.model.inventory import Role
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.model.snapshot import HostSample, Snapshot, TaskState
from edgectl.model.task import StopRule, Task, UnreachablePolicy
from tests.builders import (
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)
from tests.scheduler.fleets import decisions_by_task, ranking_by_host, run_assign
from tests.scheduler.test_properties import quick

THREE = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"))
AROUND = a_snapshot(edge1=silent(), edge2=a_sample(), edge3=a_sample(used=1.0))


def a_replaceable_task(name: str = "slam", **fields: Any) -> Task:
    return a_task(
        name,
        **{
            "on_unreachable": UnreachablePolicy.REPLACE,
            "replace_after": 120.0,
            "self_fence": 60.0,
            "cpu": 1.0,
            **fields,
        },
    )


def a_manager_state(
    *, contact: float | None = None, fenced: bool = False, generation: int = 7
) -> ManagerState:
    """Manager state with slam on edge1, last contacted ``contact`` seconds ago."""
    return ManagerState(
        managed=True,
        placements={"slam": Placement(host="edge1", since=NOW - 900.0, generation=generation)},
        contact={} if contact is None else {"edge1": NOW - contact},
        fenced=frozenset({"edge1"}) if fenced else frozenset(),
    )


def decide_one(task: Task, memory: ManagerState, snapshot: Snapshot = AROUND) -> Decision:
    return run_assign(THREE, some_tasks(task), snapshot, memory=memory).decisions[0]


@pytest.mark.parametrize(
    ("task", "memory", "left"),
    [
        (a_replaceable_task(), a_manager_state(contact=119.0), 1.0),  # after: 120 is more than 60 + 20 + 10
        (a_replaceable_task(), a_manager_state(contact=120.0), 0.0),
        (a_replaceable_task(self_fence=300.0), a_manager_state(contact=120.0), 210.0),  # 300 + 20 + 10
        (a_replaceable_task(self_fence=300.0), a_manager_state(contact=330.0), 0.0),
        (
            a_replaceable_task(self_fence=300.0, stop=StopRule(grace=100.0)),
            a_manager_state(contact=330.0),
            80.0,
        ),  # 300 + 100 + 10
        (
            a_replaceable_task(self_fence=300.0, stop=StopRule(signal="INT", grace=1.0, preset="ros")),
            a_manager_state(contact=330.0),
            5.0,
        ),  # 300 + 25 + 10
        (a_replaceable_task(), a_manager_state(), None),  # time of the last contact unknown
        (a_replaceable_task(), a_manager_state(contact=-3600.0), 3720.0),  # the clock went back by an hour
        (a_replaceable_task(self_fence=None), a_manager_state(contact=1e6), None),  # no self-fence
        (a_replaceable_task(on_unreachable=UnreachablePolicy.HOLD), a_manager_state(contact=1e6), None),
        (a_replaceable_task(), a_manager_state(fenced=True), 0.0),  # fenced by the operator
        (
            a_replaceable_task(on_unreachable=UnreachablePolicy.HOLD, self_fence=None),
            a_manager_state(fenced=True),
            0.0,
        ),
    ],
)
def test_when_a_task_is_replaced(task: Task, memory: ManagerState, left: float | None) -> None:
    decision = decide_one(task, memory)
    if left == 0.0:
        assert (decision.verdict, decision.reason, decision.host) == (
            Verdict.PLACED,
            Reason.REPLACED,
            "edge2",
        )
        assert (decision.previous_host, decision.subject) == ("edge1", "edge1")
    else:
        assert (decision.verdict, decision.reason, decision.host) == (
            Verdict.HELD,
            Reason.HOST_SILENT,
            "edge1",
        )
        assert decision.amount == (None if left is None else pytest.approx(left))


@pytest.mark.parametrize(
    ("started", "verdict"), [("hash-slam", Verdict.PLACED), ("with a longer self_fence", Verdict.HELD)]
)
def test_a_file_that_was_changed_since_says_nothing_of_the_copy_on_the_silent_host(
    started: str, verdict: Verdict
) -> None:
    memory = a_manager_state(contact=1e6)
    memory = replace(memory, placements={"slam": replace(memory.placements["slam"], spec_hash=started)})
    assert decide_one(a_replaceable_task(), memory).verdict is verdict
    assert (
        decide_one(a_replaceable_task(), replace(memory, fenced=frozenset({"edge1"}))).verdict
        is Verdict.PLACED
    )


def test_a_replaced_task_is_started_elsewhere_and_its_demand_is_charged() -> None:
    tasks = some_tasks(a_replaceable_task(), a_task("nav", needs=["slam"]))
    found = run_assign(THREE, tasks, AROUND, memory=a_manager_state(contact=500.0))
    slam, nav = (decisions_by_task(found)[name] for name in ("slam", "nav"))
    assert found.expected["edge2"].used["cpu"] == 1.0
    assert [entry.rule for entry in ranking_by_host(slam)["edge1"].rejections] == [RejectionRule.UNREACHABLE]
    assert (nav.host, nav.reason) == ("edge2", Reason.BEST)
    (step, _) = diff_assignment(found, tasks, AROUND, a_manager_state())
    assert (step.action, step.instances, step.stop) == (Action.START, {}, ())


def test_a_replaced_task_that_fits_nowhere_is_unplaced() -> None:
    decision = decide_one(a_replaceable_task(cpu=9.0), a_manager_state(contact=500.0))
    assert (decision.verdict, decision.reason, decision.previous_host) == (
        Verdict.UNPLACED,
        Reason.NO_FEASIBLE_HOST,
        "edge1",
    )


def test_nothing_is_replaced_while_most_edges_are_silent() -> None:
    alone = a_snapshot(edge1=silent(), edge2=a_sample(), edge3=silent())
    decision = decide_one(a_replaceable_task(), a_manager_state(contact=500.0), alone)
    assert (decision.verdict, decision.amount) == (Verdict.HELD, None)
    # an edge that is known to be off says nothing about the manager's own link: 1 of 2 is unreachable
    assert decide_one(a_replaceable_task(), a_manager_state(fenced=True), alone).reason is Reason.REPLACED


def test_a_silent_robot_still_holds_its_task() -> None:
    inventory = an_inventory(*THREE.edges, a_robot())
    snapshot = a_snapshot(
        edge1=silent(),
        edge2=a_sample(links={"robot1": a_link()}),
        edge3=a_sample(),
        robot1=silent(Role.ROBOT),
    )
    tasks = some_tasks(a_replaceable_task(robots=["robot1"]))
    decision = run_assign(inventory, tasks, snapshot, memory=a_manager_state(fenced=True)).decisions[0]
    assert (decision.reason, decision.host, decision.subject) == (Reason.ROBOT_SILENT, "edge1", "robot1")


@pytest.mark.parametrize(
    ("generation", "contact", "host", "reason", "stop"),
    [
        (
            6,
            30.0,
            "edge1",
            Reason.HOST_SILENT,
            ("edge2",),
        ),  # an older copy came back: it is stopped, the newer one waited for
        (
            6,
            500.0,
            "edge2",
            Reason.STILL_BEST,
            (),
        ),  # the newer one is gone by now: the older one is the only copy
        (7, 30.0, "edge2", Reason.STILL_BEST, ()),  # not older: started by someone else since
        (8, 30.0, "edge2", Reason.STILL_BEST, ()),
    ],
)
def test_a_copy_that_is_seen_may_be_older_than_one_that_is_silent(
    generation: int, contact: float, host: str, reason: Reason, stop: tuple[str, ...]
) -> None:
    copy = a_run(used=Usage(cpu=1.0), generation=generation)
    snapshot = a_snapshot(
        edge1=silent(), edge2=a_sample(used=1.0, tasks={"slam": copy}), edge3=a_sample(used=1.0)
    )
    tasks, memory = some_tasks(a_replaceable_task()), a_manager_state(contact=contact)
    found = run_assign(THREE, tasks, snapshot, memory=memory)
    assert (found.decisions[0].host, found.decisions[0].reason) == (host, reason)
    assert found.expected["edge2"].used["cpu"] == (0.0 if stop else 1.0)
    assert diff_assignment(found, tasks, snapshot, memory)[0].stop == stop


def test_what_somebody_else_started_is_not_stopped_for_a_silent_copy() -> None:
    snapshot = a_snapshot(
        edge1=silent(), edge2=a_sample(tasks={"slam": a_run(managed=False)}), edge3=a_sample()
    )
    decision = decide_one(a_replaceable_task(), a_manager_state(contact=30.0), snapshot)
    assert (decision.host, decision.reason) == ("edge2", Reason.UNMANAGED)


# --- what really runs, while hosts go and come back

EDGES = ("edge1", "edge2", "edge3", "edge4", "edge5")
FLEET = an_inventory(*map(an_edge, EDGES))
WORK = some_tasks(
    a_replaceable_task("a", cpu=0.5),
    a_replaceable_task("b", cpu=0.3, needs=["a"], self_fence=200.0, stop=StopRule(grace=30.0)),
    a_task("c", cpu=0.3),
    a_task("d", cpu=0.2, needs=["c"]),
)


@dataclass(slots=True, kw_only=True)
class FleetTruth:
    """Running copies (with their generation), reachable hosts, and one manager that plans and applies.

    ``sound``: supervisors stop their task after a silence, as they must.
    """

    sound: bool
    now: float = NOW
    copies: dict[tuple[str, str], int] = field(default_factory=dict)
    cut: set[str] = field(default_factory=set)
    off: set[str] = field(default_factory=set)
    memory: ManagerState = field(default_factory=ManagerState)

    def wait(self, seconds: float) -> None:
        """Advance time; supervisors without contact for so long stop their task."""
        self.now += seconds
        for task, host in list(self.copies) if self.sound else ():
            spec = WORK.tasks[task]
            fenced = (
                spec.self_fence is not None
                and self.now - self.memory.contact[host] >= spec.self_fence + spec.stop.grace
            )
            if host in self.cut and fenced:
                del self.copies[task, host]

    def power_off(self, host: str, *, told: bool) -> None:
        """Cut the power of a host; ``told``: the operator fences it."""
        self.off.add(host)
        self.copies = {(task, at): generation for (task, at), generation in self.copies.items() if at != host}
        if told:
            self.memory = replace(self.memory, fenced=self.memory.fenced | {host})

    def apply(self) -> Plan:
        """One probe, plan and apply by the manager."""
        heard = [host for host in EDGES if host not in self.cut | self.off]
        contact = {**self.memory.contact, **dict.fromkeys(heard, self.now)}
        self.memory = replace(self.memory, contact=contact, fenced=self.memory.fenced - set(heard))
        snapshot = a_snapshot(
            {host: self._sample(host) if host in heard else silent() for host in EDGES}, taken_at=self.now
        )
        plan = plan_from_assignment(
            FLEET,
            WORK,
            snapshot,
            self.memory,
            run_assign(FLEET, WORK, snapshot, memory=self.memory, policy=Policy(), now=self.now),
        )
        numbers = compute_next_generations(self.memory, snapshot, plan.steps, self.now)
        results = tuple(
            self._carry_out(step, numbers[step.task])
            for step in plan.steps
            if step.action.changes or step.stop
        )
        self.memory = update_manager_state(
            self.memory, plan, WORK, Results(revision=1, actions=results, seconds=0.0), numbers, self.now
        )
        return plan

    def _sample(self, host: str) -> HostSample:
        here = {
            task: a_run(TaskState.READY, generation=generation, started_at=self.now)
            for (task, at), generation in self.copies.items() if at == host
        }  # fmt: skip
        return a_sample(tasks=here, used=sum(0.3 for _ in here))

    def _carry_out(self, step: Step, generation: int) -> ActionResult:
        decision = step.decision
        gone = {*step.stop, *((decision.previous_host,) if step.action in (Action.MOVE, Action.STOP) else ())}
        for host in gone:
            assert host not in self.cut | self.off
            self.copies.pop((step.task, str(host)), None)
        if step.action in (Action.START, Action.MOVE):
            assert decision.host not in self.cut | self.off
            self.copies[step.task, str(decision.host)] = generation
        return ActionResult(
            task=step.task, action=step.action, outcome=Outcome.DONE, host=decision.host, previous_host=decision.previous_host,
            located=decision.host,
        )  # fmt: skip

    def most(self) -> int:
        """Return the greatest number of copies of any task, on reachable and unreachable hosts."""
        return max((sum(name == task for name, _ in self.copies) for task in WORK.tasks), default=0)


def inject_trouble(truth: FleetTruth, dice: Random) -> None:
    """Apply one random event to one host."""
    host = dice.choice(EDGES)
    kind = dice.choice(("cut", "cut", "back", "back", "power", "nothing"))
    if kind == "back":
        truth.cut.discard(host)
        truth.off.discard(host)
    elif kind == "cut" and host not in truth.off:
        truth.cut.add(host)
    elif kind == "power":
        truth.cut.discard(host)
        truth.power_off(host, told=dice.random() < 0.5)


@quick
@given(st.randoms(use_true_random=False), st.integers(1, 25))
def test_no_task_ever_runs_twice_while_hosts_go_and_come_back(dice: Random, steps: int) -> None:
    truth = FleetTruth(sound=True)
    truth.apply()
    for _ in range(steps):
        inject_trouble(truth, dice)
        truth.wait(dice.choice((1.0, 30.0, 100.0, 400.0)))
        truth.apply()
        assert truth.most() <= 1
    truth.cut.clear()
    truth.off.clear()
    truth.apply()
    truth.apply()
    assert sorted(task for task, _ in truth.copies) == sorted(WORK.tasks)


@quick
@given(st.randoms(use_true_random=False), st.integers(1, 25))
def test_where_a_supervisor_failed_to_stop_its_task_the_newest_copy_wins_on_return(
    dice: Random, steps: int
) -> None:
    truth = FleetTruth(sound=False)
    truth.apply()
    for _ in range(steps):
        inject_trouble(truth, dice)
        truth.wait(dice.choice((1.0, 30.0, 100.0, 400.0)))
        plan = truth.apply()
        heard = [task for task, host in truth.copies if host not in truth.cut | truth.off]
        assert len(heard) == len(set(heard))
        assert len({step.task for step in plan.steps}) == len(plan.steps)
    truth.cut.clear()
    truth.off.clear()
    newest = {
        task: max(g for (name, _), g in truth.copies.items() if name == task) for task, _ in truth.copies
    }
    truth.apply()
    assert truth.most() <= 1
    assert all(generation >= newest.get(task, 0) for (task, _), generation in truth.copies.items())
