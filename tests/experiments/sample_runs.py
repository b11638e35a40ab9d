# SPDX-License-Identifier: Apache-2.0
"""Generated runs of experiments: two robots with detection, mapping and map merging, on three edges."""

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from edgectl.experiments.model.experiment import (
    Experiment,
    ExperimentRun,
    HandoffRecord,
    HostCapacity,
    LoadSample,
    MapPair,
    MetricAggregation,
    MetricReading,
    PlacementInterval,
    Trial,
)
from edgectl.experiments.model.schemes import Scheme, build_schemes
from edgectl.model.inventory import Role
from edgectl.model.policy import WEIGHT_PRESETS, Policy, PolicyName

GI = 2.0**30
EDGES = ("edge1", "edge2", "edge3")
ROBOTS = ("robot1", "robot2")
TASKS = tuple(f"{kind}-{robot}" for robot in ROBOTS for kind in ("detect", "follow", "map"))
ENDS = "map-merge"
SCHEMES = build_schemes(
    Policy(), [PolicyName.LOCAL, PolicyName.STATIC, PolicyName.UTILITY], {name: WEIGHT_PRESETS[name] for name in ("cpu", "memory", "network", "all")}, []
)  # fmt: skip
BEGAN = 1_795_258_800.0  # 2026-11-21T09:00:00Z


def a_run(
    schemes: Sequence[Scheme] = SCHEMES,
    repetitions: int = 3,
    *,
    trials: int | None = None,
    seed: int = 1,
    name: str = "mission",
) -> ExperimentRun:
    """The first ``trials`` of an experiment (None: all); the same seed gives the same run."""
    machines = {
        edge: HostCapacity(role=Role.EDGE, cores=cores, memory=4 * GI)
        for edge, cores in zip(EDGES, (1.0, 2.0, 4.0), strict=True)
    }
    machines |= {robot: HostCapacity(role=Role.ROBOT, cores=1.0, memory=GI) for robot in ROBOTS}
    experiment = Experiment(
        name=name, schemes=tuple(schemes), until=(ENDS,), repetitions=repetitions, limit=300.0,
        metrics={"fps": MetricAggregation.MEAN, "loss": MetricAggregation.LAST}, maps={"ssim": MapPair(task=ENDS, file="out/map.yaml", truth="world.yaml")},
    )  # fmt: skip
    pairs = [(scheme, repetition) for scheme in schemes for repetition in range(1, repetitions + 1)]
    rng = random.Random(seed)
    found = [
        _generate_trial(scheme, repetition, number, rng) for number, (scheme, repetition) in enumerate(pairs)
    ]
    return ExperimentRun(
        experiment=experiment, digest="5f2c9a41d07be386", machines=machines, trials=tuple(found[:trials])
    )


def _generate_trial(scheme: Scheme, repetition: int, number: int, rng: random.Random) -> Trial:
    local, moving = scheme.policy.name is PolicyName.LOCAL, scheme.policy.name is PolicyName.UTILITY
    latency = {PolicyName.LOCAL: 190.0, PolicyName.STATIC: 140.0}.get(
        scheme.policy.name, 110.0
    ) * rng.uniform(0.93, 1.12)
    ends = {
        task: latency * share for task, share in zip(TASKS, (0.8, 0.55, 0.9, 0.85, 0.6, 0.93), strict=True)
    }
    spans = [
        PlacementInterval(task=task, host=_choose_host(task, local=local), start=2.0, end=end)
        for task, end in ends.items()
    ]
    spans.append(PlacementInterval(task=ENDS, host="edge3", start=latency * 0.3, end=latency))
    handoffs: list[HandoffRecord] = []
    if moving:
        spans, handoffs = _add_handoffs(spans, rng)
    return Trial(
        scheme=scheme.name, repetition=repetition, began_at=BEGAN + 400.0 * number, latency=round(latency, 2), finished=True,
        unplaced=2 if scheme.policy.name is PolicyName.STATIC else 0, completed={**ends, ENDS: latency}, spans=tuple(spans),
        handoffs=tuple(handoffs), loads=dict(_generate_loads(spans, latency, rng)), ssim={"ssim": round(rng.uniform(0.86, 0.95), 3)},
        readings={"fps": _generate_readings(spans, "detect", 12.0, rng), "loss": _generate_readings(spans, "map", 0.4, rng)},
    )  # fmt: skip


def _choose_host(task: str, *, local: bool) -> str:
    return f"robot{task[-1]}" if local else EDGES[sum(map(ord, task)) % 2]


def _add_handoffs(
    spans: Sequence[PlacementInterval], rng: random.Random
) -> tuple[list[PlacementInterval], list[HandoffRecord]]:
    """Move one to three tasks to another edge in the middle of their time."""
    left, handoffs = list(spans), []
    for span in rng.sample(list(spans[:-1]), rng.randint(1, 3)):
        at, downtime = span.end * rng.uniform(0.3, 0.7), rng.uniform(0.6, 2.4)
        target = rng.choice([edge for edge in EDGES if edge != span.host])
        left[left.index(span)] = replace(span, end=at)
        left.append(PlacementInterval(task=span.task, host=target, start=at + downtime, end=span.end))
        handoffs.append(
            HandoffRecord(
                task=span.task, source=span.host, target=target, at=at + downtime, downtime=downtime
            )
        )
    return left, handoffs


def _generate_loads(
    spans: Sequence[PlacementInterval], latency: float, rng: random.Random
) -> Iterator[tuple[str, tuple[LoadSample, ...]]]:
    for host, cores in zip((*EDGES, *ROBOTS), (1.0, 2.0, 4.0, 1.0, 1.0), strict=True):
        rows = []
        for step in range(int(latency / 5) + 1):
            here = sum(span.host == host and span.start <= 5 * step <= span.end for span in spans)
            rows.append(
                LoadSample(
                    at=5.0 * step + rng.uniform(0, 0.4), cores=min(cores, 0.1 + 0.4 * here * rng.uniform(0.8, 1.2)),
                    memory=(0.2 + 0.09 * here) * GI * rng.uniform(0.97, 1.03), bytes_per_s=0.0 if host in ROBOTS else here * rng.uniform(2e5, 9e5),
                )
            )  # fmt: skip
        yield host, tuple(rows)


def _generate_readings(
    spans: Sequence[PlacementInterval], kind: str, level: float, rng: random.Random
) -> Mapping[str, tuple[MetricReading, ...]]:
    ends = {span.task: span.end for span in spans if span.task.startswith(kind)}
    return {
        task: tuple(
            MetricReading(at=5.0 * step + 5, value=level * rng.uniform(0.8, 1.2))
            for step in range(int(end / 5))
        )
        for task, end in sorted(ends.items())
    }
