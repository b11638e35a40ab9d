# SPDX-License-Identifier: Apache-2.0
"""The hold of a fleet: claimed on every host with the first probe, renewed while it lasts, then released."""

import contextlib
import dataclasses
import secrets
import time
from collections.abc import Callable, Iterator

from edgectl.agent.link import protocol
from edgectl.errors import CoordinationError, HostError, LockBusyError, WatchedError
from edgectl.gateway.fanout import fan_out
from edgectl.model.inventory import Host, Role
from edgectl.model.snapshot import Snapshot
from edgectl.names import natural_key
from edgectl.state.failpoints import hit_failpoint
from edgectl.state.lock import describe_manager
from edgectl.state.manager_identity import load_manager_id
from edgectl.transport.agent_client import ask_host
from edgectl.transport.fleet_lease import CONTENTION_S, FleetLease, LeaseRefusal, WatchNote
from edgectl.units import format_duration
from edgectl.usecases.coordination import find_holder_id, hold_in_etcd
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import send_heartbeats

_RELEASE_TIMEOUT_S, _WORKERS, _PAUSE_S = 5.0, 32, 0.3
# Besides its pause, a cycle of a watch takes at most about so long while a host hangs.
_CYCLE_MARGIN_S = 15.0
# What a host reports as the cycle of a watch; nobody waits for longer unless they say so.
_MAX_CYCLE_S = 60.0


@contextlib.contextmanager
def hold_fleet(
    fleet: Fleet,
    verb: str,
    *,
    patience_s: float | None = None,
    watch: WatchNote | None = None,
    take_over: bool = False,
) -> Iterator[Fleet]:
    """The fleet with a lease: its first probe claims every host that answers; no other manager changes it
    then. With ``coordination`` the lease is first taken in etcd.

    ``patience_s``: how long to wait for another manager; None: for one cycle of a watch, at most a minute,
    else not at all.
    ``watch``: the note to leave on the hosts; ``take_over`` replaces that of another watch.

    Raises:
        LockBusyError: another manager holds the fleet in etcd.
        WatchedError: another watch does, and this is one.
        CoordinationError: etcd does not answer.
    """
    manager, every_s = load_manager_id(fleet.state), 0.0 if watch is None else watch.every_s
    with hold_in_etcd(fleet, verb, patience_s=patience_s, every_s=every_s, take_over=take_over) as term:
        lease = FleetLease(
            holder=find_holder_id(fleet),
            session=secrets.token_hex(8),
            who=describe_manager(),
            verb=verb,
            clock=lambda: fleet.uptime().seconds,
            watch=watch,
            take_over=take_over,
            patience_s=patience_s,
            hosts=tuple(
                host.name for host in fleet.inventory.hosts.values() if host.role is Role.EDGE or host.onboard
            ),
            manager=manager,
            term=term,
        )
        held = dataclasses.replace(fleet, lease=lease)
        try:
            with send_heartbeats(held, lease.list_granted):
                yield held
        finally:
            release_fleet(held, lease.list_granted())


def probe_within_lease(fleet: Fleet, probe: Callable[[], Snapshot]) -> Snapshot:
    """A probe that claims the fleet where ``fleet`` has a lease, repeated while another manager holds a host.

    Of two managers that claim at the same moment the one that got the first host (in natural order) waits for
    the others, which give way.

    Raises:
        LockBusyError: another manager holds the fleet on a host.
        WatchedError: another watch looks after the fleet.
        CoordinationError: the lease in etcd has run out.
    """
    lease = fleet.lease
    if lease is None:
        return probe()
    _check_term(lease)
    snapshot, began = probe(), time.monotonic()
    while lease.refusals:
        leads = _leads(lease)
        patience = max(CONTENTION_S if leads else 0.0, _get_patience_s(lease))
        if (
            any(refusal.watched for refusal in lease.refusals.values())
            or time.monotonic() - began >= patience
        ):
            raise _build_busy_error(lease)
        if not leads:
            release_fleet(fleet, lease.list_granted())
        time.sleep(_PAUSE_S)
        _check_term(lease)
        snapshot = probe()
    hit_failpoint("fleet claimed")
    return snapshot


def _check_term(lease: FleetLease) -> None:
    if lease.term is not None and lease.term.is_over():
        raise CoordinationError(
            "the lease of the fleet in etcd has run out: nothing was sent",
            hint="run apply again: it takes the fleet again",
        )


def compute_files_digest(fleet: Fleet) -> str:
    """The digests of its files, shortened, that a watch leaves on the hosts."""
    return f"{fleet.inventory.digest[:16]} {fleet.tasks.digest[:16]}"


def release_fleet(fleet: Fleet, names: tuple[str, ...], *, end_watch: bool = False) -> None:
    """Give ``names`` back; a host that does not answer is free when its lease has run out."""
    lease = fleet.lease
    if lease is None or not names:
        return
    hosts = [fleet.inventory.hosts[name] for name in names if name in fleet.inventory.hosts]
    for _ in fan_out(
        lambda host: _release_host(fleet, lease, host, end_watch=end_watch), hosts, workers=_WORKERS
    ):
        pass
    hit_failpoint("fleet released")


def _release_host(fleet: Fleet, lease: FleetLease, host: Host, *, end_watch: bool) -> None:
    with contextlib.suppress(HostError):
        request = {
            "op": protocol.OP_LEASE,
            "fleet": host.fleet,
            "host": host.name,
            "action": "release",
            "lease": lease.sign_release(host.name),
            "end_watch": end_watch,
        }
        ask_host(
            fleet.transport, host, request, timeout=_RELEASE_TIMEOUT_S, connect_timeout=_RELEASE_TIMEOUT_S
        )


def _leads(lease: FleetLease) -> bool:
    """Whether the first host that answered, in natural order, is ours."""
    granted = lease.list_granted()
    return min((*granted, *lease.refusals), key=natural_key) in granted


def _get_patience_s(lease: FleetLease) -> float:
    if lease.patience_s is not None:
        return lease.patience_s
    cycles = [refusal.every_s for refusal in lease.refusals.values() if refusal.verb == "watch"]
    return min(_MAX_CYCLE_S, max(cycles)) + _CYCLE_MARGIN_S if len(cycles) == len(lease.refusals) else 0.0


def _build_busy_error(lease: FleetLease) -> LockBusyError:
    watched = [refusal for refusal in lease.refusals.values() if refusal.watched]
    if watched:
        first = watched[0]
        return WatchedError(
            f"{first.who} watches this fleet every {format_duration(first.every_s)} "
            f"(last seen {format_duration(first.age_s)} ago)",
            hint="stop that watch, or pass --take-over",
        )
    hosts = sorted(lease.refusals, key=natural_key)
    later = lease.refusals[hosts[0]].revision
    if lease.term is not None and later > lease.term.revision:
        return LockBusyError(
            f"{hosts[0]} granted this fleet at revision {later} of etcd, which is now at "
            f"{lease.term.revision}",
            hint="if etcd was restored from a backup: etcdctl del --prefix edgectl/FLEET/",
        )
    return LockBusyError(
        f"{_describe_holder(lease.refusals[hosts[0]])} holds this fleet on {', '.join(hosts)}",
        hint="wait for it, or pass --lock-timeout 60s",
    )


def _describe_holder(refusal: LeaseRefusal) -> str:
    return (
        f"{refusal.who} ({refusal.verb}, for {format_duration(refusal.age_s)}, free in "
        f"{format_duration(refusal.left_s)} unless renewed)"
    )
