# SPDX-License-Identifier: Apache-2.0
"""Verification of host keys: known, or refused with a hint. It cannot be disabled."""

import subprocess
import tempfile
import threading
from pathlib import Path

from edgectl.errors import HostKeyError
from edgectl.transport.known_hosts import (
    HostKey,
    HostKeyFinding,
    HostKeyVerdict,
    KnownHosts,
    build_known_hosts_name,
)
from edgectl.transport.ssh_config import ResolvedHost


class HostKeyVerifier:
    """Verifies host keys against the known_hosts files, each read once per run.

    Safe to use from several threads.
    """

    def __init__(self, *, accept_new: bool = False) -> None:
        self._accept_new = accept_new
        self._read: dict[tuple[Path, ...], KnownHosts] = {}
        self._lock = threading.Lock()

    def verify(self, resolved: ResolvedHost, key: HostKey) -> None:
        """Return if ``key`` is known, or unknown and to be accepted (then it is recorded).

        Raises:
            HostKeyError: unknown, changed or revoked.
        """
        known, finding = self._judged(resolved, key)
        if finding.verdict is HostKeyVerdict.UNKNOWN and self._accept_new:
            self._record(known, resolved, key)
        elif finding.verdict is not HostKeyVerdict.KNOWN:
            raise _build_host_key_error(resolved, key, finding)

    def judge(self, resolved: ResolvedHost, key: HostKey) -> tuple[HostKeyVerdict, HostKeyError | None]:
        """What is known of ``key``, and the error of `verify` where it is not known. Nothing is recorded."""
        _, finding = self._judged(resolved, key)
        known = finding.verdict is HostKeyVerdict.KNOWN
        return finding.verdict, None if known else _build_host_key_error(resolved, key, finding)

    def trust(self, resolved: ResolvedHost, key: HostKey) -> Path:
        """Record ``key``; returns the file. A key that is known already is not written twice.

        Raises:
            HostKeyError: the host has another key, ``key`` is revoked, or the file cannot be written.
        """
        known, finding = self._judged(resolved, key)
        if finding.verdict in (HostKeyVerdict.CHANGED, HostKeyVerdict.REVOKED):
            raise _build_host_key_error(resolved, key, finding)
        if finding.verdict is HostKeyVerdict.UNKNOWN:
            self._record(known, resolved, key)
        return _get_known_hosts_file(resolved)

    def key_types(self, resolved: ResolvedHost) -> list[str]:
        """Key types known for the host, to be asked for first."""
        return self._known(resolved).key_types(resolved.hostname, resolved.port, resolved.host_key_alias)

    def _judged(self, resolved: ResolvedHost, key: HostKey) -> tuple[KnownHosts, HostKeyFinding]:
        known = self._known(resolved)
        if resolved.revoked_keys and not _is_unrevoked(resolved.revoked_keys, key):
            return known, HostKeyFinding(HostKeyVerdict.REVOKED)
        return known, known.check(key, resolved.hostname, resolved.port, resolved.host_key_alias)

    def _known(self, resolved: ResolvedHost) -> KnownHosts:
        files = (*resolved.known_hosts, *resolved.global_known_hosts)
        with self._lock:
            if files not in self._read:
                self._read[files] = KnownHosts(files)
            return self._read[files]

    def _record(self, known: KnownHosts, resolved: ResolvedHost, key: HostKey) -> None:
        alias, hashed = resolved.host_key_alias, resolved.hash_known_hosts
        known.add(
            _get_known_hosts_file(resolved), key, resolved.hostname, resolved.port, alias, hashed=hashed
        )


def _is_unrevoked(revoked: str, key: HostKey) -> bool:
    """Whether RevokedHostKeys (keys or a KRL) does not list ``key``; an unreadable file lists all keys."""
    try:
        text = Path(revoked).read_bytes()
    except OSError:
        return False
    if not text.startswith(b"SSHKRL"):
        return not any(line.split()[:2] == key.text.encode().split() for line in text.splitlines())
    with tempfile.NamedTemporaryFile("w", suffix=".pub") as file:
        file.write(key.text + "\n")
        file.flush()
        asked = subprocess.run(
            ["ssh-keygen", "-Q", "-f", revoked, file.name],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
        )
    return asked.returncode == 0


def _get_known_hosts_file(resolved: ResolvedHost) -> Path:
    if not resolved.known_hosts:
        raise HostKeyError(
            "ssh_config gives no known_hosts file to write to",
            hint="set UserKnownHostsFile",
            host=resolved.name,
        )
    return resolved.known_hosts[0]


def _build_host_key_error(resolved: ResolvedHost, key: HostKey, finding: HostKeyFinding) -> HostKeyError:
    name = resolved.name
    shown = f"{key.kind} {key.fingerprint}"
    if finding.verdict is HostKeyVerdict.REVOKED:
        return HostKeyError(
            f"host key is revoked: {shown}", hint="do not use this host before it has a new key", host=name
        )
    if finding.verdict is HostKeyVerdict.UNKNOWN:
        hint = f"compare the fingerprint, then: edgectl trust {name}   (or run with --accept-new)"
        return HostKeyError(f"host key is not known: {shown}", hint=hint, host=name)
    old = ", ".join(f"{known.kind} {known.fingerprint} ({place})" for known, place in finding.known)
    entry = build_known_hosts_name(resolved.hostname, resolved.port, resolved.host_key_alias)
    files = sorted({place.rpartition(":")[0] or place for _, place in finding.known})
    hint = (
        f"if the host was reinstalled: ssh-keygen -R '{entry}' -f {files[0]}, then: edgectl trust {name}; "
        "otherwise the connection may be intercepted"
    )
    return HostKeyError(f"host key has changed: shown {shown}, known {old}", hint=hint, host=name)
