# SPDX-License-Identifier: Apache-2.0
"""Definition of every metric: name, help, labels and samples. Pure.

Names follow Prometheus' conventions: base units, the unit at the end of each name, ``_total`` for counters.
Labels are names of the inventory and the task files, and words of closed sets, so the files bound the number
of series. Application metrics are the exception; a task may have at most 32.
"""

from dataclasses import dataclass
from enum import StrEnum

from edgectl.export import metric_samples
from edgectl.export.metric_samples import Histogram, MetricsInput, Sampler
from edgectl.model.plan import Action
from edgectl.model.resource import HOST_RESOURCES, TASK_RESOURCES, Resource


class MetricType(StrEnum):
    """Prometheus type of a metric."""

    GAUGE = "gauge"
    COUNTER = "counter"
    HISTOGRAM = "histogram"


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricDefinition:
    """One metric. ``read`` gives its samples: label values, and a value or None."""

    name: str
    help: str
    read: Sampler
    labels: tuple[str, ...] = ()
    kind: MetricType = MetricType.GAUGE

    def samples(self, picture: MetricsInput) -> tuple[tuple[tuple[str, ...], float | Histogram], ...]:
        """The samples with a value."""
        return tuple((labels, value) for labels, value in self.read(picture) if value is not None)


_HOST_LABELS, _LINK_LABELS, _TASK_LABELS, _RUN_LABELS = (
    ("host",),
    ("edge", "robot"),
    ("task",),
    ("task", "host"),
)


def _define_host_usage(resource: Resource) -> tuple[MetricDefinition, ...]:
    name = f"edgectl_host_{resource.name}"
    return (
        MetricDefinition(
            name=f"{name}_{_get_unit(resource)}",
            help=f"Capacity of the host for {resource.name} (measured or declared, before limits).",
            labels=_HOST_LABELS,
            read=metric_samples.sample_host_usage(resource, lambda usage: usage.capacity),
        ),
        MetricDefinition(
            name=f"{name}_used_{_get_unit(resource)}",
            help=f"Usage of {resource.name} on the host.",
            labels=_HOST_LABELS,
            read=metric_samples.sample_host_usage(resource, lambda usage: usage.used),
        ),
    )


def _define_task_usage(resource: Resource) -> MetricDefinition:
    where = "on the links to its robots" if resource.per_link else "by all of its processes"
    return MetricDefinition(
        name=f"edgectl_task_{resource.name}_used_{_get_unit(resource)}",
        help=f"Usage of {resource.name} of the task, {where}.",
        labels=_RUN_LABELS,
        read=metric_samples.sample_running_tasks(lambda task: task.used[resource.name]),
    )


def _get_unit(resource: Resource) -> str:
    return resource.unit.name.replace("_per_s", "_per_second")


