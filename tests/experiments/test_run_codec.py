# SPDX-License-Identifier: Apache-2.0
"""JSON of runs and trials: a round trip loses only the documented rounding, and only once."""

import json
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.experiments.files import run_codec as form
from edgectl.experiments.model.experiment import (
    Experiment,
    ExperimentRun,
    HandoffRecord,
    HostCapacity,
    LinkCapacity,
    LoadSample,
    MapPair,
    MetricAggregation,
    MetricReading,
    MissionUsage,
    PlacementInterval,
    Trial,
)
from edgectl.experiments.model.mission_event import EventRecord
from edgectl.experiments.model.schemes import Scheme
from edgectl.formats.document import FormatErrors, dump_document
from edgectl.model.inventory import Role
from edgectl.model.snapshot import CapacitySource
from tests.formats.strategies import names, policies
from tests.formats.test_complete import POLICY
from tests.formats.test_round_trip import bounded, json_values

TRIAL = Trial(
    scheme="utility all", repetition=2, began_at=1.5, latency=62.125, finished=True, unplaced=3, completed={"merge": 62.125},
    spans=(PlacementInterval(task="slam", host="edge1", start=0.25, end=62.5),),
    handoffs=(HandoffRecord(task="slam", source="edge1", target="edge2", at=30.5, downtime=0.75, gap=0.5),),
    loads={"edge1": (LoadSample(at=0.0, cores=0.5, memory=1e8, bytes_per_s=2000.0), LoadSample(at=5.0, cores=1.25, memory=2e8, bytes_per_s=0.0))},
    readings={"fps": {"slam": (MetricReading(at=5.0, value=-12.5),)}},
    ssim={"ssim": -0.25},
    links={"edge1": {"robot1": (LinkCapacity(at=0.0, bytes_per_s=2e6, source=CapacitySource.DECLARED), LinkCapacity(at=5.0, bytes_per_s=191e3, source=CapacitySource.TCP))}},
    usage={"edge1": MissionUsage(cpu_s=1.25, memory=1e8, network_bytes=5000.0), "edge2": MissionUsage(cpu_s=0.5, memory=1e8)},
    events=(EventRecord(event="near", kind="link", subject="edge1-robot1", at=3.5, until=9.25, error="e", tasks=("t",)),),
)  # fmt: skip
EXPERIMENT = Experiment(
    name="mission", schemes=(Scheme(name="utility all", policy=POLICY),), until=("merge",), repetitions=2, every=2.5, limit=60.0, idle=0.5,
    metrics={"fps": MetricAggregation.LAST}, equivalence=0.05, maps={"ssim": MapPair(task="merge", file="out/map.yaml", truth="world.yaml")},
)  # fmt: skip
RUN = ExperimentRun(
    experiment=EXPERIMENT,
    digest="sha256:0",
    machines={"edge1": HostCapacity(role=Role.ROBOT, cores=4.0, memory=8e9)},
    trials=(TRIAL,),
)

