"""``edgectl trust HOST``: fetch the host key for comparison, then record it."""

import base64
from pathlib import Path

from edgectl.errors import HostKeyError
from edgectl.model.inventory import Connection, Host
from edgectl.transport.known_hosts import HostKey, build_known_hosts_name


def fetch_host_keys(host: Host, *, timeout: float = 15.0) -> list[tuple[str, str, str]]:
    """Type, SHA256 fingerprint (``ssh-keygen -l``) and known_hosts line of each key that ``host`` presents.

    That is the key that a login would use. Nothing is recorded, and no login is tried. A local host has none.

    Raises:
        HostError: no handshake within ``timeout`` seconds. Jump hosts are verified as always.
    """
    if host.connection is Connection.LOCAL:
        return []
    from edgectl.transport.ssh import SshTransport
    from edgectl.transport.ssh_config import SshConfigResolver

    key = SshTransport().fetch_host_key(host, timeout=timeout)
    resolved = SshConfigResolver().resolve(host)
    name = build_known_hosts_name(resolved.hostname, resolved.port, resolved.host_key_alias)
    return [(key.kind, key.fingerprint, f"{name} {key.text}")]


def get_public_key_path(kind: str) -> str:
    """The default path of sshd's public key of ``kind`` ("ssh-ed25519")."""
    name = next((word for word in ("ed25519", "ecdsa", "rsa", "dss") if word in kind), "*")
    return f"/etc/ssh/ssh_host_{name.replace('dss', 'dsa')}_key.pub"


def trust_host_key(host: Host, line: str) -> Path:
    """Record the key in ``line`` (from `fetch_host_keys`) for ``host`` in the user's known_hosts; the file.

    Raises:
        HostKeyError: another key is known for the host, this one is revoked, or the file cannot be written.
    """
    from edgectl.transport.ssh import SshTransport

    try:
        _, kind, encoded = line.split()[:3]
        key = HostKey(kind, base64.b64decode(encoded, validate=True))
    except ValueError:
        raise HostKeyError(
            "not a line of known_hosts", hint="use a line that fetch_host_keys returned", host=host.name
        ) from None
    return SshTransport().trust(host, key)
