# SPDX-License-Identifier: Apache-2.0
"""Client of etcd's JSON gateway (version 3.4 and later) over HTTP/1.1. Every call has one deadline."""

import base64
import binascii
import contextlib
import http.client
import json
import socket
import ssl
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.errors import AuthError, CoordinationError
from edgectl.model.inventory import Coordination
from edgectl.model.text import escape_unprintable
from edgectl.transport.passwords import run_password_program
from edgectl.transport.sockets import connect_tcp, hang_up, watchdog

# Of one call over all endpoints, seconds: longer than the election of a new leader takes.
CALL_TIMEOUT_S = 5.0
# The state of a fleet is at most 1 MiB (etcd's own bound is 1.5 MiB), in base64.
_MAX_REPLY_BYTES, _MAX_ERROR_LENGTH = 1 << 22, 200
_MAX_INTEGER = 2**63
Document = dict[str, object]


class _EndpointError(Exception):
    """One endpoint did not answer, or answered with an error that another one may not have."""


class _RefusedError(Exception):
    """etcd understood the call and refused it. ``code``: of gRPC."""

    def __init__(self, message: str, code: object) -> None:
        super().__init__(message)
        self.code = code


# What a member replies to a read during which the members chose another leader.
_LEADER_CHANGED = "leader changed"
_INVALID_ARGUMENT, _NOT_FOUND, _DENIED, _UNAUTHENTICATED = 3, 5, 7, 16
# Codes of errors that a call repeated at another endpoint does not meet again.
_FINAL_CODES = (_INVALID_ARGUMENT, _NOT_FOUND, _DENIED, _UNAUTHENTICATED)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyValue:
    """A key with its value, the revision of its last write, and the lease that it ends with (0: none)."""

    key: str
    value: bytes
    revision: int
    lease: int


