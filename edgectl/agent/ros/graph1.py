# SPDX-License-Identifier: Apache-2.0
"""Questions to the graph of ROS 1, asked of its master and of the nodes themselves.

The master forgets nobody who did not say goodbye, so what it says is asked of the node too. A message is read
from its publisher directly: nothing is registered at the master.
"""

import os
import struct
import time

from ..link.fast_json import Document
from ..measure import proc, sockets, system_files
from . import local, xmlrpc
from .xmlrpc import CallError

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Collection, Mapping

CALLER = "/edgectl"
CALL_S = 3.0
_MAX_HEADER_BYTES = 1 << 16
_LISTEN = "0A"


def find_fault(
    asked: Document, env: "Mapping[str, str]", deadline: float, _setup: "list[str]"
) -> "tuple[str, str]":
    """Find (the first condition of ``asked`` that does not hold, the process of the node).

    The fault is empty where all hold. ``env`` is that of the task: its master, and the mark of its processes.
    ``replaces`` in ``asked``: addresses of nodes whose answers do not count, of another instance of the task.
    """
    master, process = env.get("ROS_MASTER_URI") or os.environ.get("ROS_MASTER_URI", ""), ""
    replaced = asked.get("replaces") or ()
    if not master:
        return "no ROS_MASTER_URI: state ros: {master: ..} in the inventory", ""
    try:
        if asked.get("node"):
            process = str(_check_node(asked["node"], master, env, replaced, deadline))
        if asked.get("topic"):
            _check_topic(
                asked["topic"]["name"], float(asked["topic"]["within_s"]), master, replaced, deadline
            )
        if asked.get("service"):
            _check_service(asked["service"], master, replaced, deadline)
    except CallError as error:
        return str(error), process
    return "", process


def ask_master(master: str, method: str, params: "list[str]", deadline: float) -> "object":
    """Ask the master. CallError where it does not answer, or says no."""
    try:
        return xmlrpc.call_ros(master, method, [CALLER, *params], min(deadline, time.monotonic() + CALL_S))
    except CallError as error:
        raise CallError("master %s: %s" % (master, error)) from error


def _check_node(
    node: str, master: str, env: "Mapping[str, str]", replaced: "Collection[str]", deadline: float
) -> "object":
    """Check that the node lives, and is one of the task; returns its process id."""
    try:
        uri = str(ask_master(master, "lookupNode", [node], deadline))
    except CallError as error:
        raise CallError("node %s is not registered: %s" % (node, error)) from error
    if uri in replaced:
        raise CallError("node %s is still that of the instance which this one replaces" % node)
    try:
        pid = xmlrpc.call_ros(uri, "getPid", [CALLER], min(deadline, time.monotonic() + CALL_S))
    except CallError as error:
        raise CallError(
            "node %s is registered at %s, which does not answer: %s" % (node, uri, error)
        ) from error
    mark = env.get("EDGECTL_TASK_DIR")
    if mark and isinstance(pid, int):
        _check_owner(node, uri, pid, mark)
    return pid


def _check_owner(node: str, uri: str, pid: int, mark: str) -> None:
    """Decline a node of this name that is no process of the task: the name was taken over."""
    host, port = xmlrpc.split_uri(uri)
    found = local.resolve_addresses([host])
    if found and not local.is_own_address(found[0]):
        raise CallError("node %s runs at %s, and not as a process of this task" % (node, uri))
    if proc.has_environ_entry(pid, b"EDGECTL_TASK_DIR=" + os.fsencode(mark)) or not is_listening(pid, port):
        # A process in a container has another pid there, and the one of that number here no such socket.
        return
    raise CallError(
        "node %s is process %d of this host, and not of this task: its name is used twice" % (node, pid)
    )


def is_listening(pid: int, port: int) -> bool:
    """Whether process ``pid`` is seen to listen on the TCP port."""
    inodes = proc.list_socket_inodes(pid)
    wanted = "%04X" % port
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in system_files.read_file(table).decode("ascii", "replace").splitlines()[1:]:
            words = line.split()
            listens = len(words) > 9 and words[3] == _LISTEN and words[1].endswith(":" + wanted)
            if listens and int(words[9]) in inodes:
                return True
    return False


