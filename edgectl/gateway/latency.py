# SPDX-License-Identifier: Apache-2.0
"""Latency of tasks in probes: the rules in a request, and the counts in the replies joined to the samples."""

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import field
from typing import Annotated

from edgectl.agent.link import sketch
from edgectl.dataclass import dataclass
from edgectl.gateway.replies import ALONE, Amount, Count, ReplyDocument, decode_reply
from edgectl.model.check import CheckLocation
from edgectl.model.inventory import Host, Inventory
from edgectl.model.latency import LatencyRule, LatencySample
from edgectl.model.reported import Age, Text
from edgectl.model.snapshot import HostSample
from edgectl.model.task import Task, Tasks
from edgectl.rules.environment import drop_secrets, merge_environment
from edgectl.rules.ros import encode_ros


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyReply:
    """Counts of the values (ms) of one task, as ``model.latency.LatencySample``."""

    count: Count = 0
    misses: Count = 0
    sum_ms: Amount = 0.0
    age_s: Age | None = None
    buckets: Mapping[Text, Count] = field(default_factory=dict)
    recent: Mapping[Text, Count] = field(default_factory=dict)
    recent_s: Age = 0.0
    recent_misses: Count = 0
    recent_max_ms: Amount = 0.0
    error: Text = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class _LatencyReplies:
    latencies: Annotated[Mapping[Text, LatencyReply], ALONE] = field(default_factory=dict)


# Counts by task, as one host replied them.
Latencies = Mapping[str, LatencyReply]


def encode_latency_rules(
    host: Host, inventory: Inventory, tasks: Tasks, placed: Mapping[str, str]
) -> list[dict[str, object]]:
    """What ``host`` is to count; ``placed``: the instance of each task as far as it is known.

    The counts of a topic begin anew with a new instance; those of a metric belong to the instance anyway.
    """
    return [
        _encode_rule(task, task.latency, host, inventory, placed.get(task.name, ""))
        for task in tasks.tasks.values()
        if task.latency is not None and _is_counted_on(task, task.latency, host)
    ]


def _is_counted_on(task: Task, rule: LatencyRule, host: Host) -> bool:
    """Whether the values come up on this host: its robots have those of a topic, any host those of a task."""
    if rule.topic and rule.on is CheckLocation.ROBOT:
        return host.name in task.robots
    return host.name in task.robots if host.onboard else task.hosts.allow(host.name, host.labels)


def _encode_rule(
    task: Task, rule: LatencyRule, host: Host, inventory: Inventory, instance: str
) -> dict[str, object]:
    bound = None if task.deadline is None else task.deadline * 1000.0
    if rule.metric:
        return {"task": task.name, "metric": rule.metric, "bound_ms": bound}
    return {
        "task": task.name,
        "topic": rule.topic,
        "bound_ms": bound,
        "instance": instance,
        "here": rule.on is CheckLocation.HOST,
        "ros": encode_ros(task, host, inventory.hosts),
        "env": drop_secrets(merge_environment(task, host, inventory.hosts)),
    }


def decode_latencies(document: ReplyDocument) -> Latencies:
    """The counts of one reply by task.

    Raises:
        ReplyError: they are no mapping.
    """
    counts = document.get("latencies")
    if not counts:
        return {}
    found = decode_reply(_LatencyReplies, {"latencies": counts}).latencies
    return {task: reply for task, reply in found.items() if _has_buckets(reply)}


def _has_buckets(reply: LatencyReply) -> bool:
    names = {*reply.buckets, *reply.recent}
    return all(name.isdecimal() and name.isascii() and int(name) < sketch.BUCKETS for name in names)


def join_latencies(
    samples: Mapping[str, HostSample], replies: Mapping[str, Latencies], tasks: Tasks
) -> dict[str, HostSample]:
    """``samples`` with the latency of each task that states one, from its host or from its robots."""
    stated = {name: task for name, task in tasks.tasks.items() if task.latency is not None}
    if not stated:
        return dict(samples)
    return {host: _join_host(host, sample, replies, stated) for host, sample in samples.items()}


def _join_host(
    host: str, sample: HostSample, replies: Mapping[str, Latencies], stated: Mapping[str, Task]
) -> HostSample:
    found = {
        name: latency
        for name in sample.tasks
        if name in stated and (latency := _find_latency(stated[name], host, replies)) is not None
    }
    changed = {name: dataclasses.replace(sample.tasks[name], latency=each) for name, each in found.items()}
    return dataclasses.replace(sample, tasks={**sample.tasks, **changed}) if changed else sample


def _find_latency(task: Task, host: str, replies: Mapping[str, Latencies]) -> LatencySample | None:
    rule = task.latency
    on_robot = rule is not None and rule.topic and rule.on is CheckLocation.ROBOT
    places = task.robots if on_robot else (host,)
    found = [replies[place][task.name] for place in places if task.name in replies.get(place, {})]
    bound = None if task.deadline is None else task.deadline * 1000.0
    return _build_sample(found, bound) if found else None


def _build_sample(replies: Iterable[LatencyReply], bound_ms: float | None) -> LatencySample:
    """One sample of the counts of one or more robots."""
    listed = list(replies)
    recent = _merge(each.recent for each in listed)
    count = sum(recent.values())
    return LatencySample(
        count=sum(each.count for each in listed),
        misses=sum(each.misses for each in listed),
        sum_ms=sum(each.sum_ms for each in listed),
        bound_ms=bound_ms,
        recent_s=max(each.recent_s for each in listed),
        recent_count=count,
        recent_misses=sum(each.recent_misses for each in listed),
        p50_ms=sketch.find_quantile(recent, 0.50),
        p95_ms=sketch.find_quantile(recent, 0.95),
        p99_ms=sketch.find_quantile(recent, 0.99),
        max_ms=max(each.recent_max_ms for each in listed) if count else None,
        age_s=min((each.age_s for each in listed if each.age_s is not None), default=None),
        buckets=_encode(_merge(each.buckets for each in listed)),
        recent=_encode(recent),
        error=next((each.error for each in listed if each.error), ""),
    )


def _merge(sketches: Iterable[Mapping[str, int]]) -> dict[int, int]:
    return sketch.merge_buckets({int(bucket): count for bucket, count in each.items()} for each in sketches)


def _encode(buckets: Mapping[int, int]) -> dict[str, int]:
    return {str(bucket): buckets[bucket] for bucket in sorted(buckets)}