class EtcdClient:
    """Calls to the endpoints of one etcd: the one that answered last first, the others in turn.

    Safe to use from several threads.
    """

    def __init__(self, place: Coordination) -> None:
        self._place = place
        self._first = 0
        self._token = ""

    def call(self, operation: str, body: Mapping[str, object], *, timeout: float | None = None) -> Document:
        """The reply to one call, such as ``kv/txn``; empty where etcd knows of no such thing (a lease).
        ``timeout`` (s): of all endpoints together.

        Raises:
            CoordinationError: no endpoint answers in time, or etcd refuses the call.
        """
        try:
            return self._call_with_token(operation, body, time.monotonic() + (timeout or CALL_TIMEOUT_S))
        except _RefusedError as error:
            if error.code == _NOT_FOUND:
                return {}
            raise CoordinationError(
                f"etcd refuses {operation}: {error}", hint="check user and password_command of coordination"
            ) from None

    def _call_with_token(self, operation: str, body: Mapping[str, object], deadline: float) -> Document:
        """Log in first where there is a user, and once more where the token has run out."""
        if self._place.user and not self._token:
            self._token = self._log_in(deadline)
        try:
            return self._try_endpoints(operation, body, deadline)
        except _RefusedError as error:
            if error.code != _UNAUTHENTICATED or not self._place.user:
                raise
        self._token = self._log_in(deadline)
        return self._try_endpoints(operation, body, deadline)

    def _log_in(self, deadline: float) -> str:
        try:
            password = run_password_program(self._place.password_command)
        except AuthError as error:
            raise CoordinationError(f"user of etcd: {error.message}", hint=error.hint) from error
        self._token = ""
        reply = self._try_endpoints(
            "auth/authenticate", {"name": self._place.user, "password": password}, deadline
        )
        token = reply.get("token")
        # It becomes a line of the header.
        if not isinstance(token, str) or not token.isascii() or not token.isprintable():
            raise CoordinationError("etcd sent no valid token for its user")
        return token

    def _try_endpoints(self, operation: str, body: Mapping[str, object], deadline: float) -> Document:
        """The first reply. What is left of the time is divided among the endpoints that are left."""
        endpoints = self._place.endpoints
        order = [(self._first + number) % len(endpoints) for number in range(len(endpoints))]
        failures = []
        for left, number in zip(range(len(order), 0, -1), order, strict=True):
            seconds = (deadline - time.monotonic()) / left
            try:
                reply = self._ask_leader(number, f"/v3/{operation}", body, seconds)
            except _EndpointError as error:
                failures.append(f"{format_endpoint(endpoints[number])}: {error}")
            else:
                self._first = number
                return reply
        raise CoordinationError(
            f"etcd does not answer ({'; '.join(failures)})",
            hint="without it the fleet is not changed; check: edgectl doctor",
        )

    def _ask_leader(self, number: int, path: str, body: Mapping[str, object], seconds: float) -> Document:
        """The reply, also where the members chose another leader while they worked on the call.

        They reply so once they have a leader again, so this member serves the next call, and may be the last
        that is left to ask.
        """
        deadline = time.monotonic() + seconds
        try:
            return self._ask(number, path, body, seconds)
        except _EndpointError as error:
            if _LEADER_CHANGED not in str(error):
                raise
        return self._ask(number, path, body, deadline - time.monotonic())

    def _ask(self, number: int, path: str, body: Mapping[str, object], seconds: float) -> Document:
        status, reply = self._exchange(number, path, json.dumps(body).encode(), seconds)
        document = _decode_object(reply)
        if status == http.HTTPStatus.OK:
            return document
        message = escape_unprintable(str(document.get("message") or document.get("error") or status))
        message = message[:_MAX_ERROR_LENGTH]
        if document.get("code") in _FINAL_CODES:
            raise _RefusedError(message, document.get("code"))
        raise _EndpointError(message)

    def _exchange(self, number: int, path: str, body: bytes | None, seconds: float) -> tuple[int, bytes]:
        """Status and body of the reply of one endpoint, within ``seconds``.

        Raises:
            _EndpointError: there is none.
        """
        host, port = self._place.endpoints[number]
        lines = [
            f"{'GET' if body is None else 'POST'} {path} HTTP/1.1",
            f"Host: {format_endpoint((host, port))}",
            "Connection: close",
            *([] if body is None else ["Content-Type: application/json", f"Content-Length: {len(body)}"]),
            *([f"Authorization: {self._token}"] if self._token else []),
        ]
        request = "\r\n".join([*lines, "", ""]).encode() + (body or b"")
        try:
            with self._connect(host, port, seconds) as line:
                line.sendall(request)
                return _read_reply(line)
        except TimeoutError:
            raise _EndpointError(f"no answer within {seconds:.1f} s") from None
        except ssl.SSLError as error:
            raise _EndpointError(f"TLS: {_describe_ssl_error(error)}") from error
        except OSError as error:
            raise _EndpointError((error.strerror or str(error)).lower()) from error
        except (http.client.HTTPException, ValueError) as error:
            raise _EndpointError("not the answer of an etcd") from error

    @contextlib.contextmanager
    def _connect(self, host: str, port: int, seconds: float) -> Iterator[socket.socket]:
        """A connection that is cut after ``seconds``, with TLS where it is asked for.

        Raises:
            TimeoutError: it was cut.
        """
        deadline = time.monotonic() + seconds
        line: socket.socket = connect_tcp(host, port, timeout=seconds)
        try:
            socket.socket.settimeout(line, max(0.001, deadline - time.monotonic()))
            if self._place.tls:
                context = self._build_context()
                line = context.wrap_socket(line, server_hostname=host, do_handshake_on_connect=False)
            with watchdog(deadline - time.monotonic(), lambda: hang_up(line)) as watch:
                try:
                    if isinstance(line, ssl.SSLSocket):
                        line.do_handshake()
                    yield line
                except (OSError, http.client.HTTPException, ValueError):
                    if not watch.expired:
                        raise
            if watch.expired:  # also where what came until then looks like the whole
                raise TimeoutError
        finally:
            line.close()

    def _build_context(self) -> ssl.SSLContext:
        """Certificates are verified, by ``ca`` where it is stated.

        Raises:
            CoordinationError: a file cannot be read.
        """
        place = self._place
        files = {
            key: str(Path(value).expanduser())
            for key in ("ca", "cert", "key")
            if (value := getattr(place, key))
        }
        try:
            context = ssl.create_default_context(cafile=files.get("ca"))
            if "cert" in files:
                context.load_cert_chain(files["cert"], files["key"])
        except OSError as error:
            raise CoordinationError(
                f"cannot read a certificate of coordination: {error.strerror or error}",
                hint=f"check {', '.join(files)} in the inventory",
            ) from error
        return context

    def read_versions(self) -> dict[tuple[str, int], str | CoordinationError]:
        """By endpoint the version of its etcd, or why it does not serve requests; for diagnosis."""
        found: dict[tuple[str, int], str | CoordinationError] = {}
        for number, endpoint in enumerate(self._place.endpoints):
            alone = EtcdClient(replace(self._place, endpoints=(endpoint,)))
            try:
                _, reply = self._exchange(number, "/version", None, CALL_TIMEOUT_S)
                version = escape_unprintable(str(_decode_object(reply).get("etcdserver", "")))[:40]
                alone.call("kv/range", {"key": encode_text("edgectl/")})
                found[endpoint] = version
            except _EndpointError as error:
                found[endpoint] = CoordinationError(str(error))
            except CoordinationError as error:
                found[endpoint] = error
        return found


