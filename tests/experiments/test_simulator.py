# SPDX-License-Identifier: Apache-2.0
"""The simulator against closed forms."""

import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.experiments.model.comparison import Estimate
from edgectl.experiments.model.scenario import Scenario, SimHost, SimJob, SimLink, SimRun, SimTiming
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.scheme_results import compute_estimate, summarize_sim_runs
from edgectl.experiments.simulator import simulate_mission
from edgectl.experiments.simulator_speeds import compute_fair_shares
from edgectl.model.inventory import Inventory
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.model.task import Task, Tasks
from tests.builders import GI, a_robot, a_task, an_edge, an_inventory, some_tasks

ONE = an_inventory(
    an_edge("edge1", cpu_limit=10.0), a_robot("robot1", onboard=True), links={("edge1", "robot1"): 1e6}
)
TWO = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1", onboard=True))
EDGE, ROBOT = SimHost(cores=4.0, memory=4 * GI), SimHost(cores=1.0, memory=GI)
PRESENT = SimTiming(start=0.0, stop=0.0, every=10.0, limit=10_000.0)
UTILITY = Policy(min_dwell=0.0)
LOCAL = Policy(name=PolicyName.LOCAL)
STILL: Callable[[], float] = lambda: 0.0  # noqa: E731


def mean_of(found: Sequence[Estimate | None]) -> float:
    """The mean of the first host, or of the whole."""
    assert found[0] is not None
    return found[0].mean


def close_to(value: float, abs: float | None = None) -> Any:  # noqa: A002 - as pytest.approx has it
    """``pytest.approx`` for a field of type float."""
    return pytest.approx(value, abs=abs)


def world(
    *jobs: SimJob, inventory: Inventory = ONE, timing: SimTiming = PRESENT, **hosts: SimHost
) -> Scenario:
    machines = {host.name: EDGE if host in inventory.edges else ROBOT for host in inventory.hosts.values()}
    return Scenario(name="test", assumptions=(), hosts={**machines, **hosts}, jobs=jobs, timing=timing)


def one(
    scenario: Scenario,
    *tasks: Task,
    inventory: Inventory = ONE,
    policy: Policy = UTILITY,
    seed: int | None = None,
) -> SimRun:
    dice = STILL if seed is None else partial(random.Random(seed).gauss, 0.0, 1.0)
    return simulate_mission(inventory, some_tasks(*tasks), scenario, policy, dice)


def test_a_job_alone_takes_its_work() -> None:
    run = one(world(SimJob(name="j", task="t", work=100.0)), a_task("t", cpu=2.0))
    assert run.latency == pytest.approx(100.0)
    assert run.finished
    assert run.usage["edge1"].cpu == pytest.approx(0.5)


@pytest.mark.parametrize("count", [2, 4, 5, 8])
def test_equal_tasks_share_a_processor(count: int) -> None:
    """Processor sharing: n tasks of one core each on four cores run at min(1, 4/n)."""
    tasks = [a_task(f"t{number}", cpu=1.0) for number in range(count)]
    run = one(world(*(SimJob(name=task.name, task=task.name, work=60.0) for task in tasks)), *tasks)
    assert run.latency == pytest.approx(60.0 * max(1.0, count / 4))


def test_what_ends_leaves_its_share_to_the_rest() -> None:
    """Two tasks of four cores, both at half speed: the short one (40 s of work) ends at 80 s and is unloaded by the plan at 90 s, when 55 s
    of the long one's work are left, which it does alone.
    """
    tasks = [a_task("long", cpu=4.0), a_task("short", cpu=4.0)]
    jobs = [SimJob(name="long", task="long", work=100.0), SimJob(name="short", task="short", work=40.0)]
    run = one(world(*jobs, timing=replace(PRESENT, every=30.0)), *tasks)
    assert run.jobs == {"short": pytest.approx(80.0), "long": pytest.approx(145.0)}


def test_a_queue_of_jobs_on_one_task_adds_up() -> None:
    jobs = [
        SimJob(name=f"j{number}", task="t", work=10.0 + number, after=(f"j{number - 1}",) if number else ())
        for number in range(5)
    ]
    run = one(world(*jobs), a_task("t", cpu=1.0))
    ends = [run.jobs[f"j{number}"] for number in range(5)]
    assert ends == pytest.approx([10.0, 21.0, 33.0, 46.0, 60.0])


