# SPDX-License-Identifier: Apache-2.0
"""``edgectl trust``: fetch host keys for comparison, then record them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from edgectl.deferred_imports import import_deferred
from edgectl.errors import HostError
from edgectl.model.inventory import Connection, Host
from edgectl.transport.known_hosts import HostKey, HostKeyVerdict

if TYPE_CHECKING:
    from edgectl.transport.ssh import SshTransport


class ShownKey(NamedTuple):
    """The key that ``host`` shows and what known_hosts says of it; both None where there was no handshake.

    ``error``: why a login would end with it; None where the key is known.
    """

    host: Host
    key: HostKey | None
    verdict: HostKeyVerdict | None
    error: HostError | None


def fetch_host_key(host: Host, *, timeout: float = 15.0) -> ShownKey:
    """The key that a login to ``host`` would use, within ``timeout`` seconds.

    Nothing is recorded, and no login is tried. Jump hosts are verified as always.
    """
    transport = _make_transport()
    try:
        key = transport.fetch_host_key(host, timeout=timeout)
        return ShownKey(host, key, *transport.judge_host_key(host, key))
    except HostError as error:
        return ShownKey(host, None, None, error)


def list_ssh_hosts(hosts: Sequence[Host]) -> tuple[Host, ...]:
    """Those that are reached over SSH: only they have a host key."""
    return tuple(host for host in hosts if host.connection is not Connection.LOCAL)


def get_public_key_path(kind: str) -> str:
    """The default path of sshd's public key of ``kind`` ("ssh-ed25519")."""
    name = next((word for word in ("ed25519", "ecdsa", "rsa", "dss") if word in kind), "*")
    return f"/etc/ssh/ssh_host_{name.replace('dss', 'dsa')}_key.pub"


def trust_host_key(shown: ShownKey) -> Path:
    """Record the key that was shown in the user's known_hosts; the file.

    Raises:
        HostKeyError: another key is known for the host, this one is revoked, or the file cannot be written.
        HostError: no key was shown.
    """
    if shown.key is None:
        raise shown.error or HostError("showed no key", host=shown.host.name)
    return _make_transport().trust(shown.host, shown.key)


def _make_transport() -> "SshTransport":
    import_deferred("paramiko")
    from edgectl.transport.ssh import SshTransport

    return SshTransport()
