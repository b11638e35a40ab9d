# SPDX-License-Identifier: Apache-2.0
"""SSH authentication: keys of the agent and of files, each read once per run, or one password."""

import base64
import contextlib
import socket
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import paramiko
from paramiko.auth_strategy import AuthResult, AuthSource, AuthStrategy, InMemoryPrivateKey, SourceResult
from paramiko.ssh_exception import BadAuthenticationType

from edgectl.transport.ssh_config import ResolvedHost

# Our bound for an agent that does not answer (it may wait for a person to touch a token), seconds.
AGENT_TIMEOUT_S = 3.0
_LIST_REQUEST, _LIST_ANSWER = 11, 12
# An answer of an agent may not be larger than this, bytes (OpenSSH's own bound).
_MAX_ANSWER_BYTES = 256 * 1024


class SshAgentClient:
    """Client of ssh-agent with a deadline; one that does not answer counts as empty.

    One connection per request.
    """

    def __init__(self, path: str) -> None:
        self._path = path

    def keys(self) -> list[paramiko.AgentKey]:
        """Keys in the agent, in its order. Security keys (``sk-``) are left out: paramiko cannot use them."""
        try:
            kind, answer = self._send_message(bytes([_LIST_REQUEST]))
        except (OSError, EOFError, paramiko.SSHException):
            return []
        if kind != _LIST_ANSWER:
            return []
        listed = [(answer.get_binary(), answer.get_binary()) for _ in range(min(answer.get_int(), 1000))]
        return [
            paramiko.AgentKey(self, blob, comment.decode(errors="replace"))  # type: ignore[arg-type]
            for blob, comment in listed
            if b"sk-" not in blob[:12]
        ]

    def _send_message(self, message: bytes | paramiko.Message) -> tuple[int, paramiko.Message]:
        """Ask one question; the name is the one by which paramiko's AgentKey calls it."""
        body = message if isinstance(message, bytes) else message.asbytes()
        with socket.socket(socket.AF_UNIX) as agent:
            agent.settimeout(AGENT_TIMEOUT_S)
            agent.connect(self._path)
            agent.sendall(len(body).to_bytes(4, "big") + body)
            size = int.from_bytes(_receive_exactly(agent, 4), "big")
            if not 0 < size <= _MAX_ANSWER_BYTES:
                raise paramiko.SSHException("the ssh-agent uses an unknown protocol")
            answer = paramiko.Message(_receive_exactly(agent, size))
        return answer.get_byte()[0], answer


