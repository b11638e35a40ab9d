# SPDX-License-Identifier: Apache-2.0
"""Completeness of the documents: every field of the model, set to something, survives encoding and decoding."""

from dataclasses import MISSING, fields
from enum import StrEnum
from types import MappingProxyType
from typing import Any

import pytest

from edgectl.formats.kinds import MANAGER_STATE_KIND, PLAN_KIND, SNAPSHOT_KIND
from edgectl.model.assignment import (
    Certificate,
    Decision,
    DemandSource,
    DemandSpread,
    ExpectedLoad,
    MoveCost,
    OperatorPin,
    Overuse,
    RankedHost,
    Reason,
    Rejection,
    RejectionRule,
    ResourceDemand,
    Shortage,
    UtilityTerms,
    Verdict,
)
from edgectl.model.inventory import Role
from edgectl.model.latency import LatencySample
from edgectl.model.manager_state import ManagerState, MeasuredDemand, Pin, Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy, PolicyName, Preference, SequenceRule, Weights
from edgectl.model.predicted_latency import PredictedLatency
from edgectl.model.resource import MEMORY, NETWORK, ResourceMap, Usage
from edgectl.model.resource import TERMS as TERM_NAMES
from edgectl.model.snapshot import (
    CapacitySource,
    DeviceSample,
    HostSample,
    HostStatus,
    InterfaceSample,
    LinkSample,
    OtherTask,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
    TermRatings,
    TrafficSource,
    UsageTotals,
)
from edgectl.model.standby_plan import StandbyAction, StandbyReason, StandbyStep

