# SPDX-License-Identifier: Apache-2.0
"""ROS nodes of an instance: a record of their names while it runs, and the end of these names with it.

The supervisor of a task keeps the record, so that a stop knows what was registered even of nodes that were
killed (ADR 106).
"""

import _signal as signal
import os
import time

from ..link.fast_json import Document
from ..measure import proc
from . import liveness, spawn
from .node_record import read_nodes, write_nodes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Iterable, Mapping

_MAX_NODES, _MAX_PORTS = 200, 2000
# Between two looks, growing: nodes register in the first seconds.
_FIRST_LOOK_S, _LAST_LOOK_S = 1.0, 30.0
# A look at a master that hangs, and the removal of what it knows.
_LOOK_S, _REMOVE_S = 2.0, 4.0
# Looks at a master for one set of ports: a node opens its port before it registers.
_LOOKS = 3
_ROS_2 = 2
_POLL_S = 0.2
# One question to the helper of ROS 2: it answers in milliseconds, and on a busy host in seconds.
_ASK_S = 5.0


def begin_record(folder: str, spec: Document, env: "Mapping[str, str]") -> bool:
    """Begin the record of an instance; whether it is to be kept up to date.

    Nodes of the instance before that are still in it are removed with those of this one.
    """
    ros = spec.get("ros") or {}
    if ros.get("version") == _ROS_2:
        from ..ros.graph2 import build_helper_name

        write_nodes(folder, {"helper": build_helper_name(env, list(ros.get("setup") or ()))})
        return False
    master = str(env.get("ROS_MASTER_URI") or "")
    if not master:
        return False
    before = read_nodes(folder)
    kept = before if before.get("master") == master else {}
    _write_registered(folder, master, kept.get("nodes") or {}, kept.get("places") or ())
    return True


def _write_registered(
    folder: str,
    master: str,
    nodes: "Mapping[str, str]",
    places: "Iterable[int]",
    ports: "Iterable[int]" = (),
    looks: int = 0,
) -> None:
    write_nodes(
        folder,
        {
            "master": master,
            "nodes": dict(sorted(nodes.items())[:_MAX_NODES]),
            "places": sorted({*places, *ports})[:_MAX_PORTS],
            "ports": sorted(ports),
            "looks": looks,
        },
    )


class NodeWatch:
    """The supervisor's part: looks in child processes, more rarely the longer nothing changes."""

    def __init__(self, folder: str, spec: Document, env: "Mapping[str, str]") -> None:
        self._folder, self._wanted = folder, bool(spec.get("ros") or env.get("ROS_MASTER_URI"))
        self._spec, self._env = spec, env
        self._next: "float | None" = None
        self._pause_s = _FIRST_LOOK_S

    def begin(self) -> None:
        """Look from now on, anew for each start of the command."""
        if self._wanted and begin_record(self._folder, self._spec, self._env):
            self._pause_s, self._next = _FIRST_LOOK_S, time.monotonic() + _FIRST_LOOK_S

    def poll(self) -> None:
        """Look where it is due."""
        if self._next is not None and time.monotonic() >= self._next:
            unrest = int(read_nodes(self._folder).get("looks", 0)) < _LOOKS
            self._pause_s = _FIRST_LOOK_S if unrest else min(_LAST_LOOK_S, 2 * self._pause_s)
            self._next = time.monotonic() + self._pause_s
            _run_in_child(lambda: refresh_record(self._folder))

    def compute_wait_s(self, now: float) -> "float | None":
        """Seconds until `poll` has something to do; None: never."""
        return None if self._next is None else self._next - now

    def end(self, *, remove: bool) -> None:
        """Look no more. ``remove``: the tree has ended, and no stop is there that removes its names."""
        if self._next is not None and remove:
            _run_in_child(lambda: remove_registrations(self._folder))
        self._next = None


def _run_in_child(work: "Callable[[], object]") -> None:
    """Run ``work`` in a child that nobody waits for: a master may hang."""
    # Imported here and not in the child: what the agent has compiled is cached on the host.
    from ..ros import registrations as _  # noqa: F401

    if os.fork():
        return
    try:
        signal.set_wakeup_fd(-1)
        spawn.reset_signals()
        spawn.close_other_fds({0, 1, 2})
        signal.setitimer(signal.ITIMER_REAL, 2 * _REMOVE_S)
        work()
    finally:
        os._exit(0)


