# SPDX-License-Identifier: Apache-2.0
"""Program that reads the last message of a latched topic of ROS 1, or offers it to the nodes of a task.

Run as ``python3 -c TEXT save|load`` with what it needs in its environment; the state is standard output or
input: a line of JSON (type, md5sum, definition), then the message as it was sent. No part of ROS is needed.
Only nodes of the task in ``EDGECTL_STATE_OF`` get the message; others stay connected and get nothing.
"""

import json
import os
import socket
import struct
import sys
import threading
import time
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_MOST_HEADER = 1 << 20
_CALL_S, _RETRY_S = 5.0, 0.2
_CALLER = "/edgectl_state_%d" % os.getpid()
_KEPT = ("type", "md5sum", "message_definition")


def read_exactly(peer: socket.socket, count: int) -> bytes:
    """Receive ``count`` bytes. OSError where the connection ends before."""
    parts = []
    while count:
        part = peer.recv(min(count, 1 << 16))
        if not part:
            raise OSError("the connection was closed")
        parts.append(part)
        count -= len(part)
    return b"".join(parts)


def read_header(peer: socket.socket) -> "dict[str, str]":
    """Receive the header of a connection."""
    size = struct.unpack("<I", read_exactly(peer, 4))[0]
    if size > _MOST_HEADER:
        raise OSError("it does not speak TCPROS")
    data, at, fields = read_exactly(peer, size), 0, {}
    while at + 4 <= len(data):
        length = struct.unpack_from("<I", data, at)[0]
        name, _, value = data[at + 4 : at + 4 + length].partition(b"=")
        fields[name.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
        at += 4 + length
    return fields


def write_header(peer: socket.socket, fields: "dict[str, str]") -> None:
    """Send the header of a connection."""
    lines = [("%s=%s" % pair).encode("utf-8") for pair in fields.items()]
    data = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    peer.sendall(struct.pack("<I", len(data)) + data)


def call(proxy: "Any", method: str, *params: object) -> "Any":
    """Call a method of the ROS APIs. OSError where it does not succeed."""
    code, message, value = getattr(proxy, method)(_CALLER, *params)
    if code != 1:
        raise OSError("%s: %s" % (method, message))
    return value


def save(topic: str, master: "Any", until: float) -> None:
    """Print the message that a publisher of the topic sends to a new subscriber."""
    why = "it has no publisher"
    while time.monotonic() < until:
        for node in find_publishers(topic, master):
            try:
                return print_message(topic, call(master, "lookupNode", node), until)
            except Exception as error:  # noqa: BLE001 - another publisher may answer
                why = "%s: %s" % (node, error)
        time.sleep(_RETRY_S)
    sys.exit("no message on %s: %s" % (topic, why))


def find_publishers(topic: str, master: "Any") -> "list[str]":
    """Find the nodes that publish the topic."""
    publishers = call(master, "getSystemState")[0]
    return [node for name, nodes in publishers if name == topic for node in nodes]


def print_message(topic: str, uri: str, until: float) -> None:
    """Subscribe to one node, without the master, and print its first message."""
    _, address, port = call(ServerProxy(uri), "requestTopic", topic, [["TCPROS"]])
    peer = socket.create_connection((address, port), max(0.1, until - time.monotonic()))
    write_header(peer, {"callerid": _CALLER, "topic": topic, "md5sum": "*", "type": "*"})
    header = read_header(peer)
    if "error" in header:
        raise OSError(header["error"])
    size = struct.unpack("<I", read_exactly(peer, 4))[0]
    out, head = sys.stdout.buffer, {key: header.get(key, "") for key in _KEPT}
    out.write(json.dumps(head).encode("ascii") + b"\n")
    while size:
        part = read_exactly(peer, min(size, 1 << 16))
        out.write(part)
        size -= len(part)
    out.flush()


class Offer:
    """A node that publishes one message, to the nodes of one task."""

    def __init__(self, topic: str, head: "dict[str, str]", message: bytes) -> None:
        self.topic, self.head, self.message = topic, head, message
        self.read = threading.Event()
        self.address = os.environ.get("ROS_IP") or os.environ.get("ROS_HOSTNAME") or "127.0.0.1"
        self.data = socket.socket()
        self.data.bind(("", 0))
        self.data.listen(16)
        self.api = SimpleXMLRPCServer(("", 0), _QuietHandler, logRequests=False, allow_none=True)
        self.uri = "http://%s:%d/" % (self.address, self.api.server_address[1])
        answers: "dict[str, Any]" = {"requestTopic": self._offer_topic, "getPid": self._get_pid}
        for name in ("publisherUpdate", "paramUpdate", "getBusInfo", "getBusStats", "getSubscriptions"):
            answers[name] = lambda *_: [1, "", 0]
        for name, answer in answers.items():
            self.api.register_function(answer, name)
        for work in (self.api.serve_forever, self._accept):
            threading.Thread(target=work, daemon=True).start()

    def _get_pid(self, _caller: str) -> "list[Any]":
        return [1, "", os.getpid()]

    def _offer_topic(self, _caller: str, topic: str, _protocols: object) -> "list[Any]":
        if topic != self.topic:
            return [0, "not published here", []]
        return [1, "", ["TCPROS", self.address, self.data.getsockname()[1]]]

    def _accept(self) -> None:
        while True:
            peer, _ = self.data.accept()
            threading.Thread(target=self._serve, args=(peer,), daemon=True).start()

    def _serve(self, peer: socket.socket) -> None:
        """Send the message to a node of the task, and wait until it has read all of it."""
        peer.settimeout(_CALL_S)
        asked = read_header(peer)
        if asked.get("md5sum") not in ("*", self.head["md5sum"]):
            return write_header(peer, {"error": "%s is a %s" % (self.topic, self.head["type"])})
        write_header(peer, dict(self.head, callerid=_CALLER, latching="1", topic=self.topic))
        if not is_of_task(asked.get("callerid", "")):
            time.sleep(3600)
        peer.sendall(struct.pack("<I", len(self.message)) + self.message)
        while has_unread(peer):
            time.sleep(0.01)
        self.read.set()
        time.sleep(3600)
        return None


class _QuietHandler(SimpleXMLRPCRequestHandler):
    rpc_paths = ()

    def log_message(self, *_: object) -> None:
        """Write nothing."""


def has_unread(peer: socket.socket) -> bool:
    """Whether the other side has not yet acknowledged all that was sent to it (SIOCOUTQ)."""
    from fcntl import ioctl

    return ioctl(peer, 0x5411, b"\0\0\0\0") != b"\0\0\0\0"


def is_of_task(node: str) -> bool:
    """Whether the node is a process of the task on this host."""
    mark = b"EDGECTL_TASK_DIR=" + os.fsencode(os.environ["EDGECTL_STATE_OF"])
    try:
        pid = call(ServerProxy(call(ServerProxy(os.environ["ROS_MASTER_URI"]), "lookupNode", node)), "getPid")
        with open("/proc/%d/environ" % pid, "rb") as file:
            return mark in file.read().split(b"\0")
    except Exception:  # noqa: BLE001 - a node that is not there is none of the task
        return False


def load(topic: str, master: "Any", until: float) -> None:
    """Offer what standard input has until a node of the task has read it."""
    head = json.loads(sys.stdin.buffer.readline().decode("ascii"))
    offer = Offer(topic, head, sys.stdin.buffer.read())
    call(master, "registerPublisher", topic, head["type"], offer.uri)
    try:
        if not offer.read.wait(max(0.0, until - time.monotonic())):
            sys.exit("no node of the task has read %s" % topic)
    finally:
        call(master, "unregisterPublisher", topic, offer.uri)


def main(verb: str) -> None:
    """Save or load within ``EDGECTL_STATE_SECONDS``."""
    uri = os.environ.get("ROS_MASTER_URI", "")
    if not uri:
        sys.exit("no ROS_MASTER_URI: state ros: {master: ..} in the inventory")
    socket.setdefaulttimeout(_CALL_S)
    until = time.monotonic() + float(os.environ["EDGECTL_STATE_SECONDS"])
    work = save if verb == "save" else load
    try:
        work(os.environ["EDGECTL_STATE_TOPIC"], ServerProxy(uri), until)
    except OSError as error:
        sys.exit("master %s: %s" % (uri, error))


if __name__ == "__main__":
    main(sys.argv[1])
