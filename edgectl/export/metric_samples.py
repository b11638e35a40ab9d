# SPDX-License-Identifier: Apache-2.0
"""Samples of each metric: label values and a number. Pure."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from edgectl.agent.link import sketch
from edgectl.model.assignment import Verdict
from edgectl.model.inventory import Role
from edgectl.model.latency import LatencySample
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.resource import Resource
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.revision import Revision
from edgectl.model.snapshot import (
    HostSample,
    LinkSample,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
)

BUCKETS_S = (0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0)
LATENCY_BOUNDS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
# States of a task that no host reports: it is not running, or was on a host that is unreachable now.
STOPPED, UNKNOWN = "stopped", "unknown"
TASK_STATES = (*(state.value for state in TaskState), STOPPED, UNKNOWN)
_CHANGING_ACTIONS = tuple(action for action in Action if action.changes)
_HANDOFF_ACTIONS = (Action.MOVE, Action.RESTART)


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricsInput:
    """Input of the metrics: a snapshot, its plan, and all earlier revisions, oldest first."""

    version: str
    snapshot: Snapshot
    plan: Plan
    revisions: tuple[Revision, ...] = ()

    @property
    def actions(self) -> Iterator[ActionResult]:
        """All actions of the revisions."""
        return (action for revision in self.revisions for action in revision.actions)


@dataclass(frozen=True, slots=True, kw_only=True)
class Histogram:
    """A histogram: number of values up to each of ``bounds`` (s), their total number, and their sum (s)."""

    counts: tuple[int, ...]
    count: int
    total: float
    bounds: tuple[float, ...] = BUCKETS_S


MetricSample = tuple[tuple[str, ...], float | Histogram | None]
Sampler = Callable[[MetricsInput], Iterable[MetricSample]]


def sample_fleet(read: Callable[[MetricsInput], float | None]) -> Sampler:
    """One sample without labels."""
    return lambda picture: [((), read(picture))]


def sample_hosts(read: Callable[[HostSample], float | None]) -> Sampler:
    """One sample per host that answered."""
    return lambda picture: [((name,), read(host)) for name, host in picture.snapshot.hosts.items() if host.ok]


def sample_host_usage(resource: Resource, read: Callable[[ResourceUsage], float]) -> Sampler:
    """One sample per host where ``resource`` is measured."""
    return sample_hosts(lambda host: read(host.usage[resource.name]) if resource.name in host.usage else None)


def sample_host_up(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per host: whether it answered."""
    return [((name, host.role.value), float(host.ok)) for name, host in picture.snapshot.hosts.items()]


def sample_operator_mark(read: Callable[[ManagerState], frozenset[str]]) -> Sampler:
    """One sample per host: whether the operator set the mark."""
    return lambda picture: [
        ((name,), float(name in read(_get_manager_state(picture)))) for name in picture.snapshot.hosts
    ]