def refresh_record(folder: str, *, always: bool = False) -> None:
    """Look which nodes the processes of the task have registered, and remove those of processes that have
    ended, which a launch file started again.

    Asks the master only where the ports of the processes have changed, or ``always``.
    """
    from ..ros import registrations

    record = read_nodes(folder)
    pids = liveness.find_processes(liveness.read_instance(folder), proc.read_process_table())
    ports = registrations.list_listening_ports(pids)
    looks = int(record.get("looks", 0)) if record.get("ports") == sorted(ports) else 0
    if not always and looks >= _LOOKS:
        return
    master, before = str(record["master"]), dict(record.get("nodes") or {})
    places = {*(record.get("places") or ()), *ports}
    try:
        found = registrations.find_nodes(master, ports, time.monotonic() + _LOOK_S)
        gone = {name: address for name, address in before.items() if found.get(name) != address}
        closed = places - ports
        if gone or closed:
            left = registrations.remove_dead_nodes(master, gone, time.monotonic() + _LOOK_S, closed)[1]
            found.update((name, gone[name]) for name in left if name in gone)
            places = ports
    except registrations.CallError:
        found = before
    _write_registered(folder, master, found, places, ports, looks + 1)


def note_nodes(folder: str) -> "Callable[[set[int]], None]":
    """Before a stop: note which nodes the task has now.

    Returns what notes the ports of its processes (pids) while it is stopped: a launcher may go on starting
    nodes.
    """
    record = read_nodes(folder)
    if record.get("helper"):
        _note_discovered(folder, record)
    if not record.get("master"):
        return lambda _pids: None
    from ..ros import registrations

    refresh_record(folder, always=True)
    known = set(read_nodes(folder).get("places") or ())

    def note_ports(pids: "set[int]") -> None:
        ports = registrations.list_listening_ports(pids) - known
        if ports:
            known.update(ports)
            write_nodes(folder, dict(read_nodes(folder), places=sorted(known)[:_MAX_PORTS]))

    return note_ports


def _note_discovered(folder: str, record: Document) -> None:
    from ..ros import graph2

    pids = liveness.find_processes(liveness.read_instance(folder), proc.read_process_table())
    stated = {name for name in map(_find_stated_name, pids) if name}
    try:
        seen = [
            graph2.ask_helper(str(record["helper"]), asked, time.monotonic() + _ASK_S).split()
            for asked in ({"processes": sorted(pids)}, {"present": sorted(stated)})
        ]
    except graph2.NoHelperError:
        return
    names = sorted({name for each in seen for name in each})[:_MAX_NODES]
    write_nodes(folder, dict(record, nodes=dict.fromkeys(names, "")))


def _find_stated_name(pid: int) -> str:
    """Find the full name that the command line of a node states, as launch files do; empty for none."""
    words = proc.read_cmdline(pid)
    found = {key: text for key, mark, text in (word.partition(":=") for word in words) if mark}
    name = found.get("__node", "")
    return (found.get("__ns", "").rstrip("/") + "/" + name) if name else ""


def forget_nodes(folder: str, lease_s: float) -> Document:
    """After a stop, with its processes proven gone: end the names of its nodes.

    ROS 1: remove what is registered. ROS 2: wait up to ``lease_s`` until the graph has forgotten them.
    Replies ``{"removed": names, "left": names, "why": text}``, empty where there was nothing to do.
    """
    record = read_nodes(folder)
    if record.get("master"):
        return remove_registrations(folder)
    return _await_discovered(folder, record, lease_s) if record.get("nodes") else {}


def remove_registrations(folder: str) -> Document:
    """Remove what dead nodes of a task have registered; what is left stays in the record."""
    record = read_nodes(folder)
    nodes: "dict[str, str]" = dict(record.get("nodes") or {})
    if not nodes and not record.get("places"):
        return {}
    master = str(record["master"])
    reply = remove_nodes(master, nodes, record.get("places") or ())
    if not reply.get("why"):
        left = {name: nodes[name] for name in reply.get("left", ()) if name in nodes}
        _write_registered(folder, master, left, ())
    return reply


def remove_nodes(
    master: str, nodes: "Mapping[str, str]", places: "Iterable[int]" = (), seconds: float = _REMOVE_S
) -> Document:
    """Remove what the dead nodes have registered at ``master``: the reply of `forget_nodes`."""
    from ..ros import registrations

    try:
        until = time.monotonic() + seconds
        removed, left = registrations.remove_dead_nodes(master, nodes, until, places)
    except registrations.NobodyListensError:
        # Without a master there are no registrations.
        return {}
    except registrations.CallError as error:
        return {"removed": [], "left": sorted(nodes), "why": "master %s: %s" % (master, error)}
    return {"removed": removed, "left": left, "why": ""} if removed or left else {}


def _await_discovered(folder: str, record: Document, lease_s: float) -> Document:
    from ..ros import graph2

    names, began = sorted(record["nodes"]), time.monotonic()
    left, why = names, ""
    while True:
        try:
            left, why = graph2.list_lingering(str(record["helper"]), names, time.monotonic() + _ASK_S), ""
        except graph2.NoHelperError as error:
            why = str(error)
        if why == graph2.NO_HELPER:
            # Nobody knows the graph any more.
            left = []
        if not left or time.monotonic() - began >= lease_s:
            break
        time.sleep(_POLL_S)
    write_nodes(folder, {"helper": record["helper"]})
    if left and not why:
        why = "after %.0f s" % (time.monotonic() - began)
    return {"removed": [], "left": left, "why": why}
