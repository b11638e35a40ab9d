# SPDX-License-Identifier: Apache-2.0
"""Task profiler: state, CPU, memory and traffic of each task's process tree, and detection of unmanaged
tasks.
"""

from ..link import protocol
from ..link.fast_json import Document
from ..supervise import liveness, lockfile, state_dir, status
from . import cgroup_usage, detection, proc, system_files

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Iterable

    from .counters import Rates
    from .network import Flow
    from .task_meter import Traffic

# Up to this size the kernel sums up the pages of a process (PSS) within a few ms.
_MAX_PSS_BYTES = 1 << 30


class TaskProcesses:
    """The processes of one task: ``pids`` its own, ``above`` its supervisor (0: none).

    ``entry`` its entry in a reply, without rates. ``first``: in a container, whose control group counts, its
    first process; else 0.
    """

    __slots__ = ("above", "entry", "first", "pids")

    def __init__(self, pids: "set[int]", above: int, entry: Document, first: int = 0) -> None:
        self.pids, self.above, self.entry, self.first = pids, above, entry, first


def find_tasks(
    host: str, names: "list[str]", detect: "list[Document]", table: "dict[int, proc.Process]"
) -> "dict[str, TaskProcesses]":
    """Find every task of ``names``, alive or ended, and those that ``detect`` matches in ``table``."""
    found: "dict[str, TaskProcesses]" = {}
    for name in names:
        record, alive = status.find_current(host, name, table)
        entry = liveness.build_entry(record, alive) if record is not None else {}
        if record is not None and entry:
            found[name] = (
                _find_living_processes(record, entry, table) if alive else TaskProcesses(set(), 0, entry)
            )
    found.update(_detect_tasks(detect, table, found))
    return found


def _find_living_processes(
    record: liveness.InstanceRecord, entry: Document, table: "dict[int, proc.Process]"
) -> TaskProcesses:
    if not record.instance.get("image"):
        return TaskProcesses(liveness.find_processes(record, table), liveness.find_supervisor(record), entry)
    from ..containers.record import find_container_processes, read_container

    # What follows the container from outside is the engine's and edgectl's, as a supervisor is.
    first, inside = (
        read_container(record.folder).get("pid", 0),
        find_container_processes(record.folder, table),
    )
    return TaskProcesses(inside, 0, entry, first if first in inside else 0)


def _detect_tasks(
    detect: "list[Document]", table: "dict[int, proc.Process]", own: "dict[str, TaskProcesses]"
) -> "dict[str, TaskProcesses]":
    if not detect:
        return {}
    free = set(table) - detection.find_own_ancestors(table)
    for group in own.values():
        free -= group.pids | {group.above}
    found = {}
    for rule in detect:
        name = str(rule["task"])
        if name in own and own[name].entry["pid"] > 0:
            continue
        pids = {
            pid
            for pid in free
            if detection.is_match(rule, pid, proc.read_cmdline(pid)) and not liveness.has_cookie(pid)
        }
        if pids:
            first = min(pids, key=lambda pid: (table[pid].ticks, pid))
            found[name] = TaskProcesses(
                proc.find_descendants(pids, table) & free, 0, _build_unmanaged_entry(table[first])
            )
    return found


def may_any_live(host: str, names: "list[str]") -> bool:
    """Whether the processes of a task must be searched: to read the table of a busy host takes 4 ms."""
    folders = [folder for name in names for folder in state_dir.find_task_dirs(host, name)]
    return any(liveness.may_live(folder) or lockfile.is_lock_held(folder) for folder in folders)


def measure_task(
    group: TaskProcesses,
    table: "dict[int, proc.Process]",
    times: "tuple[dict[int, float], dict[int, float]]",
    traffic: "Traffic",
    seconds: float,
) -> Document:
    """Measure a task over ``seconds``: its entry with rates.

    ``times``: CPU seconds by pid now and then, as ``collect_cpu_s``.
    """
    held = list_sockets(group.pids) if traffic.flows or traffic.udp else set()
    seen = None if traffic.counted is None else traffic.counted.find_group(group.pids)
    return dict(
        group.entry,
        used_cores=compute_cores(times[0], table, times[1], seconds),
        used_bytes=read_task_memory(group, table),
        partial=describe_gap(held, traffic.udp, traffic.addresses, traffic.counted, seen),
        **build_traffic_entry(compute_traffic(held, traffic.flows, traffic.addresses, seconds, seen)),
    )


def collect_cpu_s(group: TaskProcesses, table: "dict[int, proc.Process]") -> "dict[int, float]":
    """Collect CPU seconds by pid.

    A child's time passes to the process that reaps it, so the sum over the tree only grows. The supervisor's
    own work is not the task's, but it reaps the task's orphans. Of a container its control group counts.
    """
    if group.first in table:
        used = cgroup_usage.read_container_cpu_s(group.first)
        if used >= 0:
            return {group.first: used}
    seconds = {pid: proc.read_cpu_s(table[pid]) + table[pid].child_cpu for pid in group.pids if pid in table}
    if group.above in table:
        seconds[group.above] = table[group.above].child_cpu
    return seconds