def test_a_saturated_link_slows_all_that_use_it() -> None:
    """Three tasks ask 0.5 MB/s each of a link of 1 MB/s: each runs at 2/3."""
    tasks = [
        a_task(f"t{number}", cpu=0.1, throughput=0.5e6, robots=["robot1"], only=["edge1"])
        for number in range(3)
    ]
    scenario = world(*(SimJob(name=task.name, task=task.name, work=60.0) for task in tasks))
    run = one(scenario, *tasks, policy=replace(UTILITY, best_effort=True))
    assert run.latency == pytest.approx(90.0)
    assert run.usage["edge1"].network_bytes_per_s == pytest.approx(1e6)


def test_the_robot_itself_needs_no_link_and_is_as_fast_as_it_is() -> None:
    task = a_task("t", cpu=2.0, throughput=5e6, robots=["robot1"])
    run = one(world(SimJob(name="j", task="t", work=60.0)), task, policy=LOCAL)
    assert run.latency == pytest.approx(120.0)
    assert run.usage["robot1"].cpu == pytest.approx(1.0)
    assert run.usage["edge1"].cpu == 0.0


def test_starts_wait_for_what_they_need_and_cost_their_time() -> None:
    tasks = [a_task("a", cpu=1.0), a_task("b", cpu=1.0, needs=["a"])]
    jobs = [SimJob(name="a", task="a", work=30.0), SimJob(name="b", task="b", work=30.0)]
    run = one(world(*jobs, timing=replace(PRESENT, start=5.0)), *tasks)
    assert run.jobs == {"a": pytest.approx(35.0), "b": pytest.approx(40.0)}


def test_two_tasks_that_fill_a_host_each_are_put_apart() -> None:
    tasks = [a_task("nav", cpu=3.0), a_task("slam", cpu=3.0)]
    jobs = [SimJob(name=task.name, task=task.name, work=100.0) for task in tasks]
    run = one(world(*jobs, inventory=TWO), *tasks, inventory=TWO)
    assert run.latency == pytest.approx(100.0)
    assert (run.handoffs, run.unplaced) == (0, 0)


def test_a_move_costs_its_downtime_and_is_counted() -> None:
    """Policy paper hops at every plan: 4 s to start, then every 20 s of work a stop of 1 s and a start of 4 s."""
    tasks = [a_task("t", cpu=1.0)]
    scenario = world(
        SimJob(name="t", task="t", work=100.0),
        inventory=TWO,
        timing=replace(PRESENT, start=4.0, stop=1.0, every=20.0),
    )
    run = one(
        scenario,
        *tasks,
        inventory=TWO,
        policy=Policy(name=PolicyName.PAPER, weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0)),
    )
    assert run.handoffs == 4
    assert run.latency == pytest.approx(4.0 + 100.0 + 4 * 5.0)


def test_what_starts_yields_nothing_yet() -> None:
    scenario = replace(
        world(SimJob(name="j", task="t", work=60.0), timing=replace(PRESENT, start=8.0)), rate={"t": 10.0}
    )
    run = one(scenario, a_task("t", cpu=1.0))
    assert run.latency == pytest.approx(68.0)
    assert run.usage["edge1"].rate == pytest.approx(10.0)


def test_the_limit_ends_a_mission_that_nothing_can_serve() -> None:
    run = one(
        world(SimJob(name="j", task="t", work=60.0), timing=replace(PRESENT, limit=100.0)),
        a_task("t", cpu=99.0),
    )
    assert (run.finished, run.latency) == (False, 100.0)
    assert run.unplaced > 1


def test_a_processor_that_somebody_wants_is_never_idle() -> None:
    """1, 2 and 3 cores wanted of 4: max-min gives 1, 1.5 and 1.5, that is, speeds of 1, 3/4 and 1/2."""
    tasks = [a_task(f"t{number}", cpu=float(number)) for number in (1, 2, 3)]
    scenario = world(
        *(SimJob(name=task.name, task=task.name, work=60.0) for task in tasks),
        timing=replace(PRESENT, every=1000.0),
    )
    run = one(scenario, *tasks)
    assert run.jobs == {"t1": pytest.approx(60.0), "t2": pytest.approx(80.0), "t3": pytest.approx(120.0)}
    assert run.usage["edge1"].cpu == pytest.approx(1.0)


