"""The tasks of a host from sample to sample: known processes each time, the whole process table only when something has changed.

Reading every process of a host costs some ms; those of its tasks are few. The table is read again when a task is started, restarted
or ends (its records say so), and now and then for children that came since and for what ``detect`` wants found.
"""

import os
import time

from . import proc, state, task

WALK_S = 5.0
# Of one core, for walks through a long table.
_WALK_SHARE = 0.0025


def key(name: str, entry: dict) -> str:
    """What names one run of a task: another run starts from nothing."""
    return "%s %s" % (name, entry.get("instance") or entry["pid"])


class Followed:
    """Measures the tasks again and again. The first reading tells their use since they were started."""

    def __init__(self, host: str, detect: list) -> None:
        self.host, self.detect = host, detect
        self.groups, self.then, self.ticks, self.held, self.levels = {}, {}, {}, {}, {}
        self.marks, self.next_walk = None, 0.0

    def reading(self, flows: list, addresses: dict, seconds: float) -> tuple:
        """(rates, bytes) by key of the task, of those that live."""
        table = self._table()
        rates, used = {}, {}
        for name, group in self.groups.items():
            rates[name] = task.traffic(self.held[name], flows, addresses, seconds)
            rates[name]["used_cores"] = task.cores(group, table, self.then.get(name, {}), seconds)
            base, rss = self.levels[name]
            used[name] = max(0, base + _rss(group, table) - rss)
        self.then = {name: task.cpu_s(group, table) for name, group in self.groups.items()}
        return rates, used

    def _table(self) -> dict:
        """The processes that count: known ones, or all of them together with who belongs to whom."""
        names = state.task_names(self.host)
        marks = {name: _mark(self.host, name) for name in names}
        if marks == self.marks and (time.monotonic() < self.next_walk or not (names or self.detect)):
            known = (proc.process(pid) for pid in self.ticks)
            return {
                each.pid: each
                for each in known
                if each is not None and each.ticks == self.ticks[each.pid] and each.state not in "ZX"
            }
        began, self.marks = time.process_time(), marks
        table = self._walk(names)
        self.next_walk = time.monotonic() + max(WALK_S, (time.process_time() - began) / _WALK_SHARE)
        return table

    def _walk(self, names: list) -> dict:
        table = proc.processes() if names or self.detect else {}
        found = task.groups(self.host, names, self.detect, table)
        self.groups = {key(name, group.entry): group for name, group in found.items() if group.pids}
        self.ticks = {
            pid: table[pid].ticks
            for group in self.groups.values()
            for pid in group.pids | {group.above}
            if pid in table
        }
        self.held = {name: task.holdings(group.pids) for name, group in self.groups.items()}
        self.levels = {
            name: (task.memory(group, table), _rss(group, table)) for name, group in self.groups.items()
        }
        return table


def _mark(host: str, name: str) -> tuple:
    """Changes when the task is started, restarted or ends."""
    paths = [
        os.path.join(folder, file)
        for folder in state.task_dirs(host, name)
        for file in ("instance", "status")
    ]
    return tuple(_changed_ns(path) for path in paths)


def _changed_ns(path: str) -> int:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0


def _rss(group, table: dict) -> int:
    return sum(table[pid].rss for pid in group.pids if pid in table)
