# SPDX-License-Identifier: Apache-2.0
"""Counters of this host since boot and of its tasks since their start: means over any time are from them."""

from ..link.fast_json import Document
from ..supervise import state_dir, status
from . import device, interfaces, proc, task

_LOOPBACK = "lo"


def read_totals(host: str) -> Document:
    """Read the CPU seconds of this host (of its control group where that is limited) and the bytes over its
    interfaces, both since boot, and the CPU seconds of each instance of a task (``tasks``), alive or not.
    """
    counters = interfaces.read_interface_bytes()
    return {
        "cpu_s": round(device.CpuMeter().start[1], 4),
        "network_bytes": sum(
            received + sent for name, (received, sent) in counters.items() if name != _LOOPBACK
        ),
        "tasks": _read_task_cpu_s(host),
    }


def _read_task_cpu_s(host: str) -> "dict[str, float]":
    """Read instance -> CPU seconds: of its processes while it lives, then what its supervisor recorded."""
    names, found = state_dir.list_task_names(host), {}
    table = proc.read_process_table()
    for name in names:
        record, _ = status.find_current(host, name, table)
        if record is not None and record.instance and "cpu_s" in record.status:
            found[str(record.instance["instance"])] = float(record.status["cpu_s"])
    for group in task.find_tasks(host, names, [], table).values():
        if group.pids:
            found[str(group.entry["instance"])] = round(sum(task.collect_cpu_s(group, table).values()), 4)
    return found
