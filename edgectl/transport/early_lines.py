# SPDX-License-Identifier: Apache-2.0
"""TCP connections to hosts, which can be opened before paramiko is imported (ADR 203)."""

import contextlib
import time
from collections.abc import Iterator

from edgectl.errors import ConnectError
from edgectl.transport.sockets import CONNECT_TIMEOUT_S, TunedSocket, connect_tcp
from edgectl.transport.ssh_config import ResolvedHost


def get_connect_seconds(resolved: ResolvedHost, deadline: float) -> float:
    """Seconds within which a host has to be reached, of those until ``deadline`` (monotonic).

    Raises:
        ConnectError: none are left.
    """
    most = resolved.connect_timeout or CONNECT_TIMEOUT_S
    seconds = min(CONNECT_TIMEOUT_S, most, deadline - time.monotonic())
    if seconds <= 0:
        raise ConnectError(
            f"no time was left to connect to {resolved.hostname} port {resolved.port}",
            hint="this machine is busy: give more time with --timeout",
            host=resolved.name,
        )
    return seconds


@contextlib.contextmanager
def explain_timeout(resolved: ResolvedHost, seconds: float) -> Iterator[None]:
    """Raise a TimeoutError within as a ConnectError that says what did not answer in ``seconds``."""
    try:
        yield
    except TimeoutError as error:
        raise ConnectError(
            f"no answer from {resolved.hostname} port {resolved.port} within {seconds:.3g} s",
            hint="check that it is switched on and that its address is correct",
            host=resolved.name,
        ) from error


def open_tcp_line(resolved: ResolvedHost, deadline: float) -> TunedSocket:
    """Connect to a host that is reached directly.

    Raises:
        ConnectError: no answer in time.
        OSError: as `connect_tcp`.
    """
    seconds = get_connect_seconds(resolved, deadline)
    with explain_timeout(resolved, seconds):
        return connect_tcp(resolved.hostname, resolved.port, timeout=seconds)


class EarlyLine:
    """The connection of a first login, or why there is none. Its server starts while paramiko is imported."""

    def __init__(self, resolved: ResolvedHost, deadline: float) -> None:
        """Connect; a host behind others is left to the login."""
        self._outcome: TunedSocket | Exception | None = None
        if resolved.proxy_jump or resolved.proxy_command:
            return
        try:
            self._outcome = open_tcp_line(resolved, deadline)
        except (ConnectError, OSError) as error:
            self._outcome = error

    def take(self) -> TunedSocket | None:
        """The connection; None where there is nothing, or it was taken.

        Raises:
            ConnectError, OSError: as `open_tcp_line`.
        """
        outcome, self._outcome = self._outcome, None
        if isinstance(outcome, Exception):
            raise outcome
        return outcome
