# SPDX-License-Identifier: Apache-2.0
"""Helper that knows the graph of ROS 2: one per host and domain, run by the Python of the set-up files.

The agent sends its text to ``python3 -``, and what it needs of ROS it finds there. It answers one question
per connection on an abstract socket: a JSON object in, ``=`` and the fault as text out, empty for none, or a
JSON object where it is to list the graph.
"""

import importlib
import json
import os
import socket
import struct
import sys
import threading
import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_POLL_S, _SERVICE_S = 0.02, 2.0
_MOST_BYTES = 1 << 16
# How the identifiers of its writers begin: then follow two bytes of the host and two of the process.
_FAST_DDS = b"\x01\x0f"
# How long a name that is asked for the first time may take to be discovered, and how long after its own start
# the helper may not know names that have long been there: on a busy host discovery takes seconds.
_DISCOVERY_S, _SETTLE_S = 1.0, 5.0
# By name: the number of a transition, and the state after it.
_TRANSITIONS = {"configure": (1, "inactive"), "activate": (3, "active"), "deactivate": (4, "inactive")}
# A list is complete when two looks so far apart see the same nodes.
_LOOK_S, _MOST_LOOKS = 0.5, 10


class Graph:
    """One node of its own that looks at the others."""

    def __init__(self) -> None:
        self.rclpy: "Any" = importlib.import_module("rclpy")
        self.rclpy.init(args=[])
        self.node = self.rclpy.create_node("edgectl_%d" % os.getpid(), enable_rosout=False)
        self.clients: "dict[str, Any]" = {}
        self.lifecycles = Lifecycles(self)
        self.settled_at = time.monotonic() + _SETTLE_S
        self.asked_at = time.monotonic()
        # The questions that are being answered.
        self.live: "set[object]" = set()
        # Since when which writers have been known, by what was asked.
        self.known: "dict[str, dict[str, float]]" = {}
        executors: "Any" = importlib.import_module("rclpy.executors")
        executor = executors.SingleThreadedExecutor()
        executor.add_node(self.node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def answer(self, asked: "dict[str, Any]") -> str:
        """Answer a question: ``idle``, for how many seconds none was asked; ``list``, the graph; ``change``
        and ``warm``, of the lifecycle of a node; ``ends``, the writers of one name; of ``processes``, the
        names of their nodes; of names, those ``present`` in the graph; else the first condition that does
        not hold, empty where all do.
        """
        if "idle" in asked:
            return "%.1f" % (0.0 if self.live else time.monotonic() - self.asked_at)
        me = object()
        self.live.add(me)
        try:
            return self._answer(asked)
        finally:
            self.asked_at = time.monotonic()
            self.live.discard(me)

    def _answer(self, asked: "dict[str, Any]") -> str:
        if asked.get("list"):
            return json.dumps(self.list_graph())
        if asked.get("change") or asked.get("warm"):
            return self.lifecycles.answer(asked)
        if "ends" in asked:
            return json.dumps(self.list_ends(asked["ends"]))
        if "processes" in asked:
            return " ".join(sorted(self._list_nodes_of(asked["processes"])))
        if "present" in asked:
            return " ".join(sorted(set(asked["present"]) & self._list_nodes()))
        return self.find_fault(asked)

    def find_fault(self, asked: "dict[str, Any]") -> str:
        """Find the first condition that does not hold; empty where all do."""
        if asked.get("node") and not self.discover(lambda: asked["node"] in self._list_nodes()):
            return "node %s is not in the graph" % asked["node"]
        if asked.get("lifecycle"):
            state = self._read_lifecycle(asked["node"])
            if state != asked["lifecycle"]:
                return "node %s is %s, not %s" % (asked["node"], state, asked["lifecycle"])
        topic = asked.get("topic")
        if topic and not self._hear(topic["name"], float(topic["within_s"]), topic.get("of") or []):
            return "no message on %s within %g s" % (topic["name"], topic["within_s"])
        if asked.get("service"):
            wanted = asked["service"]
            if not self.discover(lambda: wanted in dict(self.node.get_service_names_and_types())):
                return "service %s is not offered" % wanted
        return ""

    def count_nodes(self, node: str) -> int:
        """Count the nodes of this full name, or those with its lifecycle where they are more."""
        known = self.node.get_node_names_and_namespaces()
        named: int = sum(space.rstrip("/") + "/" + name == node for name, space in known)
        # Of rclpy since 2024; names come later than the services.
        count: "Any" = getattr(self.node, "count_services", lambda _name: 0)
        return max(named, int(count(node + "/change_state"))) - self._count_dead(node)

    def _count_dead(self, node: str) -> int:
        """Count the nodes of this name whose process on this machine has ended.

        The graph goes on naming one that was killed for as long as its lease.
        """
        found = self._list_writers()
        hosts = {gid[:4] for name, gid in found if name == "/" + self.node.get_name()}
        processes = {struct.pack("<H", int(name) & 0xFFFF) for name in os.listdir("/proc") if name.isdigit()}
        gids = [gid for name, gid in found if name == node and gid[:2] == _FAST_DDS and gid[:4] in hosts]
        return sum(gid[4:6] not in processes for gid in gids)

    def is_node_below(self, node: str, root: int) -> bool:
        """Whether a process below ``root`` has the node; also where processes cannot be told from writers."""
        own = {os.getpid()}
        if "/" + self.node.get_name() not in self._list_nodes_of(sorted(own)):
            return True
        return node in self._list_nodes_of(sorted(_list_below(root)))

    def discover(self, condition: "Any") -> bool:
        """Wait for as long as a node or a service may take to be discovered."""
        return _wait_for(condition, max(_DISCOVERY_S, self.settled_at - time.monotonic()))

    def list_ends(self, of: "dict[str, str]") -> "dict[str, Any]":
        """List the identifiers of the writers of a ``node``, ``topic`` or ``service``, with the seconds for
        which each has been known; ``nodes``: how many nodes of this name there are.
        """
        node = of.get("node")
        self.discover(lambda: self._find_writers(of) and self._count(node) <= len(self._find_writers(of)))
        now, gids = time.monotonic(), self._find_writers(of)
        key = json.dumps(of)
        self.known[key] = {gid: self.known.get(key, {}).get(gid, now) for gid in gids}
        own = self._find_writers({"node": self.node.get_fully_qualified_name()})
        return {
            "pid": os.getpid(),
            "own": own[0] if own else "",
            "nodes": self._count(node),
            "ends": [[gid, round(now - since, 3)] for gid, since in sorted(self.known[key].items())],
        }

    def _count(self, node: "str | None") -> int:
        nodes = self.node.get_node_names_and_namespaces()
        return sum(node == space.rstrip("/") + "/" + name for name, space in nodes)

    def _find_writers(self, of: "dict[str, str]") -> "list[str]":
        """Find the identifiers of writers, in hexadecimal: of a node, its one of each topic that all have."""
        info = self.node.get_publishers_info_by_topic
        if of.get("topic"):
            found = info(of["topic"])
        elif of.get("service"):
            # Its answers are a topic, whose name DDS knows so.
            found = info("rr%sReply" % of["service"], no_mangle=True)
        else:
            per_topic = [
                [
                    each
                    for each in info(topic)
                    if each.node_namespace.rstrip("/") + "/" + each.node_name == of["node"]
                ]
                for topic in ("/parameter_events", "/rosout")
            ]
            found = max(per_topic, key=len)
        return [bytes(each.endpoint_gid).hex() for each in found]

    def list_graph(self) -> "dict[str, Any]":
        """List the nodes with what they publish and hear, and the ids of their DDS participants."""
        time.sleep(max(0.0, self.settled_at - time.monotonic()))
        before, seen = set(), self._list_nodes()  # type: set[str], set[str]
        for _ in range(_MOST_LOOKS):
            if seen == before:
                break
            time.sleep(_LOOK_S)
            before, seen = seen, self._list_nodes()
        own = self.node.get_fully_qualified_name()
        found: "dict[str, Any]" = {
            name: {"publishes": [], "subscribes": [], "gid": ""} for name in {*seen, own}
        }
        for topic, _ in self.node.get_topic_names_and_types():
            for key, ends in (
                ("publishes", self.node.get_publishers_info_by_topic(topic)),
                ("subscribes", self.node.get_subscriptions_info_by_topic(topic)),
            ):
                for end in ends:
                    node = found.get(end.node_namespace.rstrip("/") + "/" + end.node_name)
                    if node is not None:
                        node["gid"] = bytes(end.endpoint_gid).hex()
                        if topic not in node[key]:
                            node[key].append(topic)
        return {"pid": os.getpid(), "own": own, "nodes": found}

    def _list_nodes(self) -> "set[str]":
        return {space.rstrip("/") + "/" + name for name, space in self.node.get_node_names_and_namespaces()}

    def _list_nodes_of(self, pids: "list[int]") -> "set[str]":
        """List the nodes of processes of this host, as far as the identifiers of their writers have the
        process: those of Fast DDS do.
        """
        found = self._list_writers()
        hosts = {gid[:4] for name, gid in found if name == "/" + self.node.get_name()}
        wanted = {struct.pack("<H", pid & 0xFFFF) for pid in pids}
        return {
            name for name, gid in found if gid[:2] == _FAST_DDS and gid[:4] in hosts and gid[4:6] in wanted
        }

    def _list_writers(self) -> "list[tuple[str, bytes]]":
        """List (node, identifier) of the writer that each node has."""
        return [
            (each.node_namespace.rstrip("/") + "/" + each.node_name, bytes(each.endpoint_gid))
            for each in self.node.get_publishers_info_by_topic("/parameter_events")
        ]

    def _read_lifecycle(self, node: str) -> str:
        if node not in self.clients:
            kind: "Any" = importlib.import_module("lifecycle_msgs.srv").GetState
            self.clients[node] = self.node.create_client(kind, node + "/get_state"), kind
        client, kind = self.clients[node]
        if not client.wait_for_service(timeout_sec=_SERVICE_S):
            return "without a lifecycle"
        answer = client.call_async(kind.Request())
        if not _wait_for(answer.done, _SERVICE_S):
            return "silent"
        return str(answer.result().current_state.label)

    def _hear(self, topic: str, within_s: float, of: "list[str]") -> bool:
        """Whether a message comes; of any publisher, whatever its quality of service, or of one whose
        identifier begins with one of ``of``.
        """
        if not self.discover(lambda: topic in dict(self.node.get_topic_names_and_types())):
            return False
        until = time.monotonic() + within_s + _DISCOVERY_S
        package, _, name = dict(self.node.get_topic_names_and_types())[topic][0].partition("/msg/")
        qos: "Any" = importlib.import_module("rclpy.qos")
        profile = qos.QoSProfile(depth=1, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
        heard = threading.Event()

        def hear_one(_message: bytes, info: "Any") -> None:
            sender = (info.get("publisher_gid") or {}).get("data")
            if sender is None or any(bytes(sender).hex().startswith(each) for each in of):
                heard.set()

        subscription = self.node.create_subscription(
            getattr(importlib.import_module(package + ".msg"), name),
            topic,
            hear_one if of else lambda _: heard.set(),
            profile,
            raw=True,
        )
        try:
            return heard.wait(max(0.0, until - time.monotonic()))
        finally:
            self.node.destroy_subscription(subscription)


def _list_below(root: int) -> "set[int]":
    """List the process and all below it."""
    parents = {}
    for name in os.listdir("/proc"):
        try:
            with open("/proc/%d/stat" % int(name), "rb") as file:
                parents[int(name)] = int(file.read().rpartition(b")")[2].split()[1])
        except (OSError, ValueError):
            continue
    found, before = {root}, set()  # type: set[int], set[int]
    while found != before:
        before = found
        found = found | {pid for pid, parent in parents.items() if parent in found}
    return found


class Lifecycles:
    """Transitions of nodes with a lifecycle. Those of one node are made one after the other."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._clients: "dict[str, Any]" = {}
        self._locks: "dict[str, Any]" = {}

    def answer(self, asked: "dict[str, Any]") -> str:
        """Make the transition ``change``, or with ``warm`` only what it needs; the fault, empty for none."""
        node, until = asked["node"], time.monotonic() + float(asked["within_s"])
        lock = self._locks.setdefault(node, threading.Lock())
        if not lock.acquire(timeout=float(asked["within_s"])):
            return "node %s is in another transition" % node
        try:
            fault = self._find_ambiguity(node, int(asked.get("root", 0))) or self._connect(node)
            if fault or asked.get("warm"):
                return fault or self._read_state(node, until)[1]
            return self._change(node, asked["change"], until)
        finally:
            lock.release()

    def _find_ambiguity(self, node: str, root: int) -> str:
        """A service of two nodes of one name reaches both, so such nodes are left alone.

        ``root``: below this process is the node that is meant, as far as that can be seen; 0: it was already.
        """
        known = self._graph.discover(lambda: self._graph.count_nodes(node))
        if not known or (root and not self._graph.discover(lambda: self._graph.is_node_below(node, root))):
            return "node %s of this task is not in the graph" % node
        count = self._graph.count_nodes(node)
        if count == 1:
            return ""
        return "%d nodes are called %s: write {host} into the name" % (count, node)

    def _connect(self, node: str) -> str:
        if node not in self._clients:
            services: "Any" = importlib.import_module("lifecycle_msgs.srv")
            self._clients[node] = {
                name: (self._graph.node.create_client(kind, node + "/" + name), kind)
                for name, kind in (("get_state", services.GetState), ("change_state", services.ChangeState))
            }
        clients = [client for client, _ in self._clients[node].values()]
        if not _wait_for(lambda: all(client.service_is_ready() for client in clients), _SERVICE_S):
            return "node %s is without a lifecycle" % node
        return ""

    def _change(self, node: str, name: str, until: float) -> str:
        transition, goal = _TRANSITIONS[name]
        if name == "configure":
            state, fault = self._read_state(node, until)
            if fault or state == goal:
                return fault
            if state != "unconfigured":
                return "node %s is %s: it is to wait for its activation" % (node, state)
        request = self._clients[node]["change_state"][1].Request()
        request.transition.id = transition
        # It also declines because it is in the new state already: that counts, not its answer.
        if self._call(node, "change_state", request, until) is None:
            return "node %s does not answer" % node
        # Another one may have been discovered meanwhile.
        fault = self._find_ambiguity(node, 0)
        state, silent = self._read_state(node, until)
        if fault or silent or state == goal:
            return fault or silent
        return "node %s is %s, not %s" % (node, state, goal)

    def _read_state(self, node: str, until: float) -> "tuple[str, str]":
        """Read (the state, why it is not known)."""
        kind = self._clients[node]["get_state"][1]
        answer = self._call(node, "get_state", kind.Request(), until)
        if answer is None:
            return "", "node %s does not answer" % node
        return str(answer.current_state.label), ""

    def _call(self, node: str, name: str, request: "Any", until: float) -> "Any":
        """The answer of a service; None where there is none in time."""
        client, done = self._clients[node][name][0], threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: done.set())
        if not done.wait(max(0.0, until - time.monotonic())):
            client.remove_pending_request(future)
            return None
        return future.result()


def _wait_for(condition: "Any", seconds: float) -> bool:
    until = time.monotonic() + seconds
    while not condition():
        if time.monotonic() >= until:
            return False
        time.sleep(_POLL_S)
    return True


def _serve(graph: Graph, peer: socket.socket) -> None:
    with peer:
        peer.settimeout(30.0)
        credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        if struct.unpack("3i", credentials)[1] != os.geteuid():
            return
        try:
            asked = json.loads(peer.recv(_MOST_BYTES).decode("utf-8"))
            fault = graph.answer(asked)
        except Exception as error:  # noqa: BLE001 - the answer is the only channel
            fault = "%s: %s" % (type(error).__name__, error)
        peer.sendall(b"=" + fault.encode("utf-8", "replace"))


def main(name: str) -> None:
    """Serve until killed; end at once where another helper has the name."""
    server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        server.bind("\0" + name)
    except OSError:
        return
    graph = Graph()
    server.listen(16)
    while True:
        peer, _ = server.accept()
        threading.Thread(target=_serve, args=(graph, peer), daemon=True).start()


if __name__ == "__main__":
    main(sys.argv[1])