amounts = st.floats(min_value=0.0, max_value=1e12)
values = st.floats(allow_nan=False, allow_infinity=False)
loads = st.builds(LoadSample, at=amounts, cores=amounts, memory=amounts, bytes_per_s=amounts)
capacities = st.builds(LinkCapacity, at=amounts, bytes_per_s=amounts, source=st.sampled_from(CapacitySource))
readings = st.lists(st.builds(MetricReading, at=amounts, value=values), max_size=3).map(tuple)
trials = st.builds(
    Trial,
    scheme=names,
    repetition=st.integers(1, 1000),
    began_at=st.integers(0, 4_000_000_000_000).map(lambda ms: ms / 1000),
    latency=amounts,
    finished=st.booleans(),
    unplaced=st.integers(0, 1000),
    completed=st.dictionaries(names, amounts, max_size=3),
    spans=st.lists(
        st.builds(PlacementInterval, task=names, host=names, start=amounts, end=amounts), max_size=3
    ).map(tuple),
    handoffs=st.lists(
        st.builds(
            HandoffRecord, task=names, source=names, target=names, at=amounts, downtime=st.none() | amounts
        ),
        max_size=2,
    ).map(tuple),
    loads=st.dictionaries(names, st.lists(loads, max_size=3).map(tuple), max_size=2),
    readings=st.dictionaries(names, st.dictionaries(names, readings, max_size=2), max_size=2),
    ssim=st.dictionaries(names, st.floats(-1.0, 1.0), max_size=2),
    links=st.dictionaries(
        names, st.dictionaries(names, st.lists(capacities, max_size=3).map(tuple), max_size=2), max_size=2
    ),
)
experiments = st.builds(
    Experiment,
    name=names,
    schemes=st.lists(st.builds(Scheme, name=names, policy=policies), max_size=2).map(tuple),
    until=st.lists(names, max_size=2).map(tuple),
    repetitions=st.integers(1, 1000),
    every=st.floats(0.5, 1e6),
    limit=st.floats(0.5, 1e6),
    idle=st.floats(0.0, 1.0),
    metrics=st.dictionaries(names, st.sampled_from(MetricAggregation), max_size=2),
    maps=st.dictionaries(names, st.builds(MapPair, task=names, file=names, truth=names), max_size=2),
)
machines = st.builds(
    HostCapacity, role=st.sampled_from(Role), cores=st.floats(0.1, 1e6), memory=st.floats(1.0, 1e15)
)
runs = st.builds(
    ExperimentRun,
    experiment=experiments,
    digest=names,
    machines=st.dictionaries(names, machines, max_size=2),
    trials=st.lists(trials, max_size=2).map(tuple),
)


def test_every_field_survives() -> None:
    assert form.RUN_KIND.decode(json.loads(dump_document(form.RUN_KIND.encode(RUN)))) == RUN
    assert form.TRIAL_KIND.decode(json.loads(dump_document(form.TRIAL_KIND.encode(TRIAL)))) == TRIAL


@bounded
@given(runs)
def test_what_was_written_once_is_written_again_as_it_is(value: ExperimentRun) -> None:
    text = dump_document(form.RUN_KIND.encode(value))
    back = form.RUN_KIND.decode(json.loads(text))
    assert dump_document(form.RUN_KIND.encode(back)) == text
    assert replace(back, trials=()) == replace(value, trials=())
    for before, after in zip(value.trials, back.trials, strict=True):
        assert after.latency == pytest.approx(before.latency, abs=6e-4)
        assert after.readings.keys() == before.readings.keys()
        assert (after.finished, after.unplaced, after.scheme) == (
            before.finished,
            before.unplaced,
            before.scheme,
        )


@bounded
@given(json_values)
def test_any_json_value_is_read_or_refused(value: object) -> None:
    for decode in (form.RUN_KIND.decode, form.TRIAL_KIND.decode):
        with suppress(FormatErrors):
            decode(value)


@pytest.mark.parametrize(
    ("key", "wrong", "told"),
    [
        ("loads", {"edge1": {"at_s": [0], "cores": [], "bytes": [1], "bytes_per_s": [1]}}, "loads.edge1: at_s, cores, bytes, bytes_per_s must be equally long"),
        ("loads", {"edge1": {"at_s": [0], "cores": [-1], "bytes": [1], "bytes_per_s": [1]}}, "loads.edge1.cores.0: must be 0 or more, not -1"),
        ("readings", {"fps": {"slam": {"at_s": [0]}}}, "readings.fps.slam: value is missing"),
        ("readings", {"fps": {"slam": {"at_s": [0], "value": ["x"]}}}, "readings.fps.slam.value.0: must be a number, not a string"),
        ("latency_s", -1, "latency_s: must be 0 or more"),
        ("repetition", 0, "repetition: must be 1 or more"),
        ("finished", None, "finished: must not be null"),
        ("spans", [{"task": "slam"}], "spans.0: host is missing"),
        ("format_version", 2, "format_version: trial of format_version 2; this edgectl reads 1"),
    ],
)  # fmt: skip
def test_mistakes_are_told_with_their_place(key: str, wrong: object, told: str) -> None:
    with pytest.raises(FormatErrors, match="not a valid trial") as caught:
        form.TRIAL_KIND.decode({**form.TRIAL_KIND.encode(TRIAL), key: wrong})
    assert told in str(caught.value.message)
