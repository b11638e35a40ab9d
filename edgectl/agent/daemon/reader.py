# SPDX-License-Identifier: Apache-2.0
"""Measurements from the resident profiler: its smoothed rates, everything else as it is now.

No sample window passes.
"""

from ..link import protocol
from ..link.fast_json import Document
from ..measure import device, interfaces, network, proc, task
from ..measure.udp import find_sockets
from ..supervise import state_dir, status
from . import pidfile, process_tracker

# Age in periods up to which a sample is recent.
MAX_AGE_PERIODS = 3.0


def read_measurements(request: Document) -> "Document | None":
    """Read the measured part of a reply, with ``sample_at`` (s since boot) besides.

    None without a living profiler with this probe spec and a recent sample.
    """
    profiler = pidfile.find_profiler(request["host"])
    if profiler is None:
        return None
    description, _, sample = profiler.read()
    if not sample or description.get("probe_spec") != pidfile.build_probe_spec(request):
        return None
    age = proc.read_uptime_s() - sample["at"]
    return (
        _build_measurements(request, sample, age)
        if 0.0 <= age < MAX_AGE_PERIODS * sample["period_s"]
        else None
    )


def _build_measurements(request: Document, sample: Document, age: float) -> Document:
    rates, levels = sample["rates"], sample["levels"]
    now = _collect_tasks(request, sample)
    alive = [rate for entry, rate in now.values() if entry["state"] in protocol.ALIVE_STATES]
    used = max(0.0, rates["cpu"]) + sum(max(0.0, rate["used_cores"]) for rate in alive)
    return {
        "resident": True,
        "sample_at": sample["at"],
        "sample_age_s": round(age, 3),
        "psutil": False,
        "window_s": 0.0,
        "cpu": {"cores": levels["cores"], "used_cores": round(min(levels["cores"], used), 4)},
        "memory": device.read_memory(),
        "temperature_c": levels["temperature_c"],
        **levels["hardware"],
        "interfaces": {
            name: interfaces.build_interface_entry(
                rate, levels["speeds"].get(name), levels["wireless"].get(name)
            )
            for name, rate in rates["interfaces"].items()
        },
        "links": {
            robot: _build_link_entry(robot, rate, levels, alive) for robot, rate in rates["links"].items()
        },
        "counters": levels["counters"],
        "peers": levels["peers"],
        "tasks": {name: dict(entry, **_build_task_rates(rate)) for name, (entry, rate) in now.items()},
    }


def _build_link_entry(robot: str, rate: Document, levels: Document, alive: "list[Document]") -> Document:
    """Build the entry of a link: the traffic of no task, and that of the tasks alive now."""
    own = [each["robots"][robot] for each in alive if robot in each["robots"]]
    return {
        "rx_bytes_per_s": round(max(0.0, rate["rx"]) + sum(each["rx"] for each in own), 1),
        "tx_bytes_per_s": round(max(0.0, rate["tx"]) + sum(each["tx"] for each in own), 1),
        "rtt_ms": None if rate["rtt_ms"] is None else round(rate["rtt_ms"], 3),
        "interface": levels["routes"][robot],
        "reachable": levels["reachable"][robot],
        "carries_bytes_per_s": levels["carries"][robot],
        "radio_bytes_per_s": levels["radios"][robot],
        "partial": levels["partial_links"][robot],
        "other_bytes_per_s": round(max(0.0, rate["other"]), 1),
        "source": levels["sources"][robot],
    }


def _build_task_rates(rate: Document) -> Document:
    return dict(
        task.build_traffic_entry(rate),
        used_cores=round(max(0.0, rate["used_cores"]), 4),
        used_bytes=int(rate["used_bytes"]),
        partial=rate["partial"],
    )


def _collect_tasks(request: Document, sample: Document) -> "dict[str, tuple[Document, Document]]":
    """Collect task -> (entry as it is now, its rates).

    The process table is read only for ``detect`` and for new tasks.
    """
    host, detect = request["host"], request.get("detect", [])
    entries = status.list_entries(host, None)
    if detect or any(
        entry["state"] in protocol.ALIVE_STATES
        and process_tracker.build_run_key(name, entry) not in sample["rates"]["tasks"]
        for name, entry in entries.items()
    ):
        return _scan_tasks(host, detect, sample)
    return {
        name: (entry, _find_sampled_rates(name, entry, sample) or _build_zero_rates())
        for name, entry in sorted(entries.items())
    }


def _scan_tasks(
    host: str, detect: "list[Document]", sample: Document
) -> "dict[str, tuple[Document, Document]]":
    table = proc.read_process_table()
    groups = task.find_tasks(host, state_dir.list_task_names(host), detect, table)
    flows: "list[network.Flow] | None" = None
    found: "dict[str, tuple[Document, Document]]" = {}
    for name, group in sorted(groups.items()):
        rate = _find_sampled_rates(name, group.entry, sample)
        if rate is None and group.pids:
            flows = network.read_flows_since_open(sample["addresses"]) if flows is None else flows
            rate = _measure_since_start(group, table, flows, sample["addresses"])
        found[name] = (group.entry, rate or _build_zero_rates())
    return found


def _find_sampled_rates(name: str, entry: Document, sample: Document) -> "Document | None":
    """Find the smoothed rates of this very run; None where it is too young or has ended."""
    known = process_tracker.build_run_key(name, entry)
    rate = sample["rates"]["tasks"].get(known)
    if rate is None or entry["state"] not in protocol.ALIVE_STATES:
        return None
    levels = sample["levels"]
    return dict(
        rate, used_bytes=levels["bytes"].get(known, 0), partial=levels["partial_tasks"].get(known, "")
    )


def _measure_since_start(
    group: task.TaskProcesses,
    table: "dict[int, proc.Process]",
    flows: "list[network.Flow]",
    addresses: "dict[str, list[str]]",
) -> Document:
    """Measure the average since the start of a task that was started after the last sample."""
    seconds = max(0.1, group.entry["age_s"])
    held = task.list_sockets(group.pids)
    return dict(
        task.compute_traffic(held, flows, addresses, seconds),
        partial=task.describe_gap(held, find_sockets(busy=False), addresses),
        used_cores=task.compute_cores(task.collect_cpu_s(group, table), table, {}, seconds),
        used_bytes=task.read_task_memory(group, table),
    )


def _build_zero_rates() -> Document:
    return {"rx": 0.0, "tx": 0.0, "robots": {}, "used_cores": 0.0, "used_bytes": 0, "partial": ""}
