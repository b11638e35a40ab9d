# SPDX-License-Identifier: Apache-2.0
"""A small fleet with a value for every metric."""

from dataclasses import replace

from edgectl.agent.link import sketch
from edgectl.executor.diff import plan_from_assignment
from edgectl.export.metric_samples import MetricsInput
from edgectl.model.latency import LatencySample
from edgectl.model.manager_state import ManagerState, Pin, Placement
from edgectl.model.plan import Action
from edgectl.model.resource import Usage
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.revision import Revision, RevisionOutcome
from edgectl.model.snapshot import DeviceSample, InterfaceSample, LinkSample, TaskState
from edgectl.scheduler.assign import assign
from tests.builders import (
    NOW,
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

DEVICE = DeviceSample(
    temperature_c=51.5,
    gpu_share=0.25,
    power_w=12.5,
    clock_skew_s=-0.5,
    interfaces={
        "eth0": InterfaceSample(rx_bytes_per_s=100.0, tx_bytes_per_s=10.0),
        "wlan0": InterfaceSample(rx_bytes_per_s=20.0, tx_bytes_per_s=2.0),
        "lo": InterfaceSample(rx_bytes_per_s=5e6, tx_bytes_per_s=5e6),
    },
)
LINK = LinkSample(capacity_bytes_per_s=6e6, used_bytes_per_s=3e5, rtt_ms=4.0)


def a_metrics_input(*revisions: Revision) -> MetricsInput:
    """edge1 runs slam; edge2 is unreachable and ran map; edge3 is idle; big fits nowhere; camera is pinned to
    edge1, which is cordoned, by its file, and to edge3 by an operator.
    """
    inventory = an_inventory(
        an_edge("edge1"), an_edge("edge2"), an_edge("edge3"), a_robot("robot1", probe=False)
    )
    tasks = some_tasks(
        a_task("big", cpu=64.0), a_task("camera", cpu=0.5, only=["edge1"]), a_task("job"), a_task("map", cpu=1.0), a_task("slam", cpu=1.0, robots=["robot1"])
    )  # fmt: skip
    run = a_run(
        TaskState.READY,
        used=Usage(cpu=0.8, memory=2e8, network=3e5),
        restarts=2,
        spec_hash="hash-slam",
    )
    latency = LatencySample(
        count=3, misses=1, sum_ms=260.0, bound_ms=100.0, p50_ms=50.0, p95_ms=200.0, p99_ms=200.0,
        buckets={str(sketch.find_bucket(value)): 1 for value in (10.0, 50.0, 200.0)},
    )  # fmt: skip
    run = replace(run, metrics={"fps": 29.5, "map/loss:train.1": -1e300}, latency=latency)
    over = a_run(TaskState.COMPLETED, metrics={"done": 1.0})
    edge = replace(
        a_sample(used=0.9, used_memory=5e8, links={"robot1": LINK}, tasks={"slam": run, "job": over}),
        device=DEVICE,
    )
    memory = ManagerState(
        managed=True,
        placements={"map": Placement(host="edge2", since=NOW - 900.0, spec_hash="hash-map")},
        cordons=frozenset({"edge1"}),
        fenced=frozenset(),
        done={"job": "hash-job"},
        contact={"edge1": NOW, "edge2": NOW - 60.0},
        pins={"camera": Pin(host="edge3", since=NOW)},
    )
    idle = a_sample(links={"robot1": LINK}, standbys={"slam": a_run(spec_hash="hash-slam")})
    snapshot = a_snapshot(memory=memory, edge1=edge, edge2=silent(), edge3=idle)
    plan = plan_from_assignment(
        inventory,
        tasks,
        snapshot,
        memory,
        assign(inventory, tasks, snapshot, memory, tasks.policy, snapshot.taken_at),
    )
    return MetricsInput(version="1.2.3", snapshot=snapshot, plan=plan, revisions=revisions)


def a_revision(number: int, *actions: ActionResult) -> Revision:
    """One apply, an hour after the previous one."""
    return Revision(
        number=number,
        began_at=NOW + 3600.0 * number,
        ending=RevisionOutcome.DONE,
        seconds=1.0,
        actions=actions,
    )


def a_move(
    task: str = "slam", downtime_s: float | None = 0.7, outcome: Outcome = Outcome.DONE
) -> ActionResult:
    """A move of ``task``."""
    return ActionResult(
        task=task,
        action=Action.MOVE,
        outcome=outcome,
        host="edge1",
        previous_host="edge2",
        downtime_s=downtime_s,
    )
