# SPDX-License-Identifier: Apache-2.0
"""Meter of the tasks of one host.

A module of its own: a host on which no task ever ran has nothing to measure by ``task.py``, and its code,
with that of the records of tasks, is a quarter of a probe's.
"""

from ..link.fast_json import Document
from ..supervise import state_dir

TYPE_CHECKING = False
if TYPE_CHECKING:
    from . import proc
    from .counters import Rates
    from .network import Flow
    from .task import TaskProcesses


class Traffic:
    """What was seen on this host in a window: connections, UDP sockets (``UdpMeter.find_sockets``), addresses
    by robot, and byte counters where there are any.
    """

    __slots__ = ("addresses", "counted", "flows", "udp")

    def __init__(
        self,
        flows: "list[Flow]",
        udp: "dict[int, str]",
        addresses: "dict[str, list[str]]",
        counted: "Rates | None" = None,
    ) -> None:
        self.flows, self.udp, self.addresses, self.counted = flows, udp, addresses, counted


class TaskMeter:
    """Meter of the tasks of one host since its creation or its last measurement."""

    def __init__(self, host: str, detect: "list[Document]") -> None:
        self.host, self.detect = host, detect
        # Whether a task may run here now; where none does, nothing has to be known of connections.
        self.may_live = False
        # CPU seconds by pid, of each task.
        self.before: "dict[str, dict[int, float]]" = {}
        self._find_groups()

    def _find_groups(self) -> "list[tuple[dict[int, proc.Process], str, TaskProcesses, dict[int, float]]]":
        """Find (process table, task, its processes, their CPU seconds before); those of now replace them."""
        then, self.before, self.may_live = self.before, {}, False
        names = state_dir.list_task_names(self.host)
        if not names and not self.detect:
            return []
        from . import proc, task

        self.may_live = bool(self.detect) or task.may_any_live(self.host, names)
        table = proc.read_process_table() if self.may_live else {}
        groups = sorted(task.find_tasks(self.host, names, self.detect, table).items())
        self.before = {name: task.collect_cpu_s(group, table) for name, group in groups}
        return [(table, name, group, then.get(name, {})) for name, group in groups]

    def measure(self, traffic: Traffic, seconds: float) -> "dict[str, Document]":
        """Measure: task -> entry with rates."""
        found = {}
        for table, name, group, then in self._find_groups():
            from . import task

            found[name] = task.measure_task(group, table, (self.before[name], then), traffic, seconds)
        return found