def format_endpoint(endpoint: tuple[str, int]) -> str:
    """``host:port``."""
    host, port = endpoint
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _read_reply(line: socket.socket) -> tuple[int, bytes]:
    response = http.client.HTTPResponse(line)
    try:
        response.begin()
        body = response.read(_MAX_REPLY_BYTES + 1)
        if len(body) > _MAX_REPLY_BYTES:
            raise ValueError("too long")
        return response.status, body
    finally:
        response.close()


def _decode_object(reply: bytes) -> Document:
    try:
        document = json.loads(reply)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise _EndpointError("not the answer of an etcd")
    return document


def _describe_ssl_error(error: ssl.SSLError) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return error.verify_message.lower()
    return (error.reason or "failed").lower().replace("_", " ")


def encode_text(text: str) -> str:
    """A key or a value as the gateway takes it."""
    return base64.b64encode(text.encode()).decode()


def read_integer(document: object, key: str) -> int:
    """A number of a reply; 0 where it is left out.

    Raises:
        CoordinationError: it is none.
    """
    value = document.get(key, 0) if isinstance(document, dict) else None
    if isinstance(value, str) and value.isascii() and value.isdecimal() and len(value) < 20:
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < _MAX_INTEGER:
        raise build_invalid_reply(key)
    return value


def read_pairs(document: object) -> tuple[KeyValue, ...]:
    """The keys of a range.

    Raises:
        CoordinationError: they are not valid.
    """
    listed = document.get("kvs", []) if isinstance(document, dict) else None
    if not isinstance(listed, list) or not all(isinstance(each, dict) for each in listed):
        raise build_invalid_reply("kvs")
    return tuple(
        KeyValue(
            key=_decode_bytes(each, "key").decode(errors="replace"),
            value=_decode_bytes(each, "value"),
            revision=read_integer(each, "mod_revision"),
            lease=read_integer(each, "lease"),
        )
        for each in listed
    )


def read_responses(document: Document, count: int) -> Sequence[Document]:
    """The responses of a transaction, as many as it had operations.

    Raises:
        CoordinationError: they are not valid.
    """
    listed = document.get("responses", [])
    if not isinstance(listed, list) or len(listed) != count:
        raise build_invalid_reply("responses")
    return [each if isinstance(each, dict) else {} for each in listed]


def _decode_bytes(document: Document, key: str) -> bytes:
    value = document.get(key, "")
    if not isinstance(value, str):
        raise build_invalid_reply(key)
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError):
        raise build_invalid_reply(key) from None


def build_invalid_reply(key: str) -> CoordinationError:
    """The error of a reply that is not etcd's."""
    return CoordinationError(
        f"the reply of etcd has no valid {key}", hint="edgectl needs etcd 3.4 or later; check: edgectl doctor"
    )