_HOST_USAGE_METRICS = tuple(metric for resource in HOST_RESOURCES for metric in _define_host_usage(resource))
_TASK_USAGE_METRICS = tuple(_define_task_usage(resource) for resource in TASK_RESOURCES)
METRICS = (
    MetricDefinition(
        name="edgectl_build_info",
        help="1; the version of edgectl.",
        labels=("version",),
        read=lambda it: [((it.version,), 1.0)],
    ),
    MetricDefinition(
        name="edgectl_last_probe_timestamp_seconds",
        help="Time of the last probe, by the manager's clock.",
        read=metric_samples.sample_fleet(lambda it: it.snapshot.taken_at),
    ),
    MetricDefinition(
        name="edgectl_host_up",
        help="1 if the host answered, else 0.",
        labels=("host", "role"),
        read=metric_samples.sample_host_up,
    ),
    MetricDefinition(
        name="edgectl_host_cordoned",
        help="1 if the host is cordoned.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_operator_mark(lambda manager: manager.cordons),
    ),
    MetricDefinition(
        name="edgectl_host_fenced",
        help="1 if the operator declared the host powered off.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_operator_mark(lambda manager: manager.fenced),
    ),
    MetricDefinition(
        name="edgectl_host_last_contact_timestamp_seconds",
        help="Time of the last heartbeat of the host, by the manager's clock.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_contacts,
    ),
    *_HOST_USAGE_METRICS,
    MetricDefinition(
        name="edgectl_host_network_receive_bytes_per_second",
        help="Bytes received, over all interfaces but loopback.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_traffic(metric_samples.list_receive_rates),
    ),
    MetricDefinition(
        name="edgectl_host_network_transmit_bytes_per_second",
        help="Bytes sent, over all interfaces but loopback.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_traffic(metric_samples.list_transmit_rates),
    ),
    MetricDefinition(
        name="edgectl_host_gpu_used_ratio",
        help="Share of the GPU in use, where the host reports it.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_hosts(lambda host: host.device.gpu_share),
    ),
    MetricDefinition(
        name="edgectl_host_temperature_celsius",
        help="Temperature, where the host reports it.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_hosts(lambda host: host.device.temperature_c),
    ),
    MetricDefinition(
        name="edgectl_host_draw_watts",
        help="Power that the host draws, where its sensors tell.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_hosts(lambda host: host.device.power_w),
    ),
    MetricDefinition(
        name="edgectl_host_clock_skew_seconds",
        help="Offset of the host's clock from the manager's, where known.",
        labels=_HOST_LABELS,
        read=metric_samples.sample_hosts(lambda host: host.device.clock_skew_s),
    ),
    MetricDefinition(
        name="edgectl_link_capacity_bytes_per_second",
        help="Capacity of the link between an edge and a robot.",
        labels=_LINK_LABELS,
        read=metric_samples.sample_links(lambda link: link.capacity_bytes_per_s),
    ),
    MetricDefinition(
        name="edgectl_link_used_bytes_per_second",
        help="Traffic of the link, in plus out.",
        labels=_LINK_LABELS,
        read=metric_samples.sample_links(lambda link: link.used_bytes_per_s),
    ),
    MetricDefinition(
        name="edgectl_link_round_trip_seconds",
        help="Round-trip time of the link, where measured.",
        labels=_LINK_LABELS,
        read=metric_samples.sample_links(lambda link: None if link.rtt_ms is None else link.rtt_ms / 1000),
    ),
    MetricDefinition(
        name="edgectl_task_state",
        help="1 for the state of the task, 0 for the others.",
        labels=("task", "state"),
        read=metric_samples.sample_task_states,
    ),
    MetricDefinition(
        name="edgectl_task_host_info",
        help="1 for each host on which the task runs.",
        labels=_RUN_LABELS,
        read=metric_samples.sample_running_tasks(lambda _: 1.0),
    ),
    MetricDefinition(
        name="edgectl_task_standby_ready",
        help="1 for each host with an inactive copy of the task that can be activated, 0 while it cannot.",
        labels=_RUN_LABELS,
        read=metric_samples.sample_standbys,
    ),
    MetricDefinition(
        name="edgectl_task_start_timestamp_seconds",
        help="Start of the running instance, by the manager's clock.",
        labels=_RUN_LABELS,
        read=metric_samples.sample_running_tasks(lambda task: task.started_at or None),
    ),
    MetricDefinition(
        name="edgectl_task_restarts_total",
        help="Restarts of the running instance by its supervisor.",
        labels=_RUN_LABELS,
        kind=MetricType.COUNTER,
        read=metric_samples.sample_running_tasks(lambda task: float(task.restarts)),
    ),
    *_TASK_USAGE_METRICS,
    MetricDefinition(
        name="edgectl_task_app_metric",
        help="Last value of a metric that the application wrote.",
        labels=(*_RUN_LABELS, "name"),
        read=metric_samples.sample_app_metrics,
    ),
    MetricDefinition(
        name="edgectl_task_latency_seconds",
        help="Latency of the running instance, all its values; a bound counts values up to 2 % above it.",
        labels=_RUN_LABELS,
        kind=MetricType.HISTOGRAM,
        read=metric_samples.sample_latencies,
    ),
    MetricDefinition(
        name="edgectl_task_latency_recent_seconds",
        help="Percentile of the latency over the last one to two minutes.",
        labels=(*_RUN_LABELS, "percentile"),
        read=metric_samples.sample_recent_latencies,
    ),
    MetricDefinition(
        name="edgectl_task_latency_misses_total",
        help="Latencies of the running instance above the deadline of the task.",
        labels=_RUN_LABELS,
        kind=MetricType.COUNTER,
        read=metric_samples.count_misses,
    ),
    MetricDefinition(
        name="edgectl_task_utility",
        help="Total utility of the host chosen for the task, at most 1.",
        labels=_TASK_LABELS,
        read=metric_samples.sample_steps(lambda step: step.decision.total),
    ),
    MetricDefinition(
        name="edgectl_task_utility_lead",
        help="Total utility of the chosen host minus that of the best other feasible one.",
        labels=_TASK_LABELS,
        read=metric_samples.sample_steps(lambda step: step.decision.lead),
    ),
    MetricDefinition(
        name="edgectl_task_unplaced",
        help="1 if no host fits the task.",
        labels=_TASK_LABELS,
        read=metric_samples.sample_steps(lambda step: float(step.action is Action.UNPLACED)),
    ),
    MetricDefinition(
        name="edgectl_task_pinned",
        help="1 while the pin of edgectl move holds the task to the host, 0 while it is set aside.",
        labels=_RUN_LABELS,
        read=metric_samples.sample_pins,
    ),
    MetricDefinition(
        name="edgectl_plan_actions",
        help="Number of tasks that an apply would now start, stop, move, keep and so on.",
        labels=("action",),
        read=metric_samples.count_planned_actions,
    ),
    MetricDefinition(
        name="edgectl_plan_settled",
        help="1 if the plan is settled.",
        read=metric_samples.sample_fleet(lambda it: float(it.plan.settled)),
    ),
    MetricDefinition(
        name="edgectl_actions_total",
        help="Actions of all applies, by outcome.",
        labels=("action", "outcome"),
        kind=MetricType.COUNTER,
        read=metric_samples.count_finished_actions,
    ),
    MetricDefinition(
        name="edgectl_task_moves_total",
        help="Completed moves of the task.",
        labels=_TASK_LABELS,
        kind=MetricType.COUNTER,
        read=metric_samples.count_moves,
    ),
    MetricDefinition(
        name="edgectl_handoff_downtime_seconds",
        help="From the stop of the old instance to the readiness of the new one.",
        labels=("action",),
        kind=MetricType.HISTOGRAM,
        read=metric_samples.sample_downtimes,
    ),
    MetricDefinition(
        name="edgectl_last_change_timestamp_seconds",
        help="Time of the last change of the fleet by apply, stop, restart, drain or rollback.",
        read=metric_samples.sample_fleet(metric_samples.find_last_change),
    ),
)
