# SPDX-License-Identifier: Apache-2.0
"""SSH by paramiko, jump hosts by Fabric, on sockets of ours, within deadlines (``docs/concepts/ssh.md``)."""

import logging
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import paramiko

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.model.inventory import Host
from edgectl.transport.early_lines import EarlyLine, explain_timeout, get_connect_seconds, open_tcp_line
from edgectl.transport.host_keys import HostKeyVerifier
from edgectl.transport.jump_hosts import JumpHosts
from edgectl.transport.known_hosts import HostKey, HostKeyVerdict
from edgectl.transport.passwords import PasswordStore
from edgectl.transport.sockets import (
    MAX_LOGIN_BYTES,
    Line,
    hang_up,
    start_proxy_command,
    watchdog,
)
from edgectl.transport.ssh_auth import Keyring, LoginStrategy, RefusedLoginError
from edgectl.transport.ssh_client import PreparedClient, prepare_client, prepare_jump_client
from edgectl.transport.ssh_config import ResolvedHost, SshConfigResolver, parse_jump_host
from edgectl.transport.ssh_errors import translate_ssh_error
from edgectl.transport.ssh_session import SshSession

# A server with too many logins (MaxStartups) closes before its banner: pauses before a retry, s, without
# jitter.
PAUSES_S = (0.2, 0.5, 1.0)
KEEPALIVE_S = 15
T = TypeVar("T")
# Makes a client of a host on a line, with what it verifies and how it logs in.
PrepareClient = Callable[[ResolvedHost, HostKeyVerifier, Line, LoginStrategy], PreparedClient]
# A connected line, and what is to be called after it.
OpenedLine = tuple[Line, Callable[[], None]]
OpenLine = Callable[[], AbstractContextManager[OpenedLine]]
# paramiko logs what it also raises; the logger can still be configured.
logging.getLogger("paramiko").addHandler(logging.NullHandler())


class _BusyError(Exception):
    """The host closed the connection before its banner."""


