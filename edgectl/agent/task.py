"""The task profiler: state, CPU, memory and throughput of each task's whole process tree, and tasks found by pattern."""

import os

from . import life, proc, sockets, state, status

# Up to here the kernel's walk over a process's pages (PSS) stays below some ms.
_PSS_UP_TO = 1 << 30


class TaskMeter:
    """Measures the tasks of one host between its making and ``reading``."""

    def __init__(self, host: str, detect: list) -> None:
        self.host, self.detect = host, detect
        self.names = state.task_names(host)
        self.before = {name: _cpu(group) for name, group in self._groups().items()} if self.names or detect else {}

    def _groups(self) -> dict:
        """Task -> (table, pids, supervisor pid, entry) of what lives, (table, (), 0, entry) of what ended."""
        table = proc.processes()
        groups = {}
        for name in self.names:
            trace, alive = status.current(self.host, name, table)
            document = life.entry(trace, alive) if trace is not None else {}
            if document:
                pids = life.members(trace, table) if alive else set()
                groups[name] = (table, pids, life.supervisor(trace) if alive else 0, document)
        groups.update(self._detected(table, groups))
        return groups

    def _detected(self, table: dict, own: dict) -> dict:
        ours = set().union(*(pids | {above} for _, pids, above, _ in own.values())) if own else set()
        free = set(table) - ours - _ourselves(table)
        found = {}
        for wish in self.detect:
            name = str(wish["task"])
            if own.get(name, (0, 0, 0, {"pid": 0}))[3]["pid"] > 0:
                continue
            pids = {pid for pid in free if _matches(wish, proc.cmdline(pid)) and not life.is_marked(pid)}
            if pids:
                first = min(pids, key=lambda pid: (table[pid].ticks, pid))
                found[name] = (table, proc.descendants(pids, table) & free, 0, _unmanaged(table[first]))
        return found

    def reading(self, flows: list, addresses: dict, seconds: float) -> dict:
        """Task -> entry with rates."""
        if not self.names and not self.detect:
            return {}
        return {name: self._entry(name, group, flows, addresses, seconds) for name, group in sorted(self._groups().items())}

    def _entry(self, name: str, group: tuple, flows: list, addresses: dict, seconds: float) -> dict:
        table, pids, _, document = group
        then, now = self.before.get(name, {}), _cpu(group)
        # A process that is new brought its time with it only if it was born in the window; older ones just came into view.
        used = sum(now.values()) - sum(then.values()) if then or document["age_s"] <= seconds else 0.0
        document["used_cores"] = round(max(0.0, used) / seconds, 4)
        document["used_bytes"] = _memory(table, pids)
        document.update(_throughput(pids, flows, addresses, seconds))
        return document


def _cpu(group: tuple) -> dict:
    """CPU seconds by pid; a child's time passes to whoever reaps it, so the sum over the tree only grows.

    The supervisor's own work is not the task's, but it reaps the task's orphans.
    """
    table, pids, above, _ = group
    seconds = {pid: table[pid].cpu + table[pid].child_cpu for pid in pids}
    if above in table:
        seconds[above] = table[above].child_cpu
    return seconds


def _memory(table: dict, pids: set) -> int:
    """Bytes; pages that several processes share count once where the kernel says how they are shared (PSS)."""
    return sum((_pss(pid, table[pid].rss) if len(pids) > 1 else 0) or table[pid].rss for pid in pids)


def _pss(pid: int, rss: int) -> int:
    if rss > _PSS_UP_TO:
        return 0
    for line in proc.read("/proc/%d/smaps_rollup" % pid).splitlines():
        if line.startswith(b"Pss:"):
            return int(line.split()[1]) * 1024
    return 0


def _throughput(pids: set, flows: list, addresses: dict, seconds: float) -> dict:
    """Bytes/s in and out over the network, and both ways by robot; traffic inside this host does not count."""
    wanted = set().union(*(sockets.inodes(pid) for pid in pids)) if pids and flows else set()
    robots = {address: robot for robot, found in addresses.items() for address in found}
    own = [flow for flow in flows if flow.inode in wanted and (flow.remote in robots or not _internal(flow))]
    by_robot = {}
    for flow in own:
        if flow.remote in robots:
            robot = robots[flow.remote]
            by_robot[robot] = by_robot.get(robot, 0.0) + (flow.rx + flow.tx) / seconds
    return {
        "rx_bytes_per_s": round(sum(flow.rx for flow in own) / seconds, 1),
        "tx_bytes_per_s": round(sum(flow.tx for flow in own) / seconds, 1),
        "links": {robot: round(rate, 1) for robot, rate in sorted(by_robot.items())},
    }


def _internal(flow) -> bool:
    return flow.remote == flow.local or flow.remote == "::1" or flow.remote.startswith("127.")


def _matches(wish: dict, argv: list) -> bool:
    if wish.get("ros_node"):
        node = str(wish["ros_node"]).lstrip("/")
        return any(word.lstrip("_") in (":=" + node, "name:=" + node, "node:=" + node) for word in argv) or _is_node(node, argv)
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