def sample_contacts(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per host with a heartbeat: its time."""
    return [((name,), _get_manager_state(picture).contact.get(name)) for name in picture.snapshot.hosts]


def _get_manager_state(picture: MetricsInput) -> ManagerState:
    return picture.snapshot.manager or ManagerState()


def sample_traffic(read: Callable[[HostSample], Iterable[float]]) -> Sampler:
    """One sample per host that reports its interfaces: their sum."""
    return sample_hosts(lambda host: sum(read(host)) if host.device.interfaces else None)


def list_receive_rates(host: HostSample) -> Iterable[float]:
    """Bytes/s in, by interface."""
    return (each.rx_bytes_per_s for name, each in host.device.interfaces.items() if name != "lo")


def list_transmit_rates(host: HostSample) -> Iterable[float]:
    """Bytes/s out, by interface."""
    return (each.tx_bytes_per_s for name, each in host.device.interfaces.items() if name != "lo")


def sample_links(read: Callable[[LinkSample], float | None]) -> Sampler:
    """One sample per edge and robot."""
    return lambda picture: [
        ((edge, robot), read(link))
        for edge, host in picture.snapshot.hosts.items()
        if host.role is Role.EDGE
        for robot, link in host.links.items()
    ]


def sample_running_tasks(read: Callable[[TaskSample], float | None]) -> Sampler:
    """One sample per task and host where it runs."""
    return lambda picture: [
        ((task, name), read(sample))
        for name, host in picture.snapshot.hosts.items()
        for task, sample in host.tasks.items()
        if sample.state.alive
    ]


def sample_standbys(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per inactive copy: whether it can be activated."""
    ready = (TaskState.READY, TaskState.RUNNING)
    for name, host in picture.snapshot.hosts.items():
        yield from (((task, name), float(copy.state in ready)) for task, copy in host.standbys.items())


def sample_app_metrics(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per application metric of each running task."""
    for host, found in picture.snapshot.hosts.items():
        for task, sample in found.tasks.items():
            yield from (
                ((task, host, name), value) for name, value in sample.metrics.items() if sample.state.alive
            )


def sample_latencies(picture: MetricsInput) -> Iterable[MetricSample]:
    """One histogram per running task whose latency is read: all its values."""
    return [
        ((task, host), _build_latency_histogram(latency)) for task, host, latency in _list_latencies(picture)
    ]


def sample_recent_latencies(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per percentile of the latency of each running task."""
    for task, host, latency in _list_latencies(picture):
        for percent, value in (("50", latency.p50_ms), ("95", latency.p95_ms), ("99", latency.p99_ms)):
            yield (task, host, percent), None if value is None else value / 1000.0


def count_misses(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per running task with a deadline: its misses."""
    for task, host, latency in _list_latencies(picture):
        yield (task, host), None if latency.bound_ms is None else float(latency.misses)


def _list_latencies(picture: MetricsInput) -> Iterator[tuple[str, str, LatencySample]]:
    for host, found in picture.snapshot.hosts.items():
        for task, sample in found.tasks.items():
            if sample.state.alive and sample.latency is not None and not sample.latency.error:
                yield task, host, sample.latency


def _build_latency_histogram(latency: LatencySample) -> Histogram:
    """Up to each bound count the values of its bucket and of those below: up to 2 % above it, none less."""
    buckets = [(int(bucket), count) for bucket, count in latency.buckets.items()]
    ends = [sketch.find_bucket(bound * 1000.0) for bound in LATENCY_BOUNDS_S]
    return Histogram(
        counts=tuple(sum(count for bucket, count in buckets if bucket <= end) for end in ends),
        count=latency.count,
        total=latency.sum_ms / 1000.0,
        bounds=LATENCY_BOUNDS_S,
    )


def sample_task_states(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per task and state: 1 for its present state."""
    for step in picture.plan.steps:
        now = _find_task_state(step, picture.snapshot)
        yield from (((step.task, state), float(state == now)) for state in TASK_STATES)


def _find_task_state(step: Step, snapshot: Snapshot) -> str:
    """State of a task: by the host where it runs; else by any host; else by the manager's state."""
    found = [host.tasks[step.task].state for host in snapshot.hosts.values() if step.task in host.tasks]
    if found:
        return max(found, key=lambda state: state.alive).value
    if step.decision.verdict is Verdict.COMPLETED:
        return TaskState.COMPLETED.value
    last = snapshot.hosts.get(step.decision.previous_host or step.decision.host or "")
    silent = step.action is Action.HOLD and last is not None and not last.ok
    return UNKNOWN if silent else STOPPED


def sample_steps(read: Callable[[Step], float | None]) -> Sampler:
    """One sample per task of the plan."""
    return lambda picture: [((step.task,), read(step)) for step in picture.plan.steps]


def sample_pins(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per task that an operator has pinned: whether that counts now."""
    for step in picture.plan.steps:
        pin = step.decision.pin
        if pin is not None:
            yield (step.task, pin.host), float(pin.set_aside is None)


def count_planned_actions(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per action: the number of tasks of the plan with it."""
    return [((action.value,), float(picture.plan.summary.get(action, 0))) for action in Action]


def count_finished_actions(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per action and outcome: their number."""
    counts = dict.fromkeys(((action, outcome) for action in _CHANGING_ACTIONS for outcome in Outcome), 0)
    for action in picture.actions:
        if (action.action, action.outcome) in counts:
            counts[action.action, action.outcome] += 1
    return [((action.value, outcome.value), float(count)) for (action, outcome), count in counts.items()]


def count_moves(picture: MetricsInput) -> Iterable[MetricSample]:
    """One sample per task of the plan: its number of moves."""
    counts = dict.fromkeys((step.task for step in picture.plan.steps), 0)
    for action in picture.actions:
        if action.action is Action.MOVE and action.outcome is Outcome.DONE and action.task in counts:
            counts[action.task] += 1
    return [((task,), float(count)) for task, count in counts.items()]


def sample_downtimes(picture: MetricsInput) -> Iterable[MetricSample]:
    """One histogram per kind of handoff: its measured downtimes."""
    measured: Mapping[Action, list[float]] = {action: [] for action in _HANDOFF_ACTIONS}
    for action in picture.actions:
        if action.action in measured and action.downtime_s is not None:
            measured[action.action].append(action.downtime_s)
    return [((action.value,), _build_histogram(values)) for action, values in measured.items()]


def _build_histogram(values: list[float]) -> Histogram:
    return Histogram(
        counts=tuple(sum(value <= bound for value in values) for bound in BUCKETS_S),
        count=len(values),
        total=float(sum(values)),
    )


def find_last_change(picture: MetricsInput) -> float | None:
    """Start of the newest revision; None before the first."""
    return picture.revisions[-1].began_at if picture.revisions else None
