# SPDX-License-Identifier: Apache-2.0
"""Where the detections of the patrol stand, measured and in the model: ``python -m tests.experiments.whereabouts [SEEDS]``.

With the rows of the model without what lies between a reading and a move (ADR 181), each left out alone, and all.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple
from unittest.mock import patch

from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.weights import parse_weights
from edgectl.experiments import simulator, simulator_events
from edgectl.experiments.event_draws import build_uniform_draw, create_stream
from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.experiment import ExperimentRun, PlacementInterval, Trial
from edgectl.experiments.model.scenario import Scenario, SimRun
from edgectl.experiments.model.schemes import build_schemes
from edgectl.experiments.simulator_state import SimState, get_link_bytes_per_s, integrate_loads
from edgectl.model.policy import PolicyName
from tests.docs.tables import render_table

ROOT = Path(__file__).parents[2]
RUN = ROOT / "docs" / "experiment"
SCENARIO = ROOT / "docs" / "scenarios" / "patrol.yaml"
POLICIES = (PolicyName.LOCAL, PolicyName.STATIC, PolicyName.LEAST_LOADED, PolicyName.UTILITY)
TASK = "detection-"
# bytes/s: what detection demands of a link. A far one carries half of it.
DEMAND = 390e3
SEEDS = 8
SCHEMES = ("static", "least-loaded", "utility all")
EDGES = ("edge1", "edge2", "edge3")
# What the manager does between a reading and a move, and what its readings miss: left out.
AT_ONCE = {"plan": 0.0, "prepare": 0.0, "apply": 2.3}
LINKS_AT_ONCE = {"by_reading": False}
ALL_BURSTS = {"bursts": 1.0}
LEFT_OUT: tuple[tuple[str, Mapping[str, Any]], ...] = (
    ("moves begin with their plan", AT_ONCE),
    ("links change at once", LINKS_AT_ONCE),
    ("each burst is read", ALL_BURSTS),
    ("all three", AT_ONCE | LINKS_AT_ONCE | ALL_BURSTS),
)


class Whereabouts(NamedTuple):
    """Shares of the time of detections on the edge near their robot, on others whose links were taken to carry
    them, and by host; mission time (s) in the mean.
    """

    near: float
    mistaken: float
    hosts: dict[str, float]
    latency: float


@dataclass(slots=True)
class _Clock:
    """Seconds of detections: near, on far links that were taken to carry them, and by host."""

    near: float = 0.0
    mistaken: float = 0.0
    hosts: dict[str, float] = field(default_factory=dict)

    def add(self, host: str, seconds: float, *, near: bool, trusted: bool = False) -> None:
        self.near += seconds * near
        self.mistaken += seconds * (trusted and not near)
        self.hosts[host] = self.hosts.get(host, 0.0) + seconds

    def read(self, latency: float) -> Whereabouts:
        total = sum(self.hosts.values())
        hosts = {host: seconds / total for host, seconds in self.hosts.items()}
        return Whereabouts(self.near / total, self.mistaken / total, hosts, latency)


def measure_whereabouts(run: ExperimentRun, scheme: str) -> Whereabouts:
    """Those of the trials of one scheme."""
    trials, clock = [trial for trial in run.trials if trial.scheme == scheme], _Clock()
    for trial in trials:
        for span in trial.spans:
            if span.task.startswith(TASK):
                _add_span(clock, run, trial, span)
    return clock.read(fmean(trial.latency for trial in trials))


def _add_span(clock: _Clock, run: ExperimentRun, trial: Trial, span: PlacementInterval) -> None:
    robot = span.task.removeprefix(TASK)
    capacities = trial.links.get(span.host, {}).get(robot, ())
    areas = list(list_areas(run, trial, robot))
    cuts = sorted({span.start, span.end, *(at for at, _ in areas), *(each.at for each in capacities)})
    for begin, end in pairwise(cuts):
        if span.start <= begin < end <= span.end:
            near = [edge for at, edge in areas if at <= begin][-1]
            seen = [each.bytes_per_s for each in capacities if each.at <= begin]
            clock.add(
                span.host,
                end - begin,
                near=span.host == near,
                trusted=bool(seen) and seen[-1] >= DEMAND,
            )


def list_areas(run: ExperimentRun, trial: Trial, robot: str) -> Iterator[tuple[float, str]]:
    """(when the robot came to an area, the edge that is near there), in order: from the commands of the events."""
    commands = {event.name: event.run for event in run.experiment.events}
    for record in sorted(trial.events, key=lambda each: each.at):
        command = commands[record.event]
        for word in command.argv if command is not None and record.kind == "link" else ():
            name, _, edge = word.partition("=")
            if name == robot:
                yield record.at, edge


def simulate_whereabouts(scheme: str, seeds: int, timing: Mapping[str, Any] | None = None) -> Whereabouts:
    """Those of the model, over so many runs; what was taken to carry is not looked at. ``timing``: other values."""
    clock = _Clock()
    with observe(partial(_add_detections, clock)):
        found = simulate_patrol(
            scheme, range(seeds), lambda each: replace(each, timing=replace(each.timing, **(timing or {})))
        )
    return clock.read(fmean(run.latency for run in found))


def simulate_patrol(
    scheme: str, seeds: Iterable[int], change: Callable[[Scenario], Scenario] = lambda scenario: scenario
) -> list[SimRun]:
    """A run of the model for each seed; ``change``: what is another in it."""
    inventory_file, tasks_file = load_scenario_paths(SCENARIO)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, tasks_file)
    scenario = change(load_scenario(SCENARIO, inventory, tasks))
    schemes = build_schemes(tasks.policy, POLICIES, {"all": parse_weights("all")}, [])
    policy = next(each.policy for each in schemes if each.name == scheme)
    return [
        simulator.simulate_mission(
            inventory, tasks, scenario, replace(policy, seed=seed),
            partial(create_stream(f"1/{seed}").gauss, 0.0, 1.0), build_uniform_draw(f"1/{seed}"),
        )
        for seed in seeds
    ]  # fmt: skip


def _add_detections(clock: _Clock, state: SimState, seconds: float) -> None:
    for name, service in state.services.items():
        if name.startswith(TASK) and state.left.get(name):
            carries = get_link_bytes_per_s(state, service.host, name.removeprefix(TASK))
            on_edge = (service.host, name.removeprefix(TASK)) in state.inventory.links
            clock.add(service.host, seconds, near=on_edge and carries >= DEMAND)


@contextmanager
def observe(note: Callable[[SimState, float], None]) -> Iterator[None]:
    """Within, each change of the simulation is preceded by a look at its state, which held for so many seconds."""

    def look(state: SimState) -> None:
        seconds = state.env.now - state.metered_at
        if seconds > 0:
            note(state, seconds)
        integrate_loads(state)

    with ExitStack() as stack:
        for module in (simulator, simulator_events):
            stack.enter_context(patch.object(module, "integrate_loads", look))
        yield


def render_whereabouts(run: ExperimentRun) -> str:
    """What was measured, a row for each scheme that places on edges, as docs/evaluation.md has it."""
    heading = ("scheme", "near edge", "far edge, taken to carry them", *EDGES)
    rows = list[tuple[str, ...]]()
    for scheme in [each.name for each in run.experiment.schemes if each.name != "local"]:
        found = measure_whereabouts(run, scheme)
        rows.append((scheme, _say(found.near), _say(found.mistaken), *_list_hosts(found)))
    return render_table(heading, rows)


def render_model(seeds: int) -> str:
    """What the model says of the same."""
    heading, rows = ("in the model", "near edge", *EDGES, "mission s"), list[tuple[str, ...]]()
    models: list[tuple[str, str, Mapping[str, Any]]] = [(scheme, scheme, {}) for scheme in SCHEMES]
    models += [(f"least-loaded, {name}", "least-loaded", timing) for name, timing in LEFT_OUT]
    models.append((f"utility all, {LEFT_OUT[-1][0]}", "utility all", LEFT_OUT[-1][1]))
    for name, scheme, timing in models:
        found = simulate_whereabouts(scheme, seeds, timing)
        rows.append((name, _say(found.near), *_list_hosts(found), f"{found.latency:.1f}"))
    return render_table(heading, rows)


def _list_hosts(found: Whereabouts) -> list[str]:
    return [_say(found.hosts.get(edge, 0.0)) for edge in EDGES]


def _say(share: float) -> str:
    return f"{100 * share:.0f} %"


if __name__ == "__main__":
    print(render_whereabouts(load_run(RUN)))
    print(render_model(int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS))
