"""Runs of experiments made up for tests: two robots that detect, map and merge, over three edges."""

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from edgectl.experiments.model.comparison import Scheme
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
from edgectl.experiments.model.schemes import build_schemes
from edgectl.model.inventory import Role
from edgectl.model.policy import Policy, PolicyName

GI = 2.0**30
EDGES = ("edge1", "edge2", "edge3")
ROBOTS = ("robot1", "robot2")
TASKS = tuple(f"{kind}-{robot}" for robot in ROBOTS for kind in ("detect", "follow", "map"))
ENDS = "map-merge"
SCHEMES = build_schemes(
    Policy(), [PolicyName.LOCAL, PolicyName.STATIC, PolicyName.UTILITY], ["cpu", "memory", "network", "all"], []
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
    """The first ``trials`` of an experiment with these schemes, all where None; the same seed gives the same run."""
    machines = {
        edge: HostCapacity(role=Role.EDGE, cores=cores, memory=4 * GI)
        for edge, cores in zip(EDGES, (1.0, 2.0, 4.0), strict=True)
    }
    machines |= {robot: HostCapacity(role=Role.ROBOT, cores=1.0, memory=GI) for robot in ROBOTS}
    experiment = Experiment(
        name=name, schemes=tuple(schemes), until=(ENDS,), repetitions=repetitions, limit=300.0,
        metrics={"fps": MetricAggregation.MEAN, "loss": MetricAggregation.LAST}, maps={"ssim": MapPair(task=ENDS, file="out/map.yaml", truth="world.yaml")},
    )  # fmt: skip
    pairs = [(variant, repetition) for variant in schemes for repetition in range(1, repetitions + 1)]
    dice = random.Random(seed)
    found = [_trial(variant, repetition, number, dice) for number, (variant, repetition) in enumerate(pairs)]
    return ExperimentRun(
        experiment=experiment, digest="5f2c9a41d07be386", machines=machines, trials=tuple(found[:trials])
    )


def _trial(variant: Scheme, repetition: int, number: int, dice: random.Random) -> Trial:
    local, moving = variant.policy.name is PolicyName.LOCAL, variant.policy.name is PolicyName.UTILITY
    latency = {PolicyName.LOCAL: 190.0, PolicyName.STATIC: 140.0}.get(
        variant.policy.name, 110.0
    ) * dice.uniform(0.93, 1.12)
    ends = {
        task: latency * share for task, share in zip(TASKS, (0.8, 0.55, 0.9, 0.85, 0.6, 0.93), strict=True)
    }
    spans = [
        PlacementInterval(task=task, host=_home(task, local=local), start=2.0, end=end)
        for task, end in ends.items()
    ]
    spans.append(PlacementInterval(task=ENDS, host="edge3", start=latency * 0.3, end=latency))
    handoffs = []
    if moving:
        spans, handoffs = _moved(spans, dice)
    return Trial(
        scheme=variant.name, repetition=repetition, began_at=BEGAN + 400.0 * number, latency=round(latency, 2), finished=True,
        unplaced=2 if variant.policy.name is PolicyName.STATIC else 0, completed={**ends, ENDS: latency}, spans=tuple(spans),
        handoffs=tuple(handoffs), loads=dict(_loads(spans, latency, dice)), ssim={"ssim": round(dice.uniform(0.86, 0.95), 3)},
        readings={"fps": _readings(spans, "detect", 12.0, dice), "loss": _readings(spans, "map", 0.4, dice)},
    )  # fmt: skip


def _home(task: str, *, local: bool) -> str:
    return f"robot{task[-1]}" if local else EDGES[sum(map(ord, task)) % 2]


def _moved(
    spans: Sequence[PlacementInterval], dice: random.Random
) -> tuple[list[PlacementInterval], list[HandoffRecord]]:
    """One or two tasks go on elsewhere after a while."""
    left, handoffs = list(spans), []
    for span in dice.sample(list(spans[:-1]), dice.randint(1, 3)):
        at, downtime = span.end * dice.uniform(0.3, 0.7), dice.uniform(0.6, 2.4)
        target = dice.choice([edge for edge in EDGES if edge != span.host])
        left[left.index(span)] = replace(span, end=at)
        left.append(PlacementInterval(task=span.task, host=target, start=at + downtime, end=span.end))
        handoffs.append(
            HandoffRecord(
                task=span.task, source=span.host, target=target, at=at + downtime, downtime=downtime
            )
        )
    return left, handoffs


def _loads(
    spans: Sequence[PlacementInterval], latency: float, dice: random.Random
) -> Iterator[tuple[str, tuple[LoadSample, ...]]]:
    for host, cores in zip((*EDGES, *ROBOTS), (1.0, 2.0, 4.0, 1.0, 1.0), strict=True):
        rows = []
        for step in range(int(latency / 5) + 1):
            here = sum(span.host == host and span.start <= 5 * step <= span.end for span in spans)
            rows.append(
                LoadSample(
                    at=5.0 * step + dice.uniform(0, 0.4), cores=min(cores, 0.1 + 0.4 * here * dice.uniform(0.8, 1.2)),
                    memory=(0.2 + 0.09 * here) * GI * dice.uniform(0.97, 1.03), bytes_per_s=0.0 if host in ROBOTS else here * dice.uniform(2e5, 9e5),
                )
            )  # fmt: skip
        yield host, tuple(rows)


def _readings(
    spans: Sequence[PlacementInterval], kind: str, level: float, dice: random.Random
) -> Mapping[str, tuple[MetricReading, ...]]:
    ends = {span.task: span.end for span in spans if span.task.startswith(kind)}
    return {
        task: tuple(
            MetricReading(at=5.0 * step + 5, value=level * dice.uniform(0.8, 1.2))
            for step in range(int(end / 5))
        )
        for task, end in sorted(ends.items())
    }
