# SPDX-License-Identifier: Apache-2.0
"""Tracker of a host's tasks from sample to sample: their known processes each time, the whole process table
only after a change.

Reading every process of a host takes some ms; its tasks have few. The table is read again when a task is
started, restarted or ends (its records change), and at intervals for new children and for tasks to detect.
"""

import os
import time

from ..link.fast_json import Document
from ..measure import network, proc, task
from ..supervise import state_dir

TYPE_CHECKING = False
if TYPE_CHECKING:
    from ..measure.counters import Rates

SCAN_S = 5.0
# Share of one core for scans of a long table.
_SCAN_SHARE = 0.0025


def build_run_key(name: str, entry: Document) -> str:
    """Build the key of one run of a task: another run starts from zero."""
    return "%s %s" % (name, entry.get("instance") or entry["pid"])


class ProcessTracker:
    """Repeated measurement of the tasks. The first one gives their usage since their start."""

    def __init__(self, host: str, detect: "list[Document]") -> None:
        self.host, self.detect = host, detect
        self.groups: "dict[str, task.TaskProcesses]" = {}
        self.then: "dict[str, dict[int, float]]" = {}
        self.ticks: "dict[int, int]" = {}
        self.sockets: "dict[str, set[int]]" = {}
        self.levels: "dict[str, tuple[int, int]]" = {}
        self.marks: "dict[str, tuple[int, ...]] | None" = None
        self.next_scan = 0.0

    def measure(
        self,
        flows: "list[network.Flow]",
        addresses: "dict[str, list[str]]",
        seconds: float,
        counted: "Rates | None",
    ) -> "tuple[dict[str, Document], dict[str, int]]":
        """Measure (rates, bytes) by key of the run, of the living tasks."""
        table = self._read_table()
        rates: "dict[str, Document]" = {}
        used: "dict[str, int]" = {}
        then, self.then = self.then, {}
        for name, group in self.groups.items():
            now = self.then[name] = task.collect_cpu_s(group, table)
            rates[name] = task.compute_traffic(
                self.sockets[name], flows, addresses, seconds, self._find_group(name, counted)
            )
            rates[name]["used_cores"] = task.compute_cores(now, table, then.get(name, {}), seconds)
            base, rss = self.levels[name]
            used[name] = max(0, base + _sum_rss(group, table) - rss)
        return rates, used

    def describe_gaps(
        self, udp: "dict[int, str]", addresses: "dict[str, list[str]]", counted: "Rates | None"
    ) -> "dict[str, str]":
        """Describe what of the traffic is not seen, by key of the run, of the tasks last measured."""
        return {
            name: task.describe_gap(held, udp, addresses, counted, self._find_group(name, counted))
            for name, held in self.sockets.items()
        }

    def _find_group(self, name: str, counted: "Rates | None") -> "dict[str, Document] | None":
        return None if counted is None else counted.find_group(self.groups[name].pids)

    def _read_table(self) -> "dict[int, proc.Process]":
        """Read the relevant processes: the known ones, or all together with their assignment to tasks."""
        names = state_dir.list_task_names(self.host)
        marks = {name: _read_change_marks(self.host, name) for name in names}
        if marks == self.marks and (time.monotonic() < self.next_scan or not (names or self.detect)):
            known = (proc.read_process(pid) for pid in self.ticks)
            return {
                each.pid: each
                for each in known
                if each is not None and each.ticks == self.ticks[each.pid] and each.state not in "ZX"
            }
        began, self.marks = time.process_time(), marks
        table = self._scan(names)
        self.next_scan = time.monotonic() + max(SCAN_S, (time.process_time() - began) / _SCAN_SHARE)
        return table

    def _scan(self, names: "list[str]") -> "dict[int, proc.Process]":
        table = proc.read_process_table() if names or self.detect else {}
        found = task.find_tasks(self.host, names, self.detect, table)
        self.groups = {build_run_key(name, group.entry): group for name, group in found.items() if group.pids}
        self.ticks = {
            pid: table[pid].ticks
            for group in self.groups.values()
            for pid in group.pids | {group.above}
            if pid in table
        }
        self.sockets = {name: task.list_sockets(group.pids) for name, group in self.groups.items()}
        self.levels = {
            name: (task.read_task_memory(group, table), _sum_rss(group, table))
            for name, group in self.groups.items()
        }
        return table


def _read_change_marks(host: str, name: str) -> "tuple[int, ...]":
    """Read marks that change when the task is started, restarted or ends."""
    paths = [
        os.path.join(folder, file)
        for folder in state_dir.find_task_dirs(host, name)
        for file in ("instance", "status")
    ]
    return tuple(_read_mtime_ns(path) for path in paths)


def _read_mtime_ns(path: str) -> int:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0


def _sum_rss(group: task.TaskProcesses, table: "dict[int, proc.Process]") -> int:
    return sum(table[pid].rss for pid in group.pids if pid in table)
