# SPDX-License-Identifier: Apache-2.0
"""Clients on a connected line, with our policy of host keys, order of key types and bounds of key exchanges.

A host is reached by paramiko's client, a jump host by a connection of Fabric, which is imported for the first
of them (ADR 164). Both verify, log in and are bounded by the same objects.
"""

import hmac
import struct
import threading
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import paramiko
from paramiko import packet, util
from paramiko.common import MSG_CHANNEL_CLOSE, MSG_CHANNEL_FAILURE, MSG_CHANNEL_WINDOW_ADJUST

from edgectl.deferred_imports import import_deferred
from edgectl.transport.host_keys import HostKeyVerifier
from edgectl.transport.known_hosts import HostKey
from edgectl.transport.sockets import REKEY_BYTES, Line
from edgectl.transport.ssh_auth import LoginStrategy
from edgectl.transport.ssh_config import ResolvedHost

# Kinds that begin with the server's number of a channel.
_CHANNEL_MESSAGES = range(MSG_CHANNEL_WINDOW_ADJUST, MSG_CHANNEL_FAILURE + 1)
_CURVE25519, _P256 = "curve25519-sha256@libssh.org", "ecdh-sha2-nistp256"


# paramiko makes the MAC of a packet by an object, and compares two of them byte by byte in Python: 136 of 156
# calls for a packet that comes. The functions of the library do the same in one call each.
packet.compute_hmac = hmac.digest  # type: ignore[assignment]
util.constant_time_bytes_eq = hmac.compare_digest  # type: ignore[assignment]


class PreparedClient(NamedTuple):
    """A client that is not connected yet; ``open`` exchanges keys, verifies the host and logs in."""

    client: paramiko.SSHClient
    open: Callable[[], object]


def prepare_client(
    target: ResolvedHost, host_keys: HostKeyVerifier, line: Line, login: LoginStrategy
) -> PreparedClient:
    """A client of ``target`` on ``line``; nothing but what is given here decides about keys and logins."""
    client = paramiko.SSHClient()
    client.set_missing_host_key_policy(_HostKeyPolicy(target, host_keys))
    how = _list_options(target, host_keys, line, login)
    return PreparedClient(client, partial(client.connect, target.hostname, target.port, target.user, **how))


def prepare_jump_client(
    target: ResolvedHost, host_keys: HostKeyVerifier, line: Line, login: LoginStrategy
) -> PreparedClient:
    """As `prepare_client`, for a host through which others are reached: a connection of Fabric."""
    import_deferred("fabric")
    import fabric

    # Lazy: no file of Fabric (~/.fabric.py) is read or executed. Not shared: its merge is not
    # thread-safe.
    config = fabric.Config(lazy=True, ssh_config=paramiko.SSHConfig())
    connection = fabric.Connection(
        target.hostname,
        user=target.user,
        port=target.port,
        config=config,
        connect_kwargs=_list_options(target, host_keys, line, login),
    )
    connection.client.set_missing_host_key_policy(_HostKeyPolicy(target, host_keys))
    return PreparedClient(connection.client, connection.open)


def _list_options(
    target: ResolvedHost, host_keys: HostKeyVerifier, line: Line, login: LoginStrategy
) -> dict[str, Any]:
    make_transport = partial(_build_transport, host_keys.key_types(target), target.key_exchanges)
    return {"sock": line, "auth_strategy": login, "transport_factory": make_transport}


class _HostKeyPolicy(paramiko.MissingHostKeyPolicy):
    """Called by paramiko for every key, because it knows no hosts itself."""

    def __init__(self, resolved: ResolvedHost, host_keys: HostKeyVerifier) -> None:
        self._resolved = resolved
        self._host_keys = host_keys

    def missing_host_key(self, client: paramiko.SSHClient, hostname: str, key: paramiko.PKey) -> None:
        """Raise unless known_hosts has ``key``."""
        del client, hostname
        self._host_keys.verify(self._resolved, HostKey(key.get_name(), key.asbytes()))


