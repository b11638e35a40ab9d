"""profilers start, stop and status."""

from collections.abc import Sequence

from edgectl.errors import UsageError
from edgectl.gateway import profilers
from edgectl.model.inventory import Host
from edgectl.model.names import known
from edgectl.model.profiler import Profiler
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.touch import in_touch

EVERY_S, TTL_S = 1.0, 3600.0
_SHORTEST_S, _LONGEST_S = 0.1, 60.0
_TIMEOUT_S = 30.0


def start(fleet: Fleet, names: Sequence[str] = (), *, every: float = EVERY_S, ttl: float = TTL_S) -> tuple[Profiler, ...]:
    """A profiler on every host, or on those of ``names``; one that runs already and was asked for the same stays.

    ``every`` (s): from sample to sample. ``ttl`` (s): it ends by itself when no edgectl called for so long.

    Raises:
        UsageError: a host is unknown, ``every`` is not 0.1 s to 1 min, or ``ttl`` is shorter than ten periods.
    """
    if not _SHORTEST_S <= every <= _LONGEST_S:
        raise UsageError(f"a sample every {every:g} s is not possible", hint="from 100ms to 1m")
    if ttl < 10 * every:
        raise UsageError(f"profilers that end after {ttl:g} s would hardly have begun", hint="at least ten times --every")
    hosts = _hosts(fleet, names)
    with in_touch(fleet) as near:
        return profilers.start(hosts, fleet.inventory, fleet.tasks, near.transport, every=every, ttl=ttl, timeout=_TIMEOUT_S)


def stop(fleet: Fleet, names: Sequence[str] = ()) -> tuple[Profiler, ...]:
    """No profiler on any host, or on any of ``names``.

    Raises:
        UsageError: a host is unknown.
    """
    hosts = _hosts(fleet, names)
    with in_touch(fleet) as near:
        return profilers.stop(hosts, near.transport, timeout=_TIMEOUT_S)


def status(fleet: Fleet, names: Sequence[str] = ()) -> tuple[Profiler, ...]:
    """What profilers there are on the hosts, or on those of ``names``.

    Raises:
        UsageError: a host is unknown.
    """
    hosts = _hosts(fleet, names)
    with in_touch(fleet) as near:
        return profilers.status(hosts, fleet.inventory, fleet.tasks, near.transport, timeout=_TIMEOUT_S)


def _hosts(fleet: Fleet, names: Sequence[str]) -> list[Host]:
    known(names, fleet.inventory.hosts, "host")
    return [host for host in fleet.inventory.hosts.values() if host.probe and (not names or host.name in names)]
