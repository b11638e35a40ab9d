# SPDX-License-Identifier: Apache-2.0
"""The user's own ``ssh`` program (``connection: openssh``): for host certificates and security keys.

Each command is a connection of its own, unless the user's ssh_config names a ControlPath on which a master
listens already; edgectl never starts one, because one stalled master would stall every session.
"""

import contextlib
import os
import re
import selectors
import shlex
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from types import MappingProxyType
from typing import IO, Self

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.model.inventory import Host
from edgectl.transport.base import Exchange, OpenExchange, Reply
from edgectl.transport.local import LocalSession
from edgectl.transport.sockets import CONNECT_TIMEOUT_S, REFUSED_HINT, UNKNOWN_NAME_HINT
from edgectl.transport.ssh_config import SshConfigResolver, build_ssh_options, parse_jump_host

FIXED_OPTIONS = {
    "BatchMode": "yes",
    "ClearAllForwardings": "yes",
    "ControlMaster": "no",
    "EscapeChar": "none",
    "ForwardAgent": "no",
    "ForwardX11": "no",
    "GSSAPIDelegateCredentials": "no",
    "LogLevel": "ERROR",
    "NoHostAuthenticationForLocalhost": "no",
    "PermitLocalCommand": "no",
    "RemoteCommand": "none",
    "RequestTTY": "no",
    "ServerAliveCountMax": "3",
    "ServerAliveInterval": "5",
    "UpdateHostKeys": "no",
}
# Of a session that a person uses: prompts for passwords, and `~.` ends it.
_BY_HAND = {"BatchMode": "no", "EscapeChar": "~"}
_NEEDED_VARIABLES = ("HOME", "KRB5CCNAME", "LOGNAME", "PATH", "SHELL", "SSH_AUTH_SOCK", "USER")
# Exit status of ssh for failures of its own.
SSH_FAILED_STATUS = 255
_BLOCK_BYTES = 65536
# What ssh says -> our error, words, hint; the first pattern that is found counts.
OPENSSH_ERRORS: tuple[tuple[str, type[HostError], str, str], ...] = (
    (
        r"REVOKED HOST KEY|revoked by file|revoked keys file",
        HostKeyError,
        "host key is revoked",
        "do not use this host before it has a new key",
    ),
    (
        r"IDENTIFICATION HAS CHANGED",
        HostKeyError,
        "host key has changed",
        "if the host was reinstalled, remove the old key with ssh-keygen -R, then: edgectl trust {host}",
    ),
    (
        r"host key is known for|Host key verification failed",
        HostKeyError,
        "host key is not known",
        "compare the fingerprint, then: edgectl trust {host}",
    ),
    (
        r"Permission denied|Too many authentication failures",
        AuthError,
        "login refused",
        "try ssh by hand, or set identity_file: in the inventory",
    ),
    (
        r"timed out during banner exchange|Connection to \S+ port \d+ timed out",
        DeadlineError,
        "connected, but SSH was not ready in time",
        "the host may be frozen or overloaded",
    ),
    (
        r"Could not resolve|Name or service not known",
        ConnectError,
        "name unknown",
        UNKNOWN_NAME_HINT,
    ),
    (
        r"Connection refused",
        ConnectError,
        "connection refused",
        REFUSED_HINT,
    ),
    (
        r"timed out|No route to host|Network is unreachable",
        ConnectError,
        "no answer",
        "check that it is switched on and that its address is correct",
    ),
)


class OpenSshTransport:
    """Runs ``ssh`` for each command. Keys and agent only, without prompts (BatchMode)."""

    def __init__(self, *, accept_new: bool = False, resolver: SshConfigResolver | None = None) -> None:
        """``resolver``: as of `SshTransport`."""
        self._resolver = resolver or SshConfigResolver()
        self._strict = "accept-new" if accept_new else "yes"

    def connect(self, host: Host, *, timeout: float) -> "OpenSshSession":
        """A session. Nothing is sent yet: what is wrong with the host shows with the first command.

        Raises:
            ConnectError: no ssh program here, or no host name.
            AuthError: the inventory wants a password.
        """
        if host.password_command:
            message = "connection: openssh logs in with keys only"
            raise AuthError(message, hint="remove password_command, or use connection: ssh", host=host.name)
        _check_has_program(host)
        return OpenSshSession(host.name, self._command(host, timeout))

    def address(self, host: Host) -> str:
        """The real address or name of ``host``, ssh_config applied."""
        return self._resolver.resolve(host).hostname

    def build_manual_command(self, host: Host, *, tty: bool) -> list[str]:
        """The ``ssh`` for work by hand, up to the host's name: prompts, and with ``tty`` a terminal.

        Raises:
            ConnectError: no ssh program here, or no host name.
        """
        _check_has_program(host)
        return self._command(host, CONNECT_TIMEOUT_S, {"RequestTTY": "force" if tty else "no"} | _BY_HAND)

    def _command(
        self, host: Host, timeout: float, changed: Mapping[str, str] = MappingProxyType({})
    ) -> list[str]:
        settings = {
            **FIXED_OPTIONS,
            **changed,
            "StrictHostKeyChecking": self._strict,
            "ConnectTimeout": str(max(1, int(min(CONNECT_TIMEOUT_S, timeout * 0.8)))),
        }
        pairs = [argument for name, value in settings.items() for argument in ("-o", f"{name}={value}")]
        resolved = self._resolver.resolve(host, timeout=timeout)
        jump = resolved.proxy_jump
        return [
            *hide_environment(os.environ, resolved.send_env),
            "ssh",
            *(self._through(host, jump, timeout, changed) if jump else build_ssh_options(host)),
            *pairs,
            "--",
            host.host,
        ]

    def _through(self, host: Host, jump: str, timeout: float, changed: Mapping[str, str]) -> list[str]:
        """Options for a host behind ``jump``; ProxyJump would not pass our options on to the jump host."""
        *before, dashes, name = self._command(
            parse_jump_host(jump), timeout, {**changed, "RequestTTY": "no"} if changed else {}
        )
        inner = shlex.join([*before]).replace("%", "%%") + f" -W '[%h]:%p' {dashes} {shlex.quote(name)}"
        return [*build_ssh_options(replace(host, proxy_jump="none")), "-o", f"ProxyCommand={inner}"]


