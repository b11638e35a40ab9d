# SPDX-License-Identifier: Apache-2.0
"""Reader and writer of known_hosts files with the semantics of OpenSSH.

paramiko's own reader fails on marker lines, ignores patterns and is quadratic, so the files are read here,
once per run. Plain names are indexed; hashed names are tried only where no plain entry decides.
"""

import base64
import binascii
import fnmatch
import hashlib
import hmac
import os
import re
import secrets
import threading
from collections.abc import Iterable, Sequence
from enum import StrEnum
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.errors import HostKeyError

DEFAULT_SSH_PORT = 22


class HostKeyVerdict(StrEnum):
    """Verdict on a host key by known_hosts."""

    KNOWN = "known"
    UNKNOWN = "unknown"
    CHANGED = "changed"
    REVOKED = "revoked"


@dataclass(frozen=True, slots=True)
class HostKey:
    """A public host key: its type as written ("ssh-ed25519") and its binary form."""

    kind: str
    blob: bytes

    @property
    def fingerprint(self) -> str:
        """SHA256 fingerprint as ``ssh-keygen -l`` prints it."""
        return "SHA256:" + base64.b64encode(hashlib.sha256(self.blob).digest()).decode().rstrip("=")

    @property
    def text(self) -> str:
        """Type and base64, as written in a file."""
        return f"{self.kind} {base64.b64encode(self.blob).decode()}"


@dataclass(frozen=True, slots=True)
class KnownHostsEntry:
    """One line: ``names`` as written, ``marker`` ("", "@revoked", "@cert-authority"), place ("file:line")."""

    names: str
    kind: str
    encoded: str
    marker: str
    place: str

    @property
    def key(self) -> HostKey | None:
        """The key, or None where the line is broken (OpenSSH skips such lines)."""
        try:
            blob = base64.b64decode(self.encoded, validate=True)
        except (binascii.Error, ValueError):
            return None
        named = len(self.kind).to_bytes(4, "big") + self.kind.encode()
        return HostKey(self.kind, blob) if blob.startswith(named) and len(blob) > len(named) else None


@dataclass(frozen=True, slots=True)
class HostKeyFinding:
    """A verdict with its keys: for CHANGED those that were expected, each with its place."""

    verdict: HostKeyVerdict
    known: tuple[tuple[HostKey, str], ...] = ()


def build_known_hosts_name(host: str, port: int, alias: str | None = None) -> str:
    """The name of a host in known_hosts: HostKeyAlias, else ``host`` or ``[host]:port``, in lower case."""
    if alias:
        return alias.lower()
    return host.lower() if port == DEFAULT_SSH_PORT else f"[{host.lower()}]:{port}"