def _check_topic(
    topic: str, within_s: float, master: str, replaced: "Collection[str]", deadline: float
) -> None:
    """Read one message, or more of its bytes than none, from any publisher of the topic."""
    state = ask_master(master, "getSystemState", [], deadline)
    publishers = state[0] if isinstance(state, list) and state else []
    nodes = [str(node) for name, names in publishers if name == topic for node in names]
    if not nodes:
        raise CallError("topic %s has no publisher" % topic)
    nodes = _exclude_replaced(nodes, master, replaced, deadline)
    if not nodes:
        raise CallError("topic %s has no publisher but the instance which this one replaces" % topic)
    until, why = min(deadline, time.monotonic() + within_s), ""
    opened = []
    try:
        for node in nodes:
            try:
                opened.append(_subscribe(topic, node, master, until))
            except CallError as error:
                why = ": %s: %s" % (node, error)
        if not _hear_any(opened, until):
            raise CallError("no message on %s within %g s%s" % (topic, within_s, why))
    finally:
        for each in opened:
            each.close()


def _exclude_replaced(
    nodes: "list[str]", master: str, replaced: "Collection[str]", deadline: float
) -> "list[str]":
    """Leave out the nodes that are registered at one of these addresses."""
    if not replaced:
        return nodes
    return [node for node in nodes if str(ask_master(master, "lookupNode", [node], deadline)) not in replaced]


def _hear_any(opened: "list[sockets.socket.socket]", until: float) -> bool:
    """Whether a message begins on any of the connections by then."""
    import select

    waiting = list(opened)
    while waiting:
        readable = select.select(waiting, [], [], max(0.0, until - time.monotonic()))[0]
        if not readable:
            return False
        for each in readable:
            try:
                if each.recv(4):
                    return True
            except OSError:
                pass
            waiting.remove(each)
    return False


def _subscribe(topic: str, node: str, master: str, deadline: float) -> "sockets.socket.socket":
    """Open a connection on which the node sends its messages."""
    uri = str(ask_master(master, "lookupNode", [node], deadline))
    offer = xmlrpc.call_ros(uri, "requestTopic", [CALLER, topic, [["TCPROS"]]], deadline)
    if not isinstance(offer, list) or len(offer) < 3:
        raise CallError("it does not offer TCPROS")
    made = xmlrpc.connect(str(offer[1]), int(offer[2]), deadline)
    try:
        _shake_hands(made, {"topic": topic, "md5sum": "*", "type": "*", "tcp_nodelay": "1"}, deadline)
    except CallError:
        made.close()
        raise
    return made


def _shake_hands(made: "sockets.socket.socket", fields: "dict[str, str]", deadline: float) -> None:
    """Exchange the headers of a connection. CallError where the other side declines."""
    lines = [("%s=%s" % pair).encode("utf-8") for pair in dict(fields, callerid=CALLER).items()]
    header = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    try:
        made.sendall(struct.pack("<I", len(header)) + header)
    except OSError as error:
        raise CallError(error.strerror or "no answer in time") from error
    size = struct.unpack("<I", xmlrpc.receive_exactly(made, 4, deadline))[0]
    if size > _MAX_HEADER_BYTES:
        raise CallError("it does not speak TCPROS")
    answer = xmlrpc.receive_exactly(made, size, deadline)
    at = answer.find(b"error=")
    if at == 4 or (at > 4 and answer[at - 4 : at] == struct.pack("<I", len(answer) - at)):
        raise CallError(answer[at + 6 :].decode("utf-8", "replace")[:200])


def _check_service(service: str, master: str, replaced: "Collection[str]", deadline: float) -> None:
    if replaced:
        state = ask_master(master, "getSystemState", [], deadline)
        offers = state[2] if isinstance(state, list) and len(state) == 3 else []
        nodes = [str(node) for name, names in offers if name == service for node in names]
        if nodes and not _exclude_replaced(nodes, master, replaced, deadline):
            raise CallError("service %s is still that of the instance which this one replaces" % service)
    try:
        uri = str(ask_master(master, "lookupService", [service], deadline))
    except CallError as error:
        raise CallError("service %s is not offered: %s" % (service, error)) from error
    try:
        host, port = xmlrpc.split_uri(uri)
        made = xmlrpc.connect(host, port, min(deadline, time.monotonic() + CALL_S))
        try:
            _shake_hands(made, {"probe": "1", "md5sum": "*", "service": service}, deadline)
        finally:
            made.close()
    except CallError as error:
        raise CallError("service %s at %s does not answer: %s" % (service, uri, error)) from error