def _receive_exactly(line: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = line.recv(size - len(data))
        if not piece:
            raise EOFError
        data += piece
    return data


class Keyring:
    """Keys by file and by agent, each read once per run. Safe to use from several threads."""

    def __init__(self) -> None:
        self._files: dict[str, tuple[paramiko.PKey, ...]] = {}
        self._agents: dict[str, list[paramiko.AgentKey]] = {}
        self._lock = threading.Lock()

    def keys_for(self, resolved: ResolvedHost) -> list[paramiko.PKey]:
        """Keys in OpenSSH's order: named keys of the agent, its others (unless IdentitiesOnly), files."""
        with self._lock:
            agent = self._agent_keys(resolved.identity_agent)
            named = _load_public_blobs(resolved.identity_files) if agent else set()
            ours = [key for key in agent if key.blob in named]
            others = [] if resolved.identities_only else [key for key in agent if key.blob not in named]
            held = {key.blob for key in [*ours, *others]}
            files = [
                key
                for path in resolved.identity_files
                for key in self._load(path, resolved.certificate_files)
            ]
        return [*ours, *others, *(key for key in files if key.asbytes() not in held)]

    def _agent_keys(self, path: str) -> list[paramiko.AgentKey]:
        if not path:
            return []
        if path not in self._agents:
            self._agents[path] = SshAgentClient(path).keys()
        return self._agents[path]

    def _load(self, path: str, certificates: Sequence[str]) -> tuple[paramiko.PKey, ...]:
        if path not in self._files:
            self._files[path] = _load_key_file(path, certificates)
        return self._files[path]


def _load_key_file(path: str, certificates: Sequence[str]) -> tuple[paramiko.PKey, ...]:
    """The key in ``path``, after its certificate if there is one; empty if missing, invalid or encrypted."""
    try:
        key = _read_key(path)
    except Exception:  # cryptography raises half a dozen kinds; a file that is no usable key is not offered
        return ()
    if key.public_blob is not None:
        plain = _read_key(path)
        plain.public_blob = None
        return key, plain
    for certificate in certificates:
        with contextlib.suppress(Exception):
            other = _read_key(path)
            other.load_certificate(certificate)
            return other, key
    return (key,)


def _read_key(path: str) -> paramiko.PKey:
    """The key in a file, with the certificate beside it.

    The usual kind of key is read by paramiko alone, without the modules for all kinds (ADR 201).
    """
    try:
        key = paramiko.Ed25519Key.from_private_key_file(path)
    except Exception:  # of another kind, in another form, or encrypted
        return paramiko.PKey.from_path(path)
    certificate = Path(f"{path}-cert.pub")
    if certificate.exists():
        key.load_certificate(str(certificate))
    return key


def _load_public_blobs(paths: Sequence[str]) -> set[bytes]:
    """The public keys beside key files: they identify the agent's copies of encrypted keys."""
    blobs = set()
    for path in paths:
        with contextlib.suppress(Exception):
            blobs.add(base64.b64decode(Path(path + ".pub").read_text().split()[1], validate=True))
    return blobs


class _PasswordSource(AuthSource):
    def __init__(self, username: str, password: str) -> None:
        super().__init__(username=username)
        self._password = password

    def __repr__(self) -> str:
        return "Password"

    def authenticate(self, transport: paramiko.Transport) -> list[str]:
        """Log in by password; paramiko falls back to keyboard-interactive where the host wants that."""
        return transport.auth_password(self.username, self._password)


class RefusedLoginError(paramiko.AuthenticationException):
    """No offered key or password was accepted. ``allowed``: the methods that the host allows."""

    def __init__(self, words: str, allowed: Sequence[str] = ()) -> None:
        super().__init__(words)
        self.allowed = tuple(allowed)


class LoginStrategy(AuthStrategy):
    """Offers keys one after the other, or one password; ``offered`` counts."""

    def __init__(self, user: str, keys: Sequence[paramiko.PKey], password: str | None = None) -> None:
        super().__init__(ssh_config=paramiko.SSHConfig())
        self._user = user
        self._keys = keys
        self._password = password
        self.offered = 0

    def get_sources(self) -> Iterator[AuthSource]:
        """One password if there is one, else the keys."""
        if self._password is not None:
            yield _PasswordSource(self._user, self._password)
            return
        for key in self._keys:
            yield InMemoryPrivateKey(self._user, key)

    def authenticate(self, transport: paramiko.Transport) -> AuthResult:
        """Try the sources until one is accepted.

        Raises:
            RefusedLoginError: none was, or the host allows no further attempt.
            EOFError: the line was lost at the first attempt.
        """
        for source in self.get_sources():
            self.offered += 1
            try:
                more = source.authenticate(transport)
            except BadAuthenticationType as error:
                raise RefusedLoginError(
                    "the host accepts " + " or ".join(error.allowed_types), error.allowed_types
                ) from error
            except paramiko.AuthenticationException:
                if transport.is_active():
                    continue
                if self.offered == 1:
                    raise EOFError from None
                raise RefusedLoginError(f"the host closed the connection after {self.offered} keys") from None
            if not transport.is_authenticated():
                raise RefusedLoginError("the host also requires: " + ", ".join(more), more)
            result = AuthResult(self)
            result.append(SourceResult(source, more))
            return result
        raise RefusedLoginError(self._words(), self._allowed(transport))

    def _words(self) -> str:
        if self._password is not None:
            return "password refused"
        return f"{self.offered} key(s) refused" if self.offered else "no key to offer"

    def _allowed(self, transport: paramiko.Transport) -> Sequence[str]:
        """The methods that the host allows; requested only after a refusal, so that no prompt is in vain."""
        try:
            transport.auth_none(self._user)
        except BadAuthenticationType as error:
            return error.allowed_types
        except (paramiko.SSHException, EOFError):
            pass
        return ()