LINK = LinkSample(
    capacity_bytes_per_s=1.0,
    used_bytes_per_s=2.0,
    rtt_ms=3.0,
    partial="udp unseen",
    used_source=TrafficSource.COUNTERS,
    capacity_source=CapacitySource.NIC,
    capacity_age_s=4.0,
    nominal=5.0,
)
LATENCY = LatencySample(
    count=9, misses=1, sum_ms=2.5, bound_ms=100.0, recent_s=60.0, recent_count=4, recent_misses=2, p50_ms=1.0, p95_ms=2.0, p99_ms=3.0, max_ms=4.0,
    age_s=0.5, buckets={"7": 9}, recent={"7": 4}, error="e",
)  # fmt: skip
TASK = TaskSample(
    state=TaskState.FAILED, pid=1, started_at=2.0, used=Usage(cpu=3.0, memory=4.0, network=5.0), links={"r": 6.0}, instance="i",
    spec_hash="s", generation=7, managed=False, restarts=8, exit_code=-9, detail="d",
    fields={"command": "c"}, last_exit=3, log_tail=("l",), limits="enforced", given_up=True, metrics={"fps": 29.5}, ended_at=2.5, file="f", orphaned=True, adoptable=True, needed="a1b2c3", nodes={"/slam": "http://edge1:1"}, partial="udp unseen", latency=LATENCY, switching=True, deactivated=7, container="edgectl-lab-edge1-slam",
)  # fmt: skip
INTERFACE = InterfaceSample(
    rx_bytes_per_s=1.0, tx_bytes_per_s=2.0, speed_bytes_per_s=3.0, level_dbm=-61.0, retries_per_s=4.0, access_point="a", joined_s=5.0,
)  # fmt: skip
DEVICE = DeviceSample(
    load_1m=1.0,
    temperature_c=-2.0,
    gpu_share=0.5,
    power_w=12.5,
    boot_id="b",
    pid_namespace="pid:[1]",
    clock_skew_s=-1.5,
    interfaces={"eth0": INTERFACE},
)
CPU_USE, MEMORY_USE = ResourceUsage(capacity=4.0, used=1.5), ResourceUsage(capacity=5.0, used=2.0)
OTHER = OtherTask(
    fleet="f", host="h", task="t", state=TaskState.READY, started_by="u@m", age_s=1.5, instance="i", spec_hash="s", generation=3,
)  # fmt: skip
HOST = HostSample(
    role=Role.ROBOT, status=HostStatus.UNREACHABLE, error="e", error_kind="k", hint="h", sample_age_s=1.5, resident=True, usage={"cpu": CPU_USE, "memory": MEMORY_USE},
    links={"r": LINK}, tasks={"t": TASK}, standbys={"s": TASK}, device=DEVICE, generations={"t": 9},
    other_tasks=(OTHER,), foreign_tasks=(OTHER,), address="a", machine="m", grant=4, foreign_grant=3, foreign_hosts=("x",), counters="installed", engines=("docker",),
    totals=UsageTotals(cpu_s=1.5, network_bytes=2.5, tasks={"i": 0.5}),
)  # fmt: skip
PLACEMENT = Placement(
    host="h",
    since=1.0,
    spec_hash="s",
    generation=2,
    file="f",
    address="a",
    machine="m",
    instance="i",
    nodes={"/slam": "http://edge1:1"},
)
MEASURED = MeasuredDemand(
    samples=60, span_s=300.5, used={"cpu": 0.25, "memory": 7.0, "network": 1.5}, spec_hash="s"
)
PIN = Pin(host="h", since=1.0, until=2.0, machine="m")
MANAGER = ManagerState(
    managed=True, placements={"t": PLACEMENT}, first={"t": "h"}, cordons=frozenset({"a"}), draining=frozenset({"b"}), done={"t": "s"},
    downtimes={("t", "h"): (1.5, 2.0)}, stays={"t": (60.0, 90.5)}, contact={"h": 1.5}, fenced=frozenset({"c"}),
    deferred={"t": "d"}, measured={("t", "4c-8Gi"): MEASURED}, orphans={"h": ("t",)}, synced={"h": 4},
    noise={"h": {"cpu": 0.25}}, pins={"t": PIN},
)  # fmt: skip
RATINGS = TermRatings(package="p 1", tasks={"t": {"h": 0.25}})
SNAPSHOT = Snapshot(taken_at=1.5, hosts={"h": HOST}, manager=MANAGER, ratings={"r": RATINGS})
WEIGHTS = Weights({name: 0.1 * place for place, name in enumerate(TERM_NAMES, 1)})
POLICY = Policy(
    name=PolicyName.PAPER, weights=WEIGHTS, sequence=SequenceRule.SENSITIVITY, move_margin=0.2, min_dwell=3.0, max_moves=None, attended=False,
    best_effort=True, full=True, without=frozenset({"h"}), prune=True, rebalance=True, optimal=True,
    prefer=Preference.PACK, seed=7, terms=("r",),
)  # fmt: skip
REJECTION = Rejection(
    rule=RejectionRule.INSUFFICIENT,
    resource=NETWORK,
    robot="r",
    task="o",
    demand=1.0,
    used=2.0,
    capacity=3.0,
)
TERMS = UtilityTerms({name: -0.1 * place for place, name in enumerate(TERM_NAMES, 1)})
RHO = ResourceDemand(resource=NETWORK, value=1.5, source=DemandSource.MEASURED, samples=412, demanded=0.5)
OVERUSE = Overuse(task="t-1", entry="t", host="h", resource=NETWORK, used=2.0, declared=1.0)
SHORTAGE = Shortage(resource=MEMORY, amount=1.5)
CERTIFICATE = Certificate(
    wanted=4,
    placed=3,
    placed_bound=3,
    moves=2,
    moves_bound=1,
    utility_sum=1.5,
    utility_sum_bound=1.75,
    withheld=2,
    timed_out=True,
)
UNEVEN = DemandSpread(task="t", resource=MEMORY, share=0.25, least=1.5, most=3.0, hosts=("a", "b"))
PREDICTED = PredictedLatency(
    p50_ms=1.0, p95_ms=2.0, p99_ms=3.0, low_ms=0.5, high_ms=4.0, service_ms=0.75, host_load=0.5, waiting_ms=0.25, transfer_ms=1.5,
    rtt_ms=2.5, elsewhere=True,
)  # fmt: skip
RANKED = RankedHost(
    host="h",
    rank=1,
    total=0.5,
    terms=TERMS,
    feasible=True,
    affinity=-1,
    rejections=(REJECTION,),
    demand=(RHO,),
    predicted_latency=PREDICTED,
)
COST = MoveCost(stay_s=600.0, downtime_s=4.5, per_s=0.25)
OPERATOR_PIN = OperatorPin(host="h", until=2.0, set_aside=RejectionRule.CORDONED)
DECISION = Decision(
    task="t", verdict=Verdict.KEPT, reason=Reason.DWELL, host="h", previous_host="g", total=0.1, lead=0.2, challenger="c", subject="s",
    amount=1.0, cost=COST, nearest="n", overcommitted=True, ranking=(RANKED,), rejection_counts={"stale": 2}, demand=(RHO,),
    pin=OPERATOR_PIN,
)  # fmt: skip
STANDBY = StandbyStep(
    host="h", action=StandbyAction.KEEP, reason=StandbyReason.DWELL, instance="i", subject="g", amount=-1.5, total=-0.5, demand=Usage(cpu=0.5, memory=2.0),
)  # fmt: skip
STEP = Step(
    decision=DECISION,
    action=Action.MOVE,
    instances={"h": "i"},
    stop=("g",),
    changed=("env",),
    standbys=(STANDBY,),
)
EXPECTED = ExpectedLoad(used=Usage(cpu=1.0, memory=2.0), links={"r": 3.0})
PLAN = Plan(
    created_at=1.5, fleet="lab", policy=POLICY, inventory_digest="a", tasks_digest="b", snapshot=SNAPSHOT, settled=False, steps=(STEP,),
    expected={"h": EXPECTED}, frozen=True, unseen=("u",), demand_spreads=(UNEVEN,), tasks_left_alone={"o": "f"}, overuses=(OVERUSE,),
    shortages=(SHORTAGE,), certificate=CERTIFICATE,
)  # fmt: skip
VALUES = [
    LINK, LATENCY, TASK, INTERFACE, DEVICE, CPU_USE, MEMORY_USE, HOST, PLACEMENT, PIN, OPERATOR_PIN, MANAGER, RATINGS, SNAPSHOT, WEIGHTS, POLICY, REJECTION, TERMS, PREDICTED, RANKED, COST, DECISION,
    STANDBY, STEP, EXPECTED, PLAN, MEASURED, RHO, UNEVEN, OTHER, OVERUSE, SHORTAGE, CERTIFICATE,
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_every_field_of_the_samples_is_set(value: Any) -> None:
    if isinstance(value, ResourceMap):
        assert value.stated == value
        return
    for field in fields(value):
        default = field.default_factory() if field.default_factory is not MISSING else field.default
        assert getattr(value, field.name) != default, (
            f"{type(value).__name__}.{field.name} is at its default: set it here, and see that it survives"
        )


def test_every_field_survives() -> None:
    assert SNAPSHOT_KIND.decode(SNAPSHOT_KIND.encode(SNAPSHOT)) == SNAPSHOT
    assert MANAGER_STATE_KIND.decode(MANAGER_STATE_KIND.encode(MANAGER)) == MANAGER
    assert PLAN_KIND.decode(PLAN_KIND.encode(PLAN)) == PLAN


def test_documents_hold_nothing_but_json() -> None:
    def walk(value: object) -> None:
        assert type(value) in (dict, list, str, int, float, bool, type(None)), type(value)
        assert not isinstance(value, StrEnum | MappingProxyType)
        for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            walk(inner)

    for document in (
        SNAPSHOT_KIND.encode(SNAPSHOT),
        MANAGER_STATE_KIND.encode(MANAGER),
        PLAN_KIND.encode(PLAN),
    ):
        walk(document)
