# SPDX-License-Identifier: Apache-2.0
"""Latency in requests and replies: who counts what, and which counts belong to which task."""

from dataclasses import replace
from typing import Any

import pytest

from edgectl.agent.link import sketch
from edgectl.gateway.latency import decode_latencies, encode_latency_rules, join_latencies
from edgectl.model.check import CheckLocation
from edgectl.model.latency import LatencyRule
from edgectl.model.ros import RosSettings
from edgectl.model.snapshot import TaskSample, TaskState
from tests.builders import a_robot, a_sample, a_task, an_edge, an_inventory, some_tasks

ROS = RosSettings(version=2, setup=("/opt/ros/jazzy/setup.bash",), domain=7)
ROBOTS = [replace(a_robot(name), ros=ROS) for name in ("robot1", "robot2")]
FLEET = an_inventory(an_edge("edge1"), an_edge("edge2"), *ROBOTS)
METRIC = a_task("m", latency=LatencyRule(metric="age_ms"), deadline=0.1, only=["edge1"])
TOPIC = a_task("t", latency=LatencyRule(topic="/cmd"), deadline=0.2, robots=["robot1", "robot2"])
THERE = a_task("h", latency=LatencyRule(topic="/cmd", on=CheckLocation.HOST), only=["edge2"])
TASKS = some_tasks(METRIC, TOPIC, THERE, a_task("plain"))


def count(*values: float, **fields: Any) -> dict[str, Any]:
    buckets = sketch.merge_buckets({sketch.find_bucket(value): 1} for value in values)
    named = {str(bucket): number for bucket, number in buckets.items()}
    found = {"count": len(values), "buckets": named, "recent": named, "recent_s": 60.0, "age_s": 1.0}
    return {**found, "sum_ms": sum(values), "recent_max_ms": max(values, default=0.0), **fields}


def list_rules(host: str) -> dict[str, dict[str, Any]]:
    rules = encode_latency_rules(FLEET.hosts[host], FLEET, TASKS, {"t": "i7"})
    return {str(rule["task"]): rule for rule in rules}


def test_each_host_counts_what_it_can_see() -> None:
    assert {name: sorted(list_rules(name)) for name in FLEET.hosts} == {
        "edge1": ["m"],
        "edge2": ["h"],
        "robot1": ["t"],
        "robot2": ["t"],
    }
    assert list_rules("edge1")["m"] == {"task": "m", "metric": "age_ms", "bound_ms": 100.0}
    rule = list_rules("robot1")["t"]
    assert (rule["topic"], rule["instance"], rule["here"], rule["bound_ms"]) == ("/cmd", "i7", False, 200.0)
    assert rule["ros"]["version"] == 2
    assert rule["env"]["ROS_DOMAIN_ID"] == "7"
    assert list_rules("edge2")["h"]["here"]


def test_counts_of_robots_are_those_of_the_task_on_its_host() -> None:
    run = TaskSample(state=TaskState.READY)
    samples = {
        "edge1": a_sample(tasks={"t": run, "m": run, "plain": run}),
        "robot1": a_sample(),
        "robot2": a_sample(),
    }
    replies = {
        "edge1": decode_latencies({"latencies": {"m": count(10.0, 20.0), "plain": count(1.0)}}),
        "robot1": decode_latencies({"latencies": {"t": count(*[100.0] * 99, misses=1)}}),
        "robot2": decode_latencies({"latencies": {"t": count(400.0, misses=2, error="deaf")}}),
    }
    tasks = join_latencies(samples, replies, TASKS)["edge1"].tasks
    merged, own = tasks["t"].latency, tasks["m"].latency
    assert merged is not None
    assert own is not None
    assert (merged.count, merged.misses, merged.bound_ms, merged.max_ms) == (100, 3, 200.0, 400.0)
    assert merged.error == "deaf"
    assert merged.p50_ms == pytest.approx(100.0, rel=0.01)
    assert merged.p99_ms == pytest.approx(100.0, rel=0.01)
    assert (own.count, own.sum_ms) == (2, 30.0)
    assert tasks["plain"].latency is None, "a task without a rule has none, whatever its host says"


@pytest.mark.parametrize(
    "damage",
    [{"count": -1}, {"buckets": {"x": 1}}, {"buckets": {str(sketch.BUCKETS): 1}}, {"recent": {"-1": 1}}, {"recent": 3}, {"sum_ms": "NaN"}],
)  # fmt: skip
def test_counts_that_no_agent_sends_are_left_out(damage: dict[str, Any]) -> None:
    assert decode_latencies({"latencies": {"m": count(1.0, **damage), "t": count(2.0)}}).keys() == {"t"}
