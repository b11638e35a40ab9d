# SPDX-License-Identifier: Apache-2.0
"""XML-RPC calls to the master and the nodes of ROS 1: texts and lists out, any value but structures in.

Package xmlrpc costs 60 ms of CPU to import on a small host, more than the question itself.
"""

import time

from ..measure import network
from ..measure.sockets import socket

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_MAX_REPLY_BYTES = 8 << 20
_BLOCK = 1 << 16


class CallError(Exception):
    """The call failed; the text says why."""


class NobodyListensError(CallError):
    """The host says that nobody listens at this port."""


def split_uri(uri: str) -> "tuple[str, int]":
    """Split ``http://host:port/`` or ``rosrpc://host:port``. CallError where it is none."""
    place = uri.partition("://")[2].partition("/")[0]
    host, _, port = place.rpartition(":")
    if not host or not port.isdigit():
        raise CallError("%s is no address" % uri)
    return host.strip("[]"), int(port)


def connect(host: str, port: int, deadline: float) -> "socket.socket":
    """Connect by ``deadline`` (monotonic). Raises CallError."""
    found = network.resolve_robots([{"robot": "", "address": host}]).get("") or []
    if not found:
        raise CallError("%s is a name that this host cannot resolve" % host)
    made = socket.socket(socket.AF_INET6 if ":" in found[0] else socket.AF_INET, socket.SOCK_STREAM)
    try:
        made.settimeout(_compute_left(deadline))
        made.connect((found[0], port))
    except OSError as error:
        made.close()
        if isinstance(error, ConnectionRefusedError):
            raise NobodyListensError(error.strerror) from error
        raise CallError(error.strerror or "no answer in time") from error
    return made


def _compute_left(deadline: float) -> float:
    return max(0.01, deadline - time.monotonic())


def receive_exactly(made: "socket.socket", count: int, deadline: float) -> bytes:
    """Receive ``count`` bytes by ``deadline``. Raises CallError."""
    parts, left = [], count
    while left:
        part = receive_some(made, min(left, _BLOCK), deadline)
        if not part:
            raise CallError("the connection was closed")
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def receive_some(made: "socket.socket", count: int, deadline: float) -> bytes:
    """Receive up to ``count`` bytes; empty at the end. Raises CallError."""
    if time.monotonic() >= deadline:
        raise CallError("no answer in time")
    try:
        made.settimeout(_compute_left(deadline))
        return made.recv(count)
    except OSError as error:
        raise CallError(error.strerror or "no answer in time") from error


def call_ros(uri: str, method: str, params: "list[Any]", deadline: float) -> "Any":
    """Call a method of the ROS APIs: the value of its reply ``[code, message, value]``.

    Raises:
        CallError: no reply by ``deadline`` (monotonic), or one that is no success.
    """
    reply = _call(uri, method, params, deadline)
    if not isinstance(reply, list) or len(reply) != 3:
        raise CallError("%s does not speak the API of ROS" % uri)
    if reply[0] != 1:
        raise CallError(str(reply[1]) or "it was refused")
    return reply[2]


def _call(uri: str, method: str, params: "list[Any]", deadline: float) -> "Any":
    host, port = split_uri(uri)
    inner = "".join("<param>%s</param>" % _encode(each) for each in params)
    body = "<?xml version='1.0'?><methodCall><methodName>%s</methodName><params>%s</params></methodCall>" % (
        method,
        inner,
    )
    data = body.encode("utf-8")
    shown = "[%s]" % host if ":" in host else host
    head = (
        "POST /RPC2 HTTP/1.1\r\nHost: %s:%d\r\nContent-Type: text/xml\r\n"
        "Content-Length: %d\r\nConnection: close\r\n\r\n"
    )
    made = connect(host, port, deadline)
    try:
        made.sendall((head % (shown, port, len(data))).encode("ascii") + data)
        return parse_reply(_receive_body(made, deadline))
    except OSError as error:
        raise CallError(error.strerror or "no answer in time") from error
    finally:
        made.close()


def _receive_body(made: "socket.socket", deadline: float) -> bytes:
    data = b""
    while b"\r\n\r\n" not in data:
        part = receive_some(made, _BLOCK, deadline)
        if not part or len(data) > _BLOCK:
            raise CallError("it does not speak HTTP")
        data += part
    head, _, body = data.partition(b"\r\n\r\n")
    size = _find_length(head)
    while size is None or len(body) < size:
        part = receive_some(made, _BLOCK, deadline)
        if not part or len(body) > _MAX_REPLY_BYTES:
            break
        body += part
    return body


def _find_length(head: bytes) -> "int | None":
    for line in head.lower().split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name == b"content-length" and value.strip().isdigit():
            return min(int(value), _MAX_REPLY_BYTES)
    return None


def _encode(value: "Any") -> str:
    if isinstance(value, list):
        return "<value><array><data>%s</data></array></value>" % "".join(_encode(each) for each in value)
    text = str(value).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return "<value><string>%s</string></value>" % text


class _ReplyReader:
    """Handlers of the parser that build the value of a reply."""

    def __init__(self) -> None:
        self.value: "Any" = None
        self.fault = False
        self._lists: "list[list[Any]]" = []
        self._text: "list[str]" = []
        self._kind, self._scalar = "string", True

    def begin(self, name: str, _attributes: object) -> None:
        if name == "value":
            self._text, self._kind, self._scalar = [], "string", True
        elif name == "data":
            self._lists.append([])
        elif name == "fault":
            self.fault = True
        elif name in ("int", "i4", "i8", "boolean", "double"):
            self._kind = name
            self._text = []
        elif name == "string":
            self._text = []

    def add(self, text: str) -> None:
        self._text.append(text)

    def end(self, name: str) -> None:
        if name == "data":
            self.value, self._scalar = self._lists.pop(), False
        elif name == "value":
            if self._scalar:
                self.value = self._convert("".join(self._text))
            self._scalar = False
            if self._lists:
                self._lists[-1].append(self.value)

    def _convert(self, text: str) -> "Any":
        if self._kind == "string":
            return text
        return float(text) if self._kind == "double" else int(text)

    def forbid(self, *_declaration: object) -> None:
        raise CallError("its reply declares a document type")


def parse_reply(body: bytes) -> "Any":
    """Parse the body of a reply. CallError for a fault, or where it is none."""
    from xml.parsers import expat

    reader, parser = _ReplyReader(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = reader.begin, reader.end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = reader.add, reader.forbid
    try:
        parser.Parse(body, True)
    except (expat.ExpatError, ValueError, IndexError) as error:
        raise CallError("its reply cannot be read: %s" % error) from error
    if reader.fault:
        raise CallError("it answered with a fault")
    return reader.value