def test_the_same_seed_gives_the_same_run_and_another_seed_another() -> None:
    tasks = [a_task(f"t{number}", cpu=1.5) for number in range(4)]
    jobs = [SimJob(name=task.name, task=task.name, work=50.0, spread=0.3) for task in tasks]
    scenario = world(*jobs, inventory=TWO, timing=SimTiming(noise=0.05, every=5.0))
    runs = [one(scenario, *tasks, inventory=TWO, seed=seed) for seed in (1, 1, 2)]
    assert runs[0] == runs[1]
    assert runs[0].latency != runs[2].latency


amounts = st.floats(0.0, 100.0)


@given(amounts, st.dictionaries(st.sampled_from("abcdefgh"), amounts, max_size=8))
def test_shares_are_fair(capacity: float, wanted: dict[str, float]) -> None:
    got = compute_fair_shares(capacity, wanted)
    assert sum(got.values()) == pytest.approx(min(capacity, sum(wanted.values())))
    assert all(got[name] <= wanted[name] + 1e-9 for name in wanted)
    hungry = [got[name] for name in wanted if got[name] < wanted[name] - 1e-6]
    assert all(abs(one - other) < 1e-6 for one, other in pairwise(hungry))
    assert not hungry or max(got.values()) <= max(hungry) + 1e-6


def test_figures_by_hand() -> None:
    """1, 2, 3: mean 2, deviation 1, t(2) = 4.303, half = 4.303 / sqrt 3."""
    assert compute_estimate([1.0, 2.0, 3.0]) == Estimate(
        mean=2.0, std=1.0, half_ci95=close_to(2.48414, abs=1e-5), count=3
    )
    assert compute_estimate([7.0]) == Estimate(mean=7.0)


def test_a_column_is_of_the_edges_and_under_local_execution_of_the_robots() -> None:
    task = a_task("t", cpu=2.0, robots=["robot1"])
    scenario = replace(world(SimJob(name="j", task="t", work=60.0)), rate={"t": 10.0})
    tasks: Tasks = some_tasks(task)
    column = {}
    for name, policy in (("utility", Policy(weights=Weights())), ("local", LOCAL)):
        run = simulate_mission(ONE, tasks, scenario, policy, STILL)
        column[name] = summarize_sim_runs(ONE, Scheme(name=name, policy=policy), [run]).estimates
    assert mean_of(column["utility"]["latency"]) == pytest.approx(1.0)
    assert column["utility"]["rate"] == (Estimate(mean=close_to(10.0)),)
    assert mean_of(column["local"]["latency"]) == pytest.approx(2.0)
    assert mean_of(column["local"]["rate"]) == pytest.approx(5.0)
    assert mean_of(column["local"]["cpu"]) == pytest.approx(100.0)


def test_a_task_leaves_a_link_that_became_slow_only_where_links_are_seen_live() -> None:
    """Two jobs of 100 s at 800 kB/s; after the first the link to edge1 carries 100 kB/s, that to edge2 8 times that.
    Whoever stays needs 800 s for the second job.
    """
    inventory = an_inventory(
        an_edge("edge1"),
        an_edge("edge2"),
        a_robot("robot1"),
        links={("edge1", "robot1"): 1e6, ("edge2", "robot1"): 1e6},
    )
    jobs = (
        SimJob(name="near", task="slam", work=100.0),
        SimJob(name="far", task="slam", work=100.0, after=("near",)),
    )
    changes = (SimLink(edge="edge1", robot="robot1", throughput=1e5, after=("near",)),)
    task = a_task(cpu=1.0, throughput=8e5, robots=["robot1"])
    found = [
        one(
            replace(world(*jobs, inventory=inventory), links=changes, live_links=live),
            task,
            inventory=inventory,
        )
        for live in (True, False)
    ]
    assert [run.handoffs for run in found] == [1, 0]
    assert found[1].latency == pytest.approx(900.0)
    assert found[0].latency < 260.0