def _check_has_program(host: Host) -> None:
    if shutil.which("ssh") is None:
        raise ConnectError(
            "there is no ssh program here",
            hint="install openssh-client, or use connection: ssh",
            host=host.name,
        )


def hide_environment(names: Iterable[str], patterns: Sequence[str]) -> list[str]:
    """The beginning of a command line without the variables that SendEnv would send to the host.

    No option of ssh takes back a SendEnv of ssh_config. What ssh itself needs stays.
    """
    hidden = sorted(
        name
        for name in names
        if name not in _NEEDED_VARIABLES and any(fnmatchcase(name, each) for each in patterns)
    )
    return ["env", *(word for name in hidden for word in ("-u", name))] if hidden else []


class OpenSshSession:
    """One ssh process per command; a deadline counts its login too."""

    python = "python3"

    def __init__(self, name: str, command: list[str]) -> None:
        self.name = name
        self._command = command

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        """Run ``command`` (see `Session.run`); login errors show here."""
        reply = LocalSession(self.name).run(
            "exec " + shlex.join([*self._command, command]), stdin, timeout=timeout, limit=limit
        )
        if reply.status == SSH_FAILED_STATUS:
            raise translate_openssh_error(reply.stderr, self.name)
        return reply

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        """Run ``command`` and yield its output as it comes (see `Session.stream`)."""
        with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as given:
            given.write(stdin)
            given.seek(0)
            with _run_ssh([*self._command, command], given, said) as process:
                yield from _read_pieces(process, idle_timeout, self.name)
                if process.wait(timeout=idle_timeout) == SSH_FAILED_STATUS:
                    said.seek(0)
                    raise translate_openssh_error(said.read(_BLOCK_BYTES), self.name)

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> Exchange:
        """Run ``command`` and leave its input open (see `Session.exchange`); login errors show at its end."""
        line = "exec " + shlex.join([*self._command, command])
        return LocalSession(self.name).exchange(line, stdin, timeout=timeout, check_end=self._check_end)

    def converse(
        self, command: str, stdin: bytes, *, timeout: float, give_way: Callable[[], None]
    ) -> OpenExchange:
        """As ``ConversableSession.converse``; its connection is its own, so there is always room."""
        del give_way
        line = "exec " + shlex.join([*self._command, command])
        return LocalSession(self.name).exchange(line, stdin, timeout=timeout, check_end=self._check_end)

    def _check_end(self, reply: Reply) -> None:
        if reply.status == SSH_FAILED_STATUS:
            raise translate_openssh_error(reply.stderr, self.name)

    def close(self) -> None:
        """Nothing is held open between commands."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


@contextlib.contextmanager
def _run_ssh(command: list[str], stdin: IO[bytes], stderr: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(
        command, stdin=stdin, stdout=subprocess.PIPE, stderr=stderr, start_new_session=True
    ) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)


def _read_pieces(process: subprocess.Popen[bytes], idle_timeout: float, name: str) -> Iterator[bytes]:
    if process.stdout is None:
        return
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while selector.select(idle_timeout):
            data = os.read(process.stdout.fileno(), _BLOCK_BYTES)
            if not data:
                return
            yield data
    raise DeadlineError(f"no output for {idle_timeout:g} s", host=name)


def translate_openssh_error(stderr: bytes, name: str) -> HostError:
    """The error for the output of ssh with exit status 255."""
    text = stderr.decode(errors="replace")
    for pattern, kind, words, hint in OPENSSH_ERRORS:
        if re.search(pattern, text):
            return kind(
                words + (_describe_key(text) if kind is HostKeyError else ""),
                hint=hint.format(host=name),
                host=name,
            )
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    last = lines[-1] if lines else "ssh printed nothing"
    detail = "".join(char for char in last if char.isprintable())[:200]
    return ConnectError(f"connection lost ({detail})", hint="try: ssh " + name, host=name)


def _describe_key(text: str) -> str:
    """Whose key ssh complains about (it may be a jump host's), and its fingerprint where ssh shows one."""
    whose = re.search(r"host key (?:is known )?for (\S+)", text)
    shown = re.search(r"SHA256:[A-Za-z0-9+/]{43}", text)
    return (f": {whose[1]}" if whose else "") + (f" {shown[0]}" if shown else "")
