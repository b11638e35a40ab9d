# SPDX-License-Identifier: Apache-2.0
"""Jump hosts (``ProxyJump``): one shared connection to each, closed with its last user."""

import threading
import time
from collections.abc import Callable
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.errors import ConnectError, HostError
from edgectl.transport.sockets import CONNECT_TIMEOUT_S, MAX_TUNNEL_BYTES, TunnelLine
from edgectl.transport.ssh_session import SshSession

# A failed jump host is not tried again for so many seconds: its hosts fail at once instead of one after the
# other.
REMEMBER_FAILURE_S = 30.0


@dataclass(slots=True)
class _JumpHost:
    lock: threading.Lock = field(default_factory=threading.Lock)
    session: SshSession | None = None
    users: int = 0
    failure: HostError | None = None
    failed_at: float = 0.0


class JumpHosts:
    """Sessions of jump hosts by their ProxyJump text. ``open_jump``: (jump, deadline) -> session."""

    def __init__(self, open_jump: Callable[[str, float], SshSession]) -> None:
        self._open_jump = open_jump
        self._jumps: dict[str, _JumpHost] = {}
        self._lock = threading.Lock()

    def channel(
        self, jump: str, target: tuple[str, int], deadline: float
    ) -> tuple[TunnelLine, Callable[[], None]]:
        """A channel to ``target`` through ``jump``, and a function to call once it is closed.

        Raises:
            HostError: the jump host cannot be used.
            paramiko.SSHException: it cannot reach the target.
        """
        session, release = self._lease(jump, deadline)
        session.allowance.renew(MAX_TUNNEL_BYTES)
        seconds = max(0.01, min(CONNECT_TIMEOUT_S, deadline - time.monotonic()))
        try:
            opened = session.transport.open_channel("direct-tcpip", target, ("127.0.0.1", 0), timeout=seconds)
            return TunnelLine(opened, session.allowance), release
        except BaseException:
            release()
            raise

    def _lease(self, jump: str, deadline: float) -> tuple[SshSession, Callable[[], None]]:
        with self._lock:
            entry = self._jumps.setdefault(jump, _JumpHost())
        if not entry.lock.acquire(timeout=max(0.01, deadline - time.monotonic())):
            raise ConnectError(f"no reply from jump host {jump}")
        try:
            session = self._session(entry, jump, deadline)
            entry.users += 1
        finally:
            entry.lock.release()
        return session, lambda: self._release(entry, session)

    def _session(self, entry: _JumpHost, jump: str, deadline: float) -> SshSession:
        if entry.session is not None and entry.session.transport.is_active():
            return entry.session
        if entry.failure is not None and time.monotonic() - entry.failed_at < REMEMBER_FAILURE_S:
            raise type(entry.failure)(entry.failure.message, hint=entry.failure.hint)
        try:
            entry.session, entry.users, entry.failure = self._open_jump(jump, deadline), 0, None
        except HostError as error:
            # Every host behind it gets an error of its own.
            entry.failure, entry.failed_at = error, time.monotonic()
            raise type(error)(error.message, hint=error.hint) from error
        return entry.session

    def _release(self, entry: _JumpHost, session: SshSession) -> None:
        with entry.lock:
            if session is not entry.session:
                session.close()
                return
            entry.users -= 1
            if entry.users > 0:
                return
            entry.session = None
        session.close()