def compute_cores(
    now: "dict[int, float]", table: "dict[int, proc.Process]", then: "dict[int, float]", seconds: float
) -> float:
    """Compute the cores in use from ``then`` to ``now`` (CPU seconds by pid), which are ``seconds`` apart.

    A process that is missing in ``then`` counts with the part of its time that falls into the window on
    average.
    """
    used = sum(now.values()) - sum(then.values())
    for pid in set(now) - set(then):
        used -= now[pid] * (1.0 - min(1.0, seconds / max(1e-3, proc.age_s_from_ticks(table[pid].ticks))))
    return round(max(0.0, used) / seconds, 4)


def read_task_memory(group: TaskProcesses, table: "dict[int, proc.Process]") -> int:
    """Read the bytes in use.

    Pages shared by several processes count once where the kernel tells how they are shared (PSS). Of a
    container its control group counts.
    """
    used = cgroup_usage.read_container_memory(group.first) if group.first in table else -1
    if used >= 0:
        return used
    seen = [table[pid] for pid in group.pids if pid in table]
    return sum((_read_pss(each.pid, each.rss) if len(seen) > 1 else 0) or each.rss for each in seen)


def _read_pss(pid: int, rss: int) -> int:
    if rss > _MAX_PSS_BYTES:
        return 0
    for line in system_files.read_file("/proc/%d/smaps_rollup" % pid).splitlines():
        if line.startswith(b"Pss:"):
            return int(line.split()[1]) * 1024
    return 0


def list_sockets(pids: "set[int]") -> "set[int]":
    """List the inodes of the sockets that the processes hold."""
    return {inode for pid in pids for inode in proc.list_socket_inodes(pid)}


def describe_gap(
    held: "set[int]",
    udp: "dict[int, str]",
    addresses: "dict[str, list[str]]",
    counted: "Rates | None" = None,
    group: "dict[str, Document] | None" = None,
) -> str:
    """Describe what of the traffic over the sockets ``held`` is not seen; empty where all is.

    ``udp`` as ``UdpMeter.find_sockets``: the sockets that are connected to a robot, or to nobody.
    ``group``: what counters of the task's control group saw.
    """
    robots = {address for found in addresses.values() for address in found}
    ends = {udp[inode] for inode in held & udp.keys()} & {"", *robots}
    if not ends:
        return ""
    unseen = robots if counted is None else robots - counted.robots.keys()
    if not robots or (unseen if "" in ends else unseen & ends):
        return protocol.UDP_UNSEEN
    return "" if group is not None else protocol.UDP_BY_LINK


def compute_traffic(
    held: "set[int]",
    flows: "list[Flow]",
    addresses: "dict[str, list[str]]",
    seconds: float,
    counted: "dict[str, Document] | None" = None,
) -> Document:
    """Compute bytes/s over the sockets ``held``, in all and with each robot.

    ``counted``: what counters of its control group saw, by address: it counts instead for the robots. Traffic
    inside this host does not count.
    """
    robots = {address: robot for robot, found in addresses.items() for address in found}
    own = [flow for flow in flows if flow.inode in held and (flow.remote in robots or not _is_internal(flow))]
    by_robot: "dict[str, list[Flow]]" = {}
    for flow in own:
        if flow.remote in robots:
            by_robot.setdefault(robots[flow.remote], []).append(flow)
    rates = {robot: _compute_rates(each, seconds) for robot, each in sorted(by_robot.items())}
    if counted is not None:
        rates = {
            robot: _add_rates(counted[each] for each in found if each in counted)
            for robot, found in sorted(addresses.items())
            if any(each in counted for each in found)
        }
    others = _compute_rates([flow for flow in own if flow.remote not in robots], seconds)
    return dict(_add_rates([others, *rates.values()]), robots=rates)


def _add_rates(rates: "Iterable[Document]") -> Document:
    listed = list(rates)
    return {way: sum(each[way] for each in listed) for way in ("rx", "tx")}


def _compute_rates(flows: "list[Flow]", seconds: float) -> Document:
    return {"rx": sum(flow.rx for flow in flows) / seconds, "tx": sum(flow.tx for flow in flows) / seconds}


def build_traffic_entry(rates: Document) -> Document:
    """Build the traffic of an entry in a reply: in, out, and both ways by robot."""
    return {
        "rx_bytes_per_s": round(rates["rx"], 1),
        "tx_bytes_per_s": round(rates["tx"], 1),
        "links": {robot: round(each["rx"] + each["tx"], 1) for robot, each in rates["robots"].items()},
    }


def _is_internal(flow: "Flow") -> bool:
    return flow.remote == flow.local or flow.remote == "::1" or flow.remote.startswith("127.")


def _build_unmanaged_entry(first: proc.Process) -> Document:
    return {
        "state": protocol.RUNNING,
        "pid": first.pid,
        "age_s": round(proc.age_s_from_ticks(first.ticks), 2),
        "instance": "",
        "spec_hash": "",
        "generation": 0,
        "managed": False,
        "restarts": 0,
        "exit_code": None,
        "detail": "found by detect",
    }
