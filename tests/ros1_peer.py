# SPDX-License-Identifier: Apache-2.0
"""A master and a node of ROS 1 that speak its APIs (XML-RPC, TCPROS) with the standard library alone.

They are real peers on real sockets for what edgectl asks the graph; make ros asks a real ROS the same.
Run as a program it is a node: ``ros1_peer.py MASTER_URI NAME [TOPIC]`` registers, publishes and says its goodbye
never, as a killed node does. ``ros1_peer.py master PORT`` is a master.
"""

import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer


class QuietHandler(SimpleXMLRPCRequestHandler):
    """Answers on any path, and says nothing."""

    rpc_paths = ()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - its name in the base class
        pass


class Master:
    """The registry of a ROS 1 master: nodes, publishers and services by name."""

    def __init__(self) -> None:
        self.nodes: dict[str, str] = {}
        self.publishers: dict[str, list[str]] = {}
        self.services: dict[str, str] = {}
        self.uri = ""

    def look_up_node(self, _caller: str, node: str) -> list[object]:
        return self._look_up(self.nodes, node)

    def look_up_service(self, _caller: str, service: str) -> list[object]:
        return self._look_up(self.services, service)

    def get_state(self, _caller: str) -> list[object]:
        return [1, "", [[[name, nodes] for name, nodes in self.publishers.items()], [], []]]

    def register_publisher(self, caller: str, topic: str, _kind: str, uri: str) -> list[object]:
        self.nodes[caller] = uri
        self.publishers.setdefault(topic, []).append(caller)
        return [1, "", []]

    def register_service(self, caller: str, service: str, uri: str, api: str) -> list[object]:
        self.nodes[caller], self.services[service] = api, uri
        return [1, "", 0]

    def forget(self) -> None:
        """What a restart of the master does."""
        self.nodes.clear()
        self.publishers.clear()
        self.services.clear()

    def get_methods(self) -> dict[str, Any]:
        """The methods by their names in the API."""
        return {
            "lookupNode": self.look_up_node,
            "lookupService": self.look_up_service,
            "getSystemState": self.get_state,
            "registerPublisher": self.register_publisher,
            "registerService": self.register_service,
        }

    @staticmethod
    def _look_up(known: dict[str, str], name: str) -> list[object]:
        return [1, "", known[name]] if name in known else [-1, f"unknown {name}", ""]


class ReusingServer(SimpleXMLRPCServer):
    """Takes its port again at once, as roscore does."""

    allow_reuse_address = True


@contextmanager
def open_master(port: int = 0) -> Iterator[tuple[Master, SimpleXMLRPCServer]]:
    """A master that listens, and serves once its server does."""
    with ReusingServer(("127.0.0.1", port), QuietHandler, logRequests=False, allow_none=True) as server:
        master = Master()
        master.uri = f"http://127.0.0.1:{server.server_address[1]}"
        for name, method in master.get_methods().items():
            server.register_function(method, name)
        yield master, server


@contextmanager
def serve_master() -> Iterator[Master]:
    """A master on a free port of this machine."""
    with open_master() as (master, server):
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        try:
            yield master
        finally:
            server.shutdown()
            thread.join()


class Node:
    """The slave API of one node that publishes one topic and offers one service."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.data = socket.create_server(("127.0.0.1", 0))

    def get_pid(self, _caller: str) -> list[object]:
        return [1, "", os.getpid()]

    def request_topic(self, _caller: str, topic: str, _protocols: object) -> list[object]:
        if topic != self.topic:
            return [0, "not published here", []]
        return [1, "", ["TCPROS", "127.0.0.1", self.data.getsockname()[1]]]

    def serve_data(self) -> None:
        """Send a message each 20 ms to whoever connects for the topic; answer the probe of a service."""
        while True:
            peer, _ = self.data.accept()
            threading.Thread(target=self._send, args=(peer,), daemon=True).start()

    def _send(self, peer: socket.socket) -> None:
        size = struct.unpack("<I", peer.recv(4))[0]
        asked = peer.recv(size)
        field = b"callerid=/node"
        peer.sendall(struct.pack("<II", len(field) + 4, len(field)) + field)
        while b"probe=1" not in asked:
            peer.sendall(struct.pack("<I", 4) + b"ping")
            time.sleep(0.02)


def run_node(master: str, name: str, topic: str) -> None:
    """Register and serve until killed."""
    node = Node(topic)
    threading.Thread(target=node.serve_data, daemon=True).start()
    with SimpleXMLRPCServer(("127.0.0.1", 0), QuietHandler, logRequests=False, allow_none=True) as server:
        api = f"http://127.0.0.1:{server.server_address[1]}/"
        methods: dict[str, Any] = {"getPid": node.get_pid, "requestTopic": node.request_topic}
        for method_name, method in methods.items():
            server.register_function(method, method_name)
        proxy = ServerProxy(master)
        proxy.registerPublisher(name, topic, "std_msgs/String", api)
        proxy.registerService(name, f"{name}/ask", f"rosrpc://127.0.0.1:{node.data.getsockname()[1]}", api)
        server.serve_forever()


def main(first: str, second: str, topic: str = "/chatter") -> None:
    """Be a master, or a node, until killed."""
    if first != "master":
        run_node(first, second, topic)
    with open_master(int(second)) as (_, server):
        server.serve_forever()


if __name__ == "__main__":
    main(*sys.argv[1:])