class SshTransport:
    """SSH to any host, keys and known_hosts read once. Safe to use from several threads.

    ``accept_new`` records the keys of unknown hosts; a changed key is refused all the same. ``ask_password``
    is called with a prompt, once per host, where keys are refused and the host allows passwords; None never
    asks. ``resolver`` may be shared with others; None makes one that keeps nothing for later runs.
    """

    def __init__(
        self,
        *,
        accept_new: bool = False,
        ask_password: Callable[[str], str] | None = None,
        resolver: SshConfigResolver | None = None,
    ) -> None:
        self._resolver = resolver or SshConfigResolver()
        self._keyring = Keyring()
        self._host_keys = HostKeyVerifier(accept_new=accept_new)
        self._jumps = JumpHosts(self._open_jump)
        self._passwords = PasswordStore(ask_password)

    def connect(self, host: Host, *, timeout: float, early: EarlyLine | None = None) -> SshSession:
        """Open a session (see `Transport.connect`); the time of a password prompt does not count.

        ``early``: a connection that was opened for the first attempt.
        """
        deadline = time.monotonic() + timeout
        resolved = self._resolver.resolve(host, timeout=timeout)
        try:
            return self._login(resolved, deadline, early=early)
        except AuthError as refusal:
            password = (
                self._passwords.get(host, f"{resolved.user}@{resolved.given}")
                if _can_use_password(refusal)
                else None
            )
            if password is None:
                raise
        try:
            return self._login(resolved, time.monotonic() + timeout, password)
        except AuthError:
            self._passwords.reject(host)
            raise

    def address(self, host: Host) -> str:
        """The real address or name of ``host``, ssh_config applied."""
        return self._resolver.resolve(host).hostname

    def fetch_host_key(self, host: Host, *, timeout: float) -> HostKey:
        """The key that ``host`` presents now, unverified; only the handshake is done."""
        deadline = time.monotonic() + timeout
        resolved = self._resolver.resolve(host, timeout=timeout)
        return _retry_while_busy(partial(self._shown_key, resolved, deadline), deadline, resolved.name)

    def _shown_key(self, resolved: ResolvedHost, deadline: float) -> HostKey:
        with self._line(resolved, deadline) as (line, done), self._deadline(resolved, line, deadline):
            transport = paramiko.Transport(line)  # type: ignore[arg-type]
            try:
                transport.start_client(timeout=max(0.1, deadline - time.monotonic()))
                shown = transport.get_remote_server_key()
            except Exception as error:
                _raise_if_busy(transport, error)
                raise
            finally:
                hang_up(line)
                transport.close()
        done()
        return HostKey(shown.get_name(), shown.asbytes())

    def judge_host_key(self, host: Host, key: HostKey) -> tuple[HostKeyVerdict, HostKeyError | None]:
        """What known_hosts says of ``key``, and the error of a login; None where the key is known."""
        return self._host_keys.judge(self._resolver.resolve(host), key)

    def trust(self, host: Host, key: HostKey) -> Path:
        """Record ``key`` for ``host`` in the user's known_hosts; returns the file.

        Raises:
            HostKeyError: another key is known for it, or the file cannot be written.
        """
        return self._host_keys.trust(self._resolver.resolve(host), key)

    def _login(
        self,
        resolved: ResolvedHost,
        deadline: float,
        password: str | None = None,
        *,
        prepare: PrepareClient = prepare_client,
        early: EarlyLine | None = None,
    ) -> SshSession:
        open_line = partial(self._line, resolved, deadline, early)
        return _retry_while_busy(
            partial(self._attempt, resolved, deadline, password, prepare, open_line), deadline, resolved.name
        )

    def _attempt(
        self,
        resolved: ResolvedHost,
        deadline: float,
        password: str | None,
        prepare: PrepareClient,
        open_line: OpenLine,
    ) -> SshSession:
        login = LoginStrategy(resolved.user, self._keyring.keys_for(resolved), password)
        with open_line() as (line, done), self._deadline(resolved, line, deadline):
            made = prepare(resolved, self._host_keys, line, login)
            try:
                made.open()
                session = SshSession(resolved.name, made.client, line, after=done)
                session.transport.set_keepalive(KEEPALIVE_S)
                line.allowance.renew(MAX_LOGIN_BYTES)
            except BaseException as error:
                hang_up(line)
                transport = made.client.get_transport()
                made.client.close()
                _raise_if_busy(transport, error)
                raise
            return session

    @contextmanager
    def _line(
        self, resolved: ResolvedHost, deadline: float, early: EarlyLine | None = None
    ) -> Iterator[OpenedLine]:
        """A connected line for SSH, and a function to call after it; closed where the block raises."""
        try:
            taken = None if early is None else early.take()
            line, done = (taken, _release_nothing) if taken else self._open_line(resolved, deadline)
        except Exception as error:
            ours = translate_ssh_error(error, resolved.name)
            raise ours from (None if ours is error else error)
        try:
            yield line, done
        except BaseException:
            with suppress(Exception):
                line.close()
            done()
            raise

    def _open_line(self, resolved: ResolvedHost, deadline: float) -> OpenedLine:
        if not resolved.proxy_jump and not resolved.proxy_command:
            return open_tcp_line(resolved, deadline), _release_nothing
        with explain_timeout(resolved, get_connect_seconds(resolved, deadline)):
            if resolved.proxy_jump:
                target = resolved.hostname, resolved.port
                return self._jumps.channel(resolved.proxy_jump, target, deadline)
            return start_proxy_command(resolved.proxy_command), _release_nothing

    @contextmanager
    def _deadline(self, resolved: ResolvedHost, line: object, deadline: float) -> Iterator[None]:
        """Close the line when the deadline passes; translate errors."""
        seconds = deadline - time.monotonic()
        with watchdog(seconds, partial(hang_up, line)) as watch:
            try:
                yield
            except Exception as error:
                if watch.expired:
                    raise DeadlineError(
                        "connected, but SSH was not ready in time",
                        hint="the host may be frozen or overloaded",
                        host=resolved.name,
                    ) from error
                if isinstance(error, _BusyError):
                    raise
                ours = translate_ssh_error(error, resolved.name)
                raise ours from (None if ours is error else error)

    def _open_jump(self, jump: str, deadline: float) -> SshSession:
        """Open the session of one jump host, by the same rules as any other host."""
        host = parse_jump_host(jump)
        resolved = self._resolver.resolve(host, timeout=max(0.1, deadline - time.monotonic()))
        if resolved.proxy_jump and resolved.proxy_jump == jump:
            resolved = replace(resolved, proxy_jump="")
        try:
            return self._login(resolved, deadline, prepare=prepare_jump_client)
        except HostError as error:
            # A jump host may be missing in the inventory, so `edgectl trust` may not know it; ssh does.
            hint = error.hint.replace("edgectl trust", "ssh")
            raise type(error)(f"jump host {host.name}: {error.message}", hint=hint) from error


def _can_use_password(refusal: AuthError) -> bool:
    cause = refusal.__cause__
    return isinstance(cause, RefusedLoginError) and bool(
        {"password", "keyboard-interactive"} & set(cause.allowed)
    )


def _raise_if_busy(transport: paramiko.Transport | None, error: BaseException) -> None:
    """Raise if the host has not even shown its banner."""
    if (
        transport is not None
        and not transport.remote_version
        and isinstance(error, EOFError | OSError | paramiko.SSHException)
    ):
        raise _BusyError from error


def _retry_while_busy(attempt: Callable[[], T], deadline: float, name: str) -> T:
    """Retry a few times, with jitter, while the host closes before its banner."""
    for pause in PAUSES_S:
        try:
            return attempt()
        except _BusyError:
            time.sleep(
                max(0.0, min(pause * (0.5 + secrets.randbelow(1000) / 1000), deadline - time.monotonic()))
            )
    try:
        return attempt()
    except _BusyError:
        hint = "too many logins at once (MaxStartups), or no SSH server"
        raise ConnectError(
            "the host closes the connection before its SSH banner", hint=hint, host=name
        ) from None


def _release_nothing() -> None:
    """Nothing to release."""
