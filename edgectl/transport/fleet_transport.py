# SPDX-License-Identifier: Apache-2.0
"""Transport of a mixed fleet: each host by its ``connection``."""

import threading
from collections.abc import Callable
from pathlib import Path

from edgectl.deferred_imports import import_deferred
from edgectl.model.inventory import Connection, Host
from edgectl.transport.base import Session, Transport, trace_call


class FleetTransport:
    """A Transport that makes each kind of transport when the first host needs it (paramiko only for ``ssh``).

    A host whose ``transport`` names a plugin is reached by what that plugin makes.

    ``accept_new`` records the keys of unknown hosts. ``ask_password`` is called with a prompt, at most once
    per host; None never asks. ``config_cache``: as of `SshTransport`.
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
        self._lock = threading.Lock()

    def connect(self, host: Host, *, timeout: float) -> Session:
        """As `Transport.connect`."""
        with trace_call(host.name, "login"):
            return self._for(host).connect(host, timeout=timeout)

    def address(self, host: Host) -> str:
        """As `Transport.address`."""
        return self._for(host).address(host)

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
        if connection is Connection.OPENSSH:
            from edgectl.transport.openssh import OpenSshTransport

            return OpenSshTransport(accept_new=self._accept_new, config_cache=self._config_cache)
        import_deferred("paramiko")
        from edgectl.transport.ssh import SshTransport

        return SshTransport(
            accept_new=self._accept_new, ask_password=self._ask_password, config_cache=self._config_cache
        )


def _make_plugin_transport(name: str) -> Transport:
    from edgectl.plugins import PluginGroup, load_plugin

    made: Transport = load_plugin(PluginGroup.TRANSPORTS, name).call()
    return made
