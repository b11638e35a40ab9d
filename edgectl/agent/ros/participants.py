# SPDX-License-Identifier: Apache-2.0
"""Whose a node, topic or service of a ROS 2 graph is: processes read off the identifiers of writers.

The identifier of a writer of Fast DDS holds the vendor, the host and the lower half of the process id. That
this is so here is read off the identifier of the helper, whose process is known. Other vendors state no
process.
"""

import re

from ..link.fast_json import Document
from ..measure import proc, system_files
from ..supervise import liveness

# How a writer's identifier begins, in hexadecimal: vendor and host, then the process, the participant.
_FAST_DDS = "010f"
_ENDS_OF_HOST, _ENDS_OF_PID, _ENDS_OF_PARTICIPANT = 8, 12, 24
_LIBRARY = re.compile(rb"/libfast(rtps|dds)[.-]")
# A node that was killed stays in the graph until its lease ends, 20 s with Fast DDS; who is known for longer
# beside another one lives.
LEASE_S = 22.0


class Owners:
    """What is known of the writers of one name.

    ``ours``: identifiers of those of the task, with their processes; ``foreign``: processes of this host and
    not of the task; ``distant``, ``gone``, ``unknown``: whether one is of another host, has ended, or may be
    anybody's; ``elsewhere``: whether such a one certainly lives beside another one.
    """

    def __init__(self, seen: Document, pids: "set[int]") -> None:
        """``seen``: the answer of the helper; ``pids``: the processes of the task."""
        ends = [(str(gid), float(age_s)) for gid, age_s in seen["ends"]]
        self.ours: "dict[str, int]" = {}
        self.foreign: "list[int]" = []
        self.distant = self.gone = self.unknown = False
        readable = bool(seen["own"]) and is_of_process(str(seen["own"]), int(seen["pid"]))
        for gid, _ in ends:
            # Not by the host: it is made of the addresses of its interfaces, which may have changed since.
            mine = [pid for pid in sorted(pids) if readable and is_of_process(gid, pid)]
            if mine:
                self.ours[gid] = mine[0]
            elif readable and is_fast_dds(gid):
                self._sort_other(gid, seen)
            else:
                self.unknown = True
        ages = sorted((age_s for _, age_s in ends), reverse=True)
        self.elsewhere = (self.distant or self.unknown) and len(ages) > 1 and ages[1] > LEASE_S

    def _sort_other(self, gid: str, seen: Document) -> None:
        if not _is_here(gid, seen):
            self.distant = True
            return
        table = proc.read_process_table()
        alike = [pid for pid in table if is_of_process(gid, pid) and _may_take_part(pid)]
        if alike:
            self.foreign.append(alike[0])
        elif any(is_of_process(gid, pid) for pid in _list_inner_pids(table)):
            # In a container: whose it is, is not known.
            self.unknown = True
        else:
            self.gone = True

    @property
    def others(self) -> bool:
        """Whether the name is certainly somebody else's, and of nobody of whom nothing is known."""
        return not self.ours and not self.unknown and bool(self.foreign or self.distant or self.gone)


def find_pids(folder: str) -> "set[int]":
    """Find the processes of the task in ``folder``."""
    return liveness.find_processes(liveness.read_instance(folder), proc.read_process_table())


def describe_foreign(node: str, owners: Owners) -> str:
    """Describe that a node of this name is none of the task."""
    if owners.foreign:
        return "node %s is process %d of this host, and not of this task: its name is used twice" % (
            node,
            owners.foreign[0],
        )
    if owners.distant:
        return "node %s runs on another host, and not as a process of this task" % node
    return "node %s has ended, and the graph has not forgotten it yet" % node


def describe_twice(node: str, owners: Owners) -> str:
    """Describe that others have the name of our node too; empty where none has."""
    if len(owners.ours) > 1:
        pids = ", ".join(map(str, sorted(owners.ours.values())))
        return "node %s is processes %s of this task: its name is used twice" % (node, pids)
    if owners.foreign:
        return "node %s is also process %d of this host, and not of this task: its name is used twice" % (
            node,
            owners.foreign[0],
        )
    if owners.elsewhere:
        where = "also runs on another host" if owners.distant else "is in the graph more than once"
        return "node %s %s: its name is used twice" % (node, where)
    return ""


def list_participants(owners: Owners) -> "list[str]":
    """List the participants of the task: how the identifiers of their writers begin, in hexadecimal."""
    return sorted({gid[:_ENDS_OF_PARTICIPANT] for gid in owners.ours})


def is_of_process(gid: str, pid: int) -> bool:
    """Whether the id is one of Fast DDS, and of this process on its host."""
    text = gid[_ENDS_OF_HOST:_ENDS_OF_PID]
    return is_fast_dds(gid) and int(text[2:] + text[:2], 16) == pid & 0xFFFF


def is_fast_dds(gid: str) -> bool:
    """Whether the id is one of Fast DDS."""
    return gid.startswith(_FAST_DDS)


def is_same_host(gid: str, other: str) -> bool:
    """Whether two ids of Fast DDS are of one host."""
    return gid[:_ENDS_OF_HOST] == other[:_ENDS_OF_HOST]


def has_fast_dds(pid: int) -> bool:
    """Whether the process has loaded Fast DDS, as far as this user may see that."""
    return bool(_LIBRARY.search(system_files.read_file("/proc/%d/maps" % pid)))


def _is_here(gid: str, seen: Document) -> bool:
    return is_same_host(gid, str(seen["own"]))


def _may_take_part(pid: int) -> bool:
    """Whether the process has loaded Fast DDS, or hides from this user what it has."""
    loaded = system_files.read_file("/proc/%d/maps" % pid)
    return not loaded or bool(_LIBRARY.search(loaded))


def _list_inner_pids(table: "dict[int, proc.Process]") -> "list[int]":
    """List the process ids that processes of containers have within them."""
    found = []
    for pid in table:
        for line in system_files.read_file("/proc/%d/status" % pid).splitlines():
            if line.startswith(b"NSpid:"):
                words = line.split()
                found += [int(words[-1])] if len(words) > 2 else []
    return found
