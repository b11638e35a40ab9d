# SPDX-License-Identifier: Apache-2.0
"""Tables and documents of simulations and replays."""

from dataclasses import replace
from typing import Any

from edgectl.experiments.model.comparison import (
    Estimate,
    EventResult,
    RecoveryResult,
    ReferenceValues,
    ReplayResult,
    SchemeResult,
    Utilisation,
)
from edgectl.experiments.model.mission_event import HostLoad, MissionEvent
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.views.replay import ReplayView
from edgectl.experiments.views.simulation import SimulationView
from edgectl.model.policy import Policy
from edgectl.model.resource import RESOURCES_BY_NAME
from edgectl.views.text import RenderOptions
from tests.views.fixtures import show

SCENARIO = Scenario(name="test", assumptions=("all is well",), hosts={}, jobs=())
REAL = ReferenceValues(
    label="published",
    means={"local": {"latency": (4.0,), "cpu": (99.0,)}, "utility all": {"latency": (2.0,), "cpu": (50.0, 0.0)}},
)  # fmt: skip


def simulated(name: str, latency: float, *cpu: float) -> SchemeResult:
    others = {
        metric: tuple(Estimate(mean=1.0) for _ in cpu)
        for metric in ("cpu peak", "memory", "throughput", "rate")
    }
    figures = {
        "latency": (Estimate(mean=latency, std=0.5, half_ci95=0.1, count=5),),
        "cpu": tuple(Estimate(mean=each) for each in cpu),
        **others,
    }
    return SchemeResult(
        scheme=Scheme(name=name, policy=Policy()), runs=5, unfinished=int(name == "local"), unplaced=0,
        estimates=figures | {"handoffs": (Estimate(mean=0.2),)},
    )  # fmt: skip


FOUND = [simulated("local", 4.001, 90.0), simulated("utility all", 3.0, 60.0, 40.0)]
VIEW = SimulationView(scenario=SCENARIO, results=FOUND, reference=REAL)
TEXT = """\
SCHEME       LATENCY min   CPU %  MEMORY %  FRAMES/s  HANDOFFS
local          4.00±0.10      90       1.0       1.0       0.2
  published         4.00      99         -         -         -
  off by             +0%     -9%         -         -         -
utility all    3.00±0.10   60/40   1.0/1.0   1.0/1.0       0.2
  published         2.00    50/0         -         -         -
  off by            +50%  +20%/-         -         -         -
"""


def test_the_published_stands_below_the_model_with_the_deviation() -> None:
    text = show(VIEW)
    assert text.startswith(TEXT)
    assert "Latency as a share of local execution: utility all 0.75 (published 0.50).\n" in text
    assert "local: runs ended by the time limit: 1\n" in text
    assert text.endswith("- all is well\n")


def test_a_host_that_is_lost_for_good_and_events_that_came_too_late_are_said() -> None:
    gone = MissionEvent(name="off", at=9.0, lost="zinc")
    back = MissionEvent(name="on-again", at=9.0, duration=3.0, lost="mint")
    late = MissionEvent(name="late", at=900.0, load=HostLoad(host="mint", cpu=1.0))
    nothing = RecoveryResult(count=5, not_recovered=0, recovery=None)
    happened = EventResult(
        event="off", kind="lost", subject="zinc", runs=5, failed=0, at=None, recoveries=nothing
    )
    again = replace(happened, event="on-again", runs=2)
    results = [replace(each, events=(happened, again)) for each in FOUND]
    scenario = replace(SCENARIO, events=(gone, back, late))
    lines = (
        SimulationView(scenario=scenario, results=results, reference=REAL)
        .table(RenderOptions(width=300))
        .splitlines()
    )
    assert (
        "zinc stays lost, because event off has no for: its tasks wait for it unless they state on_unreachable: replace"
        in lines
    )
    assert not any("mint stays lost" in line for line in lines)
    missing = [line for line in lines if "did not happen" in line]
    assert missing == [
        "event on-again did not happen, since the mission ended first; runs: local 3 of 5, utility all 3 of 5",
        "event late did not happen, since the mission ended first; runs: local 5 of 5, utility all 5 of 5",
    ]
    ended = SimulationView(scenario=scenario, results=results[1:], reference=REAL)
    assert "stays lost" not in ended.table(RenderOptions(width=300)), "its tasks were done, or went elsewhere"
    document: Any = ended.item()
    (events,) = (scheme["mission_events"] for scheme in document["schemes"])
    assert [(each["event_name"], each["run_count"], each["occurrences"]) for each in events] == [
        ("off", 5, 5),
        ("on-again", 2, 5),
        ("late", 0, 0),
    ]
    assert events[2]["begin_s"] is None


def test_wide_has_every_metric_and_its_deviation() -> None:
    head = VIEW.wide(RenderOptions(width=160)).splitlines()[0]
    assert head.split() == [
        "SCHEME",
        "LATENCY",
        "min",
        "CPU",
        "%",
        "PEAK",
        "%",
        "MEMORY",
        "%",
        "MB/s",
        "FRAMES/s",
        "HANDOFFS",
    ]


def test_the_document_holds_figures_and_assumptions() -> None:
    document: Any = VIEW.document()["item"]
    assert document["assumptions"] == ["all is well"]
    scheme = document["schemes"][0]
    assert scheme["figures"]["latency"] == [{"mean": 4.001, "std": 0.5, "half_ci95": 0.1, "run_count": 5}]
    assert scheme["reference_figures"] == {"latency": [4], "cpu": [99]}


SHARE = Utilisation(mean=0.5, peak=1.2)
REPLAYED = ReplayResult(
    scheme=Scheme(name="paper all", policy=Policy()),
    cycles=4,
    handoffs=6,
    unplaced=1,
    unsettled=2,
    assumed=("slam-robot10", "slam-robot2"),
    utilisation=dict.fromkeys(RESOURCES_BY_NAME, SHARE),
)


def test_replayed_variants_stand_side_by_side() -> None:
    view = ReplayView(results=[REPLAYED])
    lines = show(view).splitlines()
    assert lines[0].split() == ["SCHEME", "HANDOFFS", "PER", "CYCLE", "UNPLACED", "CPU", "MEMORY", "NETWORK"]
    assert lines[1].split() == ["paper", "all", "6", "1.500", "1", "50%/120%", "50%/120%", "50%/120%"]
    assert lines[2].startswith("4 cycles; ")
    assert (
        lines[3]
        == "note: never recorded as running, so their usage is taken from their demand: slam-robot2, slam-robot10 (2)"
    )
    items: Any = view.document()["items"]
    assert items[0]["assumed"] == [
        "slam-robot10",
        "slam-robot2",
    ]
    assert items[0]["utilisation"]["cpu"] == {"mean": 0.5, "peak": 1.2}


def test_where_nothing_was_recorded_no_number_is_shown() -> None:
    nothing = Utilisation(mean=0.0, peak=0.0)
    value = ReplayResult(
        scheme=Scheme(name="paper all", policy=Policy()), cycles=0, handoffs=0, unplaced=0, unsettled=0,
        utilisation=dict.fromkeys(RESOURCES_BY_NAME, nothing),
    )  # fmt: skip
    assert ReplayView(results=[value]).table().splitlines()[1].split() == [
        "paper",
        "all",
        "0",
        "-",
        "0",
        "-",
        "-",
        "-",
    ]