class KnownHosts:
    """The entries of known_hosts files, in order; missing files are empty.

    Safe to use from several threads.
    """

    def __init__(self, files: Iterable[Path]) -> None:
        self._plain: dict[str, list[KnownHostsEntry]] = {}
        self._patterns: list[tuple[tuple[tuple[re.Pattern[str], bool], ...], KnownHostsEntry]] = []
        self._hashed: list[tuple[bytes, bytes, KnownHostsEntry]] = []
        self._lock = threading.Lock()
        for path in files:
            self._read(path)

    def check(self, key: HostKey, host: str, port: int, alias: str | None = None) -> HostKeyFinding:
        """Judge ``key`` as OpenSSH: revoked beats known, other keys mean CHANGED, a bare name counts too."""
        finding = self._check(build_known_hosts_name(host, port, alias), key)
        if finding.verdict is HostKeyVerdict.UNKNOWN and port != DEFAULT_SSH_PORT and not alias:
            bare = self._check(build_known_hosts_name(host, DEFAULT_SSH_PORT), key)
            return bare if bare.verdict in (HostKeyVerdict.KNOWN, HostKeyVerdict.REVOKED) else finding
        return finding

    def key_types(self, host: str, port: int, alias: str | None = None) -> list[str]:
        """Types of the known keys of a host, preferred in key exchange: others would look like a change."""
        names = [build_known_hosts_name(host, port, alias)] + [
            build_known_hosts_name(host, DEFAULT_SSH_PORT)
        ] * (port != DEFAULT_SSH_PORT and not alias)
        for name in names:
            for hashed in (False, True):
                kinds = [
                    entry.kind
                    for entry in self._entries(name, hashed=hashed)
                    if not entry.marker and entry.key
                ]
                if kinds:
                    return list(dict.fromkeys(kinds))
        return []

    def add(
        self,
        path: Path,
        key: HostKey,
        host: str,
        port: int,
        alias: str | None = None,
        *,
        hashed: bool = False,
    ) -> None:
        """Append ``key`` to ``path`` (created with 0600, its directory with 0700). No line is ever changed.

        Raises:
            HostKeyError: the file cannot be written.
        """
        name = build_known_hosts_name(host, port, alias)
        line = f"{hash_host_name(name) if hashed else name} {key.text}"
        try:
            with self._lock:
                append_line(path, line)
        except OSError as error:
            raise HostKeyError(
                f"cannot record the host key in {path}: {error.strerror}", hint=f"make {path} writable"
            ) from error
        self._add(line, str(path))

    def _check(self, name: str, key: HostKey) -> HostKeyFinding:
        entries = self._entries(name, hashed=False)
        finding = _judge_key(entries, key)
        return (
            _judge_key(self._entries(name, hashed=True), key)
            if finding.verdict in (HostKeyVerdict.UNKNOWN, HostKeyVerdict.CHANGED)
            else finding
        )

    def _entries(self, name: str, *, hashed: bool) -> list[KnownHostsEntry]:
        """Entries for ``name``: plain names, patterns and revocations; hashed names only on request."""
        found = list(self._plain.get(name, ()))
        found += [entry for patterns, entry in self._patterns if _matches_patterns(name, patterns)]
        wanted = name.encode()
        for salt, digest, entry in self._hashed:
            if (hashed or entry.marker) and hmac.digest(salt, wanted, "sha1") == digest:
                found.append(entry)
        return found

    def _read(self, path: Path) -> None:
        try:
            text = path.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return
        for number, line in enumerate(text.splitlines(), 1):
            self._add(line, f"{path}:{number}")

    def _add(self, line: str, place: str) -> None:
        """Index one line; comments, blanks and lines that are too short are nothing."""
        marker, rest = "", line.strip(" \t")
        if rest.startswith("@"):
            marker, _, rest = rest.replace("\t", " ").partition(" ")
        fields = rest.split(None, 3)
        if rest.startswith("#") or len(fields) < 3 or marker not in ("", "@revoked", "@cert-authority"):
            return
        names = fields[0]
        entry = KnownHostsEntry(names, fields[1], fields[2], marker, place)
        if names.startswith("|"):
            self._add_hashed(names, entry)
        elif any(char in names for char in "*?!"):
            self._patterns.append((_compile_patterns(names), entry))
        else:
            for name in names.lower().split(","):
                self._plain.setdefault(name, []).append(entry)

    def _add_hashed(self, names: str, entry: KnownHostsEntry) -> None:
        parts = names.split("|")
        if len(parts) != 4 or parts[1] != "1":
            return
        try:
            salt, digest = (
                base64.b64decode(parts[2], validate=True),
                base64.b64decode(parts[3], validate=True),
            )
        except (binascii.Error, ValueError):
            return
        self._hashed.append((salt, digest, entry))


def _judge_key(entries: Sequence[KnownHostsEntry], key: HostKey) -> HostKeyFinding:
    """OpenSSH's order: a matching revocation, an equal key, another key of any type, nothing."""
    if any(entry.marker == "@revoked" and entry.key == key for entry in entries):
        return HostKeyFinding(HostKeyVerdict.REVOKED)
    known = tuple((found, entry.place) for entry in entries if not entry.marker and (found := entry.key))
    if any(found == key for found, _ in known):
        return HostKeyFinding(HostKeyVerdict.KNOWN)
    return HostKeyFinding(HostKeyVerdict.CHANGED, known) if known else HostKeyFinding(HostKeyVerdict.UNKNOWN)


def _compile_patterns(names: str) -> tuple[tuple[re.Pattern[str], bool], ...]:
    """Patterns of a line, each with whether it forbids. Brackets are literal here, unlike in file names."""
    patterns = []
    for name in names.lower().split(","):
        wanted = name.removeprefix("!")
        literal = wanted.replace("[", "[[]")
        patterns.append((re.compile(fnmatch.translate(literal)), name.startswith("!")))
    return tuple(patterns)


def _matches_patterns(name: str, patterns: Iterable[tuple[re.Pattern[str], bool]]) -> bool:
    hit = False
    for pattern, forbids in patterns:
        if pattern.match(name):
            if forbids:
                return False
            hit = True
    return hit


def hash_host_name(name: str) -> str:
    """``name`` in the hashed form of ``HashKnownHosts``."""
    salt = secrets.token_bytes(20)
    digest = hmac.digest(salt, name.encode(), "sha1")
    return f"|1|{base64.b64encode(salt).decode()}|{base64.b64encode(digest).decode()}"


def append_line(path: Path, line: str) -> None:
    """Append one line in a single write, closing an unfinished last line first."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "rb+", buffering=0) as file:
        size = file.seek(0, os.SEEK_END)
        unfinished = size > 0 and os.pread(file.fileno(), 1, size - 1) != b"\n"
        file.write(b"\n" * unfinished + line.encode() + b"\n")
