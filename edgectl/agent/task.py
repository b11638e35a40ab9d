"""The task profiler: state, CPU, memory and throughput of each task's whole process tree, and tasks found by pattern."""

import os

from . import life, proc, sockets, state, status

# Up to here the kernel's walk over a process's pages (PSS) stays below some ms.
_PSS_UP_TO = 1 << 30


class Group:
    """One task's processes: ``pids`` its own, ``above`` its supervisor (0: none); ``entry`` is its part of a reply, without rates."""

    __slots__ = ("above", "entry", "pids")

    def __init__(self, pids: set, above: int, entry: dict) -> None:
        self.pids, self.above, self.entry = pids, above, entry


def groups(host: str, names: list, detect: list, table: dict) -> dict:
    """Task -> Group of every task of ``names`` that lives or has ended, and of those that ``detect`` finds in ``table``."""
    found = {}
    for name in names:
        trace, alive = status.current(host, name, table)
        entry = life.entry(trace, alive) if trace is not None else {}
        if entry:
            found[name] = (
                Group(life.members(trace, table), life.supervisor(trace), entry)
                if alive
                else Group(set(), 0, entry)
            )
    found.update(_detected(detect, table, found))
    return found


def _detected(detect: list, table: dict, own: dict) -> dict:
    if not detect:
        return {}
    free = set(table) - _ourselves(table)
    for group in own.values():
        free -= group.pids | {group.above}
    found = {}
    for wish in detect:
        name = str(wish["task"])
        if name in own and own[name].entry["pid"] > 0:
            continue
        pids = {pid for pid in free if _matches(wish, proc.cmdline(pid)) and not life.is_marked(pid)}
        if pids:
            first = min(pids, key=lambda pid: (table[pid].ticks, pid))
            found[name] = Group(proc.descendants(pids, table) & free, 0, _unmanaged(table[first]))
    return found


class TaskMeter:
    """Measures the tasks of one host between its making and ``reading``."""

    def __init__(self, host: str, detect: list) -> None:
        self.host, self.detect = host, detect
        self.names = state.task_names(host)
        self.before = {name: cpu_s(group, table) for table, name, group in self._groups()}

    def _groups(self) -> list:
        table = proc.processes() if self.names or self.detect else {}
        return [
            (table, name, group)
            for name, group in sorted(groups(self.host, self.names, self.detect, table).items())
        ]

    def reading(self, flows: list, addresses: dict, seconds: float) -> dict:
        """Task -> entry with rates."""
        return {
            name: dict(
                group.entry,
                used_cores=cores(group, table, self.before.get(name, {}), seconds),
                used_bytes=memory(group, table),
                **shown(traffic(holdings(group.pids) if flows else set(), flows, addresses, seconds)),
            )
            for table, name, group in self._groups()
        }


def cpu_s(group: Group, table: dict) -> dict:
    """CPU seconds by pid; a child's time passes to whoever reaps it, so the sum over the tree only grows.

    The supervisor's own work is not the task's, but it reaps the task's orphans.
    """
    seconds = {pid: table[pid].cpu + table[pid].child_cpu for pid in group.pids if pid in table}
    if group.above in table:
        seconds[group.above] = table[group.above].child_cpu
    return seconds


def cores(group: Group, table: dict, then: dict, seconds: float) -> float:
    """Cores in use since ``then`` (CPU seconds by pid), which was ``seconds`` ago.

    A process that was not seen then brings its time with it, but only that of the window: as much as it used on average.
    """
    now = cpu_s(group, table)
    used = sum(now.values()) - sum(then.values())
    for pid in set(now) - set(then):
        used -= now[pid] * (1.0 - min(1.0, seconds / max(1e-3, proc.age(table[pid].ticks))))
    return round(max(0.0, used) / seconds, 4)


def memory(group: Group, table: dict) -> int:
    """Bytes; pages that several processes share count once where the kernel says how they are shared (PSS)."""
    seen = [table[pid] for pid in group.pids if pid in table]
    return sum((_pss(each.pid, each.rss) if len(seen) > 1 else 0) or each.rss for each in seen)


def _pss(pid: int, rss: int) -> int:
    if rss > _PSS_UP_TO:
        return 0
    for line in proc.read("/proc/%d/smaps_rollup" % pid).splitlines():
        if line.startswith(b"Pss:"):
            return int(line.split()[1]) * 1024
    return 0


def holdings(pids: set) -> set:
    """The sockets that the processes hold."""
    return set().union(*(sockets.inodes(pid) for pid in pids))


def traffic(held: set, flows: list, addresses: dict, seconds: float) -> dict:
    """Bytes/s over the ``held`` sockets, in all and with each robot; what stays inside this host does not count."""
    robots = {address: robot for robot, found in addresses.items() for address in found}
    own = [flow for flow in flows if flow.inode in held and (flow.remote in robots or not _internal(flow))]
    by_robot = {}
    for flow in own:
        if flow.remote in robots:
            by_robot.setdefault(robots[flow.remote], []).append(flow)
    return dict(
        _rates(own, seconds),
        robots={robot: _rates(each, seconds) for robot, each in sorted(by_robot.items())},
    )


def _rates(flows: list, seconds: float) -> dict:
    return {"rx": sum(flow.rx for flow in flows) / seconds, "tx": sum(flow.tx for flow in flows) / seconds}


def shown(rates: dict) -> dict:
    """``traffic`` as it stands in a reply: in, out, and both ways by robot."""
    return {
        "rx_bytes_per_s": round(rates["rx"], 1),
        "tx_bytes_per_s": round(rates["tx"], 1),
        "links": {robot: round(each["rx"] + each["tx"], 1) for robot, each in rates["robots"].items()},
    }


def _internal(flow) -> bool:
    return flow.remote == flow.local or flow.remote == "::1" or flow.remote.startswith("127.")


def _matches(wish: dict, argv: list) -> bool:
    if wish.get("ros_node"):
        node = str(wish["ros_node"]).lstrip("/")
        return any(
            word.lstrip("_") in (":=" + node, "name:=" + node, "node:=" + node) for word in argv
        ) or _is_node(node, argv)
    import re

    return bool(wish.get("cmdline")) and re.search(str(wish["cmdline"]), " ".join(argv)) is not None


def _is_node(node: str, argv: list) -> bool:
    """Whether the program that runs, or the script that an interpreter runs, bears the node's name."""
    return any(os.path.splitext(os.path.basename(word))[0] == node for word in argv[:2])


def _ourselves(table: dict) -> set:
    """The agent and everything above it: a login shell or an sshd may carry a pattern in its command line too."""
    found, pid = set(), os.getpid()
    while pid in table and pid not in found:
        found.add(pid)
        pid = table[pid].ppid
    return found


def _unmanaged(first) -> dict:
    return {
        "state": "running", "pid": first.pid, "age_s": round(proc.age(first.ticks), 2), "instance": "", "spec_hash": "", "generation": 0,
        "managed": False, "restarts": 0, "exit_code": None, "detail": "found by detect",
    }  # fmt: skip
