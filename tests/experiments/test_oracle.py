# SPDX-License-Identifier: Apache-2.0
"""The oracle of simulations: joint plans from true speeds, and moves only where they pay."""

from dataclasses import replace

import pytest

from edgectl.experiments.commands.scheme_options import parse_simulated_schemes
from edgectl.experiments.model.scenario import Scenario, SimHost, SimJob, SimLink, SimRun, SimTiming
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import OnboardRule, Task
from tests.builders import GI, a_robot, a_task, an_edge, an_inventory, some_tasks

HOSTS = (an_edge("zulu"), an_edge("mike"), an_edge("alpha"), a_robot("robot1"))
LINKS = {(edge, "robot1"): 1e6 for edge in ("zulu", "mike", "alpha")}
FLEET = an_inventory(*HOSTS, links=LINKS)
MACHINES = {host.name: SimHost(cores=1.0, memory=4 * GI) for host in HOSTS}
TIMING = SimTiming(start=8.0, stop=2.0, every=5.0, limit=10_000.0)


def run_oracle(scenario: Scenario, *tasks: Task) -> SimRun:
    return simulate_mission(FLEET, some_tasks(*tasks), scenario, Policy(), lambda: 0.0, oracle=True)


def test_each_task_has_a_host_of_its_own_whatever_is_declared() -> None:
    """Demands of one core on hosts of one core; the plan starts from utility, which sees no room for a second."""
    tasks = [replace(a_task(name, cpu=1.0), onboard=OnboardRule.NEVER) for name in ("c", "b", "a")]
    jobs = tuple(SimJob(name=task.name, task=task.name, work=60.0) for task in tasks)
    found = run_oracle(Scenario(name="t", assumptions=(), hosts=MACHINES, jobs=jobs, timing=TIMING), *tasks)
    assert found.latency == pytest.approx(68.0)
    assert (found.finished, found.handoffs) == (True, 0)


def test_work_goes_to_the_fast_host_although_both_have_room() -> None:
    """A task of four cores takes a quarter of the speed on one core: 60 s of work on the host of four cores."""
    machines = {**MACHINES, "alpha": SimHost(cores=4.0, memory=4 * GI)}
    task = a_task("t", cpu=4.0)
    job = SimJob(name="j", task="t", work=60.0)
    found = run_oracle(Scenario(name="t", assumptions=(), hosts=machines, jobs=(job,), timing=TIMING), task)
    assert found.latency == pytest.approx(68.0)


@pytest.mark.parametrize(("work", "moves"), [(100.0, 1), (4.0, 0)])
def test_a_move_must_repay_its_stop_and_start(work: float, moves: int) -> None:
    """After the first job the link of the host halves: 100 s of work take 200 s there, and 110 s with a move;
    4 s take 8 s there, and 14 s with a move.
    """
    task = replace(
        a_task("t", cpu=0.1, throughput=1e6, robots=["robot1"], only=["zulu", "mike"]),
        onboard=OnboardRule.NEVER,
    )
    jobs = (SimJob(name="a", task="t", work=30.0), SimJob(name="b", task="t", work=work, after=("a",)))
    falls = SimLink(edge="mike", robot="robot1", throughput=0.5e6, after=("a",))
    scenario = Scenario(name="t", assumptions=(), hosts=MACHINES, jobs=jobs, timing=TIMING, links=(falls,))
    found = run_oracle(scenario, task)
    assert found.handoffs == moves
    ends = found.jobs["b"] - found.jobs["a"]
    assert ends == pytest.approx(8.0) if not moves else 110.0 <= ends < 115.0


def test_the_oracle_is_a_scheme_of_simulations() -> None:
    found = parse_simulated_schemes(Policy(), "oracle, static", None)
    assert [(each.name, each.oracle) for each in found] == [("static", False), ("oracle", True)]
    assert [each.name for each in parse_simulated_schemes(Policy(), "oracle", "all")] == ["oracle"]
    assert PolicyName.UTILITY is found[1].policy.name
