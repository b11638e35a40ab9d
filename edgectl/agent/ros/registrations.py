# SPDX-License-Identifier: Apache-2.0
"""Registrations at a ROS 1 master: which are of given processes, and removal of those of dead nodes.

A master forgets nobody who did not say goodbye. It compares the address (``caller_api``) at each removal, so
one that comes late never takes away what a newer node of that name has registered.
"""

import time

from ..measure import proc, system_files
from . import local, xmlrpc
from .xmlrpc import CallError, NobodyListensError

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Iterable, Iterator, Mapping

__all__ = ["CallError", "NobodyListensError", "find_nodes", "list_listening_ports", "remove_dead_nodes"]

_CALLER = "/edgectl"
# Of one call to a master or a node that hangs, and to the other nodes of its host.
_CALL_S, _NODE_S, _SILENT_S = 2.0, 1.0, 0.2
_LISTEN = "0A"


class Graph:
    """What a master knows: topics with their publishers and subscribers, services with their nodes."""

    def __init__(self, master: str, deadline: float) -> None:
        """Ask the master. Raises CallError where it does not answer by ``deadline`` (monotonic)."""
        self._master, self._deadline = master, deadline
        state = self._call("getSystemState")
        lists = state if isinstance(state, list) and len(state) == 3 else [[], [], []]
        self.publishers, self.subscribers, self.services = [
            [(str(key), [str(name) for name in names]) for key, names in each] for each in lists
        ]

    def _call(self, method: str, *params: str) -> object:
        until = min(self._deadline, time.monotonic() + _CALL_S)
        return xmlrpc.call_ros(self._master, method, list(params if params else [_CALLER]), until)

    def list_names(self) -> "set[str]":
        """List the nodes that have registered anything."""
        lists = (self.publishers, self.subscribers, self.services)
        return {name for each in lists for _, names in each for name in names}

    def find_address(self, node: str) -> str:
        """Find the address at which the node is registered; empty where it is none."""
        try:
            return str(self._call("lookupNode", _CALLER, node))
        except CallError:
            return ""

    def remove(self, node: str, address: str) -> None:
        """Remove all that ``node`` has registered under ``address``. Raises CallError."""
        for method, lists in (
            ("unregisterPublisher", self.publishers),
            ("unregisterSubscriber", self.subscribers),
        ):
            for topic in _list_keys(lists, node):
                self._call(method, node, topic, address)
        for service in _list_keys(self.services, node):
            place = str(self._call("lookupService", _CALLER, service))
            self._call("unregisterService", node, service, place)


def _list_keys(lists: "Iterable[tuple[str, list[str]]]", node: str) -> "Iterator[str]":
    return (key for key, names in lists if node in names)


def list_listening_ports(pids: "Iterable[int]") -> "set[int]":
    """List the TCP ports on which the processes listen, in the network of this process."""
    inodes = {inode for pid in pids for inode in proc.list_socket_inodes(pid)}
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in system_files.read_file(table).decode("ascii", "replace").splitlines()[1:]:
            words = line.split()
            if len(words) > 9 and words[3] == _LISTEN and int(words[9]) in inodes:
                found.add(int(words[1].rpartition(":")[2], 16))
    return found


def find_nodes(master: str, ports: "set[int]", deadline: float) -> "dict[str, str]":
    """Find the nodes whose address is one of this host with one of ``ports``: name -> address.

    Raises:
        CallError: the master does not answer.
    """
    graph = Graph(master, deadline)
    found = {name: graph.find_address(name) for name in sorted(graph.list_names())}
    return {name: address for name, address in found.items() if _is_here(address, ports)}


def _is_here(address: str, ports: "set[int] | None" = None) -> bool:
    """Whether the address of a node is one of this host, with one of ``ports``; None: any port."""
    try:
        host, port = xmlrpc.split_uri(address)
    except CallError:
        return False
    known = local.resolve_addresses([host]) if ports is None or port in ports else []
    return bool(known) and local.is_own_address(known[0])


def remove_dead_nodes(
    master: str, nodes: "Mapping[str, str]", deadline: float, ports: "Iterable[int]" = ()
) -> "tuple[list[str], list[str]]":
    """Remove what dead nodes have registered: (names removed, names that are left).

    These are ``nodes`` (name -> address), those of such a name at another port of this host, as respawned
    ones are, and whoever had one of ``ports`` of this host. Who answers lives: one of ``nodes`` is left,
    another one is none of ours.

    Raises:
        CallError: the master does not answer.
    """
    graph, places = Graph(master, deadline), set(ports)
    names = sorted(graph.list_names() if places else graph.list_names() & set(nodes))
    known = {name: graph.find_address(name) for name in names}
    ours = [name for name in names if known[name] == nodes.get(name)]
    alike = [name for name in names if _is_here(known[name], None if name in nodes else places)]
    dead, silent = [], set()
    for name in sorted({*ours, *alike}):
        host = known[name].rpartition(":")[0]
        began = time.monotonic()
        if not _answers(known[name], min(deadline, began + (_SILENT_S if host in silent else _NODE_S))):
            dead.append(name)
            silent.update([host] if time.monotonic() - began >= _SILENT_S else [])
    for name in dead:
        try:
            graph.remove(name, known[name])
        except CallError:
            continue
    now = Graph(master, deadline) if dead else graph
    present = now.list_names()
    left = [
        name for name in sorted({*ours, *dead}) if name in present and now.find_address(name) == known[name]
    ]
    return [name for name in dead if name not in left], left


def _answers(address: str, deadline: float) -> bool:
    try:
        xmlrpc.call_ros(address, "getPid", [_CALLER], deadline)
    except CallError:
        return False
    return True
