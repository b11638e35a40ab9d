# SPDX-License-Identifier: Apache-2.0
"""Check of the traffic between an edge and the robots: whether all of it is seen."""

from edgectl.model.diagnosis import Finding, Severity
from edgectl.model.snapshot import COUNTERS_INSTALLED, HostSample, Snapshot, TrafficSource


def diagnose_traffic(host: str, snapshot: Snapshot | None) -> list[Finding]:
    """At most one finding for the links of an edge: how all of their traffic is counted, or why it is not."""
    sample = None if snapshot is None else snapshot.hosts.get(host)
    if sample is None or not sample.links:
        return []
    if sample.counters == COUNTERS_INSTALLED:
        return [_diagnose_counted(host, sample)]
    if sample.counters:
        message = f"its byte counters cannot be read: {sample.counters}"
        return [_build_finding(host, message, f"edgectl counters install {host}")]
    return _diagnose_uncounted(host, sample)


def _build_finding(host: str, message: str, remedy: str = "") -> Finding:
    level = Severity.WARNING if remedy else Severity.OK
    return Finding(host=host, check="traffic", level=level, message=message, remedy=remedy)


def _diagnose_counted(host: str, sample: HostSample) -> Finding:
    uncounted = [robot for robot, link in sample.links.items() if link.used_source is TrafficSource.TCP]
    if uncounted:
        message = f"no byte counter for the present address of {', '.join(uncounted)}"
        return _build_finding(host, message, f"edgectl counters install {host}")
    tasks = _list_partial_tasks(sample)
    shown = f"; of {', '.join(tasks)} by link only, in no control group of their own" if tasks else ""
    return _build_finding(host, f"byte counters of {', '.join(sample.links)}{shown}")


def _diagnose_uncounted(host: str, sample: HostSample) -> list[Finding]:
    gaps = {robot: link.partial for robot, link in sample.links.items() if link.partial}
    if not gaps:
        return []
    tasks = _list_partial_tasks(sample)
    shown = f" of {', '.join(tasks)}" if tasks else ""
    message = f"partial: {next(iter(gaps.values()))}{shown} to {', '.join(gaps)}; the declared demand stands"
    remedy = f"edgectl counters install {host}; or declare demand: {{throughput: ..}} in the task file"
    return [_build_finding(host, message, remedy)]


def _list_partial_tasks(sample: HostSample) -> list[str]:
    return [name for name, task in sample.tasks.items() if task.partial and task.state.alive]
