# SPDX-License-Identifier: Apache-2.0
"""Control of the resident profilers on the hosts."""

from collections.abc import Sequence

from edgectl.errors import UsageError
from edgectl.gateway import profilers
from edgectl.model.inventory import Host
from edgectl.model.profiler import Profiler
from edgectl.names import check_known_names
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import track_heartbeats

DEFAULT_PERIOD_S, DEFAULT_TTL_S = 1.0, 3600.0
_MIN_PERIOD_S, _MAX_PERIOD_S = 0.1, 60.0
_TIMEOUT_S = 30.0


def start_profilers(
    fleet: Fleet, names: Sequence[str] = (), *, every: float = DEFAULT_PERIOD_S, ttl: float = DEFAULT_TTL_S
) -> tuple[Profiler, ...]:
    """Start a profiler on every host, or on those of ``names``; one that runs with the same options stays.

    ``every`` (s): sampling period. ``ttl`` (s): the profiler ends after this time without a request.

    Raises:
        UsageError: a host is unknown, ``every`` is not 0.1 to 60 s, or ``ttl`` is below ten periods.
    """
    if not _MIN_PERIOD_S <= every <= _MAX_PERIOD_S:
        raise UsageError(f"a sampling period of {every:g} s is not supported", hint="choose 100ms to 1m")
    if ttl < 10 * every:
        raise UsageError(f"a ttl of {ttl:g} s is too short", hint="choose at least ten times --every")
    hosts = _select_probed_hosts(fleet, names)
    with track_heartbeats(fleet) as near:
        return profilers.start_profilers(
            hosts, fleet.inventory, fleet.tasks, near.transport, every=every, ttl=ttl, timeout=_TIMEOUT_S
        )


def stop_profilers(fleet: Fleet, names: Sequence[str] = ()) -> tuple[Profiler, ...]:
    """Stop the profilers on all hosts, or on those of ``names``.

    Raises:
        UsageError: a host is unknown.
    """
    hosts = _select_probed_hosts(fleet, names)
    with track_heartbeats(fleet) as near:
        return profilers.stop_profilers(hosts, near.transport, timeout=_TIMEOUT_S)


def list_profilers(fleet: Fleet, names: Sequence[str] = ()) -> tuple[Profiler, ...]:
    """The profilers on all hosts, or on those of ``names``.

    Raises:
        UsageError: a host is unknown.
    """
    hosts = _select_probed_hosts(fleet, names)
    with track_heartbeats(fleet) as near:
        return profilers.list_profilers(
            hosts, fleet.inventory, fleet.tasks, near.transport, timeout=_TIMEOUT_S
        )


def _select_probed_hosts(fleet: Fleet, names: Sequence[str]) -> list[Host]:
    check_known_names(names, fleet.inventory.hosts, "host")
    return [
        host for host in fleet.inventory.hosts.values() if host.probe and (not names or host.name in names)
    ]