class BoundedTransport(paramiko.Transport):
    """A transport that counts each key exchange against its line's allowance, never waits for itself, and
    says nothing to a channel after its end.
    """

    def __init__(self, line: Line) -> None:
        super().__init__(line)  # type: ignore[arg-type]
        self._allowance = line.allowance
        # The server's numbers of channels whose end was sent; it gives them again.
        self._ended: set[int] = set()
        # The line's deadline bounds this, too; paramiko would start a thread for it.
        self.packetizer.start_handshake = _start_no_timer  # type: ignore[assignment]

    def open_channel(self, *args: Any, **options: Any) -> paramiko.Channel:  # noqa: ANN401 - as paramiko has it
        """Open a channel, whose number may be that of one that has ended."""
        channel = super().open_channel(*args, **options)
        self._ended.discard(channel.remote_chanid)
        return channel

    def _send_message(self, data: paramiko.Message) -> None:
        """Send a message, unless it is of a channel whose end was sent before.

        paramiko makes a message with the lock of its channel and sends it without, so another thread may end
        the channel in between (its issue 1115); OpenSSH then ends the connection with all its channels.
        Messages of channels come here one at a time.
        """
        kind, number = struct.unpack(">BI", data.asbytes()[:5].ljust(5, b"\0"))
        if kind in _CHANNEL_MESSAGES:
            if number in self._ended:
                return
            if kind == MSG_CHANNEL_CLOSE:
                self._ended.add(number)
        super()._send_message(data)  # type: ignore[misc]

    def _parse_kex_init(self, m: paramiko.Message) -> None:
        self._allowance.charge(REKEY_BYTES)
        super()._parse_kex_init(m)  # type: ignore[misc]

    def global_request(
        self,
        kind: str,
        data: Iterable[object] | None = None,
        wait: bool = True,  # noqa: FBT001, FBT002 - as paramiko has it
    ) -> paramiko.Message | None:
        """Send a request, but no keepalive while keys are exchanged.

        paramiko sends keepalives from the thread that reads, which would wait half a minute for its own work.
        """
        if threading.current_thread() is self and not self.clear_to_send.is_set():
            return None
        return super().global_request(kind, data, wait)


def _start_no_timer(_seconds: float) -> None:
    """In place of a thread that ends a handshake."""


def order_key_exchanges(offered: Sequence[str], allowed: Collection[str]) -> tuple[str, ...]:
    """The key exchanges in paramiko's order, but P-256 before Curve25519, which is as strong (RFC 9142).

    OpenSSH has Curve25519 in portable C: it takes 2 ms more of the host's CPU for each login (ADR 210). What
    resists quantum computers stays first. ``allowed``: the names of KexAlgorithms; if they lack P-256,
    paramiko's order stays.
    """
    if not {_CURVE25519, _P256} <= set(offered) or (allowed and _P256 not in allowed):
        return tuple(offered)
    others = [kind for kind in offered if kind != _P256]
    at = others.index(_CURVE25519)
    return (*others[:at], _P256, *others[at:])


def _build_transport(
    preferred: list[str], key_exchanges: Sequence[str], sock: Line, disabled_algorithms: object = None
) -> paramiko.Transport:
    """A paramiko transport that prefers the host key types that known_hosts has, as OpenSSH does."""
    del disabled_algorithms
    transport = BoundedTransport(sock)
    offered = transport.get_security_options()
    offered.kex = order_key_exchanges(offered.kex, key_exchanges)
    types = list(offered.key_types)
    wanted = [
        kind
        for known in preferred
        for kind in (("rsa-sha2-512", "rsa-sha2-256") if known == "ssh-rsa" else (known,))
    ]
    first = [kind for kind in wanted if kind in types]
    offered.key_types = (*first, *(kind for kind in types if kind not in first))
    return transport
