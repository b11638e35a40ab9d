# SPDX-License-Identifier: Apache-2.0
"""Transport of a mixed fleet: each host by its ``connection``."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from edgectl.deferred_imports import import_deferred
from edgectl.model.inventory import Connection, Host
from edgectl.transport.base import Session, Transport, trace_call

if TYPE_CHECKING:
    from edgectl.transport.ssh import SshTransport
    from edgectl.transport.ssh_config import SshConfigResolver


class FleetTransport:
    """A Transport that makes each kind of transport when the first host needs it (paramiko only for ``ssh``).

    A host whose ``transport`` names a plugin is reached by what that plugin makes.

    ``accept_new`` records the keys of unknown hosts. ``ask_password`` is called with a prompt, at most once
    per host; None never asks. ``config_cache`` is the file with what ssh_config said in earlier runs; None
    always asks.
    """

    def __init__(
        self,
        *,
        accept_new: bool = False,
        ask_password: Callable[[str], str] | None = None,
        config_cache: Path | None = None,
    ) -> None:
        self._accept_new = accept_new
        self._ask_password = ask_password
        self._config_cache = config_cache
        self._made: dict[Connection | str, Transport] = {}
        self._resolver: SshConfigResolver | None = None
        self._ssh: SshTransport | None = None
        self._lock, self._ssh_lock = threading.RLock(), threading.Lock()

    def connect(self, host: Host, *, timeout: float) -> Session:
        """As `Transport.connect`."""
        with trace_call(host.name, "login"):
            if host.transport or host.connection is not Connection.SSH:
                return self._for(host).connect(host, timeout=timeout)
            return self._connect_ssh(host, timeout)

    def address(self, host: Host) -> str:
        """As `Transport.address`."""
        if not host.transport and host.connection in (Connection.SSH, Connection.OPENSSH):
            return self._get_resolver().resolve(host).hostname
        return self._for(host).address(host)

    def _connect_ssh(self, host: Host, timeout: float) -> Session:
        """Log in by paramiko; while it is still imported, the server on the host starts (ADR 203)."""
        if self._ssh is not None:
            return self._ssh.connect(host, timeout=timeout)
        from edgectl.transport.early_lines import EarlyLine

        deadline = time.monotonic() + timeout
        early = EarlyLine(self._get_resolver().resolve(host, timeout=timeout), deadline)
        with self._ssh_lock:
            if self._ssh is None:
                self._ssh = self._make_ssh()
        return self._ssh.connect(host, timeout=deadline - time.monotonic(), early=early)

    def _get_resolver(self) -> "SshConfigResolver":
        from edgectl.transport.ssh_config import SshConfigResolver

        with self._lock:
            if self._resolver is None:
                self._resolver = SshConfigResolver(self._config_cache)
            return self._resolver

    def _make_ssh(self) -> "SshTransport":
        import_deferred("paramiko")
        from edgectl.transport.ssh import SshTransport

        return SshTransport(
            accept_new=self._accept_new, ask_password=self._ask_password, resolver=self._get_resolver()
        )

    def _for(self, host: Host) -> Transport:
        with self._lock:
            key = host.transport or host.connection
            if key not in self._made:
                self._made[key] = (
                    _make_plugin_transport(host.transport) if host.transport else self._make(host.connection)
                )
            return self._made[key]

    def _make(self, connection: Connection) -> Transport:
        if connection is Connection.LOCAL:
            from edgectl.transport.local import LocalTransport

            return LocalTransport()
        from edgectl.transport.openssh import OpenSshTransport

        return OpenSshTransport(accept_new=self._accept_new, resolver=self._get_resolver())


def _make_plugin_transport(name: str) -> Transport:
    from edgectl.plugins import PluginGroup, load_plugin

    made: Transport = load_plugin(PluginGroup.TRANSPORTS, name).call()
    return made
