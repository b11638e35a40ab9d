# SPDX-License-Identifier: Apache-2.0
"""Coordination of the managers of a fleet by etcd: the lease that one of them holds, and the state that they
share (docs/adr/0080, 0081, 0176, 0177). Without ``coordination`` in the inventory nothing of this is done.
"""

import contextlib
import dataclasses
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

from edgectl.errors import CoordinationError, EdgectlError, LockBusyError, StateError, WatchedError
from edgectl.model.plan import Step
from edgectl.rules.measured_demand import MeasuredDemands
from edgectl.state.failpoints import hit_failpoint
from edgectl.state.journal_reader import JournalEntry
from edgectl.state.lock import FleetLock, describe_manager
from edgectl.state.manager_identity import find_manager_id, load_manager_id
from edgectl.state.open_work import (
    OpenWork,
    add_announcement,
    collect_open_work,
    has_to_be_shared,
    take_over_work,
)
from edgectl.state.shared_demands import save_shared_demands
from edgectl.state.shared_state import (
    LocalCopy,
    PendingStart,
    add_own_places,
    collect_shared_state,
    compute_state_digest,
    decode_shared_state,
    encode_shared_state,
    install_shared_state,
    load_local_copy,
    save_local_copy,
)
from edgectl.transport.fleet_lease import Term
from edgectl.units import format_duration
from edgectl.usecases.fleet import Fleet

# The client of etcd imports http and ssl: only where an inventory names an etcd.
if TYPE_CHECKING:
    from edgectl.transport.etcd_client import EtcdClient
    from edgectl.transport.etcd_lease import EtcdLease, FleetKeys, Holder

_PAUSE_S = 0.3
# As in usecases/fleet_lease.py: a command waits for the cycle of a watch.
_MAX_CYCLE_S, _CYCLE_MARGIN_S = 60.0, 15.0


@contextlib.contextmanager
def hold_in_etcd(
    fleet: Fleet,
    verb: str,
    *,
    patience_s: float | None = None,
    every_s: float = 0.0,
    take_over: bool = False,
) -> Iterator[Term | None]:
    """The lease of the fleet in etcd, with the shared state on this machine; None without ``coordination``.

    Call it within the fleet's lock. ``patience_s``: how long to wait for another manager; None: for one cycle
    of a watch, else not at all. ``every_s``: the cycle of this watch; ``take_over``: it may replace another.

    Raises:
        LockBusyError: another manager holds the fleet.
        WatchedError: it is a watch, as this one is.
        CoordinationError: etcd does not answer.
    """
    if fleet.inventory.coordination is None:
        yield None
        return
    from edgectl.transport.etcd_client import EtcdClient
    from edgectl.transport.etcd_lease import Holder

    holder = Holder(
        manager=load_manager_id(fleet.state),
        session=secrets.token_hex(8),
        who=describe_manager(),
        verb=verb,
        every_s=every_s,
    )
    client = EtcdClient(fleet.inventory.coordination)
    lease = _wait_for_fleet(fleet, client, holder, patience_s, take_over=take_over)
    with lease.keep_alive():
        hit_failpoint("fleet taken in etcd")
        if not install_newer_state(fleet, lease.keys):
            share_state(fleet, lease)
        yield lease


def _wait_for_fleet(
    fleet: Fleet, client: "EtcdClient", holder: "Holder", patience_s: float | None, *, take_over: bool
) -> "EtcdLease":
    from edgectl.transport import etcd_lease

    began = time.monotonic()
    while True:
        taken = etcd_lease.take_fleet(
            client,
            fleet.inventory.fleet,
            holder,
            clock=lambda: fleet.uptime().seconds,
            ttl_s=etcd_lease.ETCD_LEASE_S,
        )
        if isinstance(taken, etcd_lease.EtcdLease):
            return taken
        if holder.every_s and taken.every_s and not take_over:
            raise WatchedError(
                f"{taken.who} watches this fleet every {format_duration(taken.every_s)}",
                hint="stop that watch, or pass --take-over",
            )
        if time.monotonic() - began >= _get_patience_s(taken, patience_s):
            raise LockBusyError(
                f"{taken.who} ({taken.verb}, free in {format_duration(taken.left_s)} unless renewed) "
                "holds this fleet in etcd",
                hint="wait for it, or pass --lock-timeout 60s",
            )
        time.sleep(_PAUSE_S)


def _get_patience_s(other: "Holder", patience_s: float | None) -> float:
    if patience_s is not None:
        return patience_s
    return min(_MAX_CYCLE_S, other.every_s) + _CYCLE_MARGIN_S if other.verb == "watch" else 0.0


def install_newer_state(fleet: Fleet, keys: "FleetKeys") -> bool:
    """Install the state of etcd where another machine has saved it; whether etcd has one at all.

    Files that come from the state in etcd stay as they are: they may be newer, where it could not be saved.

    Raises:
        StateError: it cannot be read, or the disk does not take it.
    """
    copy = load_local_copy(fleet.state, fleet.warn)
    known = copy if copy.id == keys.id else LocalCopy(id=keys.id)
    if keys.state is None:
        save_local_copy(fleet.state, LocalCopy(id=keys.id, starts=known.starts))
        return False
    if known.revision == keys.state_revision:
        return True
    state = decode_shared_state(keys.state)
    digest = compute_state_digest(state)
    if state.journal is not None:
        take_over_work(fleet.state, state.journal, known.journal, fleet.clock, fleet.warn)
    if not copy.id:
        state = add_own_places(state, fleet.state, fleet.warn)
    install_shared_state(fleet.state, state, fleet.inventory.hosts, fleet.uptime())
    save_local_copy(
        fleet.state,
        LocalCopy(
            id=keys.id,
            revision=keys.state_revision,
            digest=digest,
            starts=state.starts,
            journal=state.journal or OpenWork(),
        ),
    )
    return True


def share_state(
    fleet: Fleet,
    lease: Term | None,
    starts: Mapping[str, PendingStart] | None = None,
    journal: OpenWork | None = None,
) -> None:
    """Save the state of this machine in etcd, if it differs from what is there.

    ``starts``: those that may be sent from now on; None: as they were. ``journal``: what a run that has begun
    may leave; None: what the journal of this machine leaves now.

    Raises:
        CoordinationError: etcd does not answer, or another manager has the fleet.
        StateError: the state is too large, or the disk does not take its record.
    """
    if lease is None:
        return
    copy = load_local_copy(fleet.state, fleet.warn)
    starts = copy.starts if starts is None else starts
    past = copy.journal.revisions
    if journal is None:  # nothing is under way
        journal = collect_open_work(fleet.state)
        from edgectl.state.revisions import collect_shared_revisions

        past = collect_shared_revisions(fleet.state, past, describe_manager().rpartition("@")[2])
    journal = dataclasses.replace(journal, revisions=past)
    state = collect_shared_state(fleet.state, starts, journal, fleet.warn)
    digest = compute_state_digest(state)
    if digest != copy.digest:
        revision = lease.save_state(encode_shared_state(state))
        hit_failpoint("state saved in etcd")
        save_local_copy(
            fleet.state,
            LocalCopy(id=copy.id, revision=revision, digest=digest, starts=starts, journal=journal),
        )


def announce_starts(
    fleet: Fleet,
    lease: Term | None,
    steps: tuple[Step, ...],
    generations: Mapping[str, int],
    *,
    plan_id: str,
    revision: int,
) -> None:
    """Save what is about to be changed before a host is touched: whoever takes the fleet over holds what may
    have been started while its host is silent, and does not apply the plan again.

    Raises:
        CoordinationError: etcd does not answer, or another manager has the fleet.
    """
    if lease is None:
        return
    new = {
        step.task: PendingStart(host=step.decision.host, generation=generations.get(step.task, 0))
        for step in steps
        if step.action.changes and step.decision.host is not None
    }
    changed = (step.task for step in steps if step.action.changes)
    work = add_announcement(collect_open_work(fleet.state), revision, plan_id, changed)
    share_state(fleet, lease, {**load_local_copy(fleet.state, fleet.warn).starts, **new}, work)


def build_journal_listener(fleet: Fleet, lease: Term | None) -> Callable[[JournalEntry], None]:
    """What a journal tells of its entries, from any thread: it saves in etcd that a robot is about to be put
    on hold or was released, and which hosts keep a state.

    Where etcd does not answer, the run goes on as long as its lease lasts.
    """
    guard = threading.Lock()

    def share(entry: JournalEntry) -> None:
        if lease is None or not has_to_be_shared(entry) or lease.is_over():
            return
        with guard, contextlib.suppress(EdgectlError):
            announced = load_local_copy(fleet.state).journal.unfinished
            left = dataclasses.replace(collect_open_work(fleet.state), unfinished=announced)
            share_state(fleet, lease, journal=left)

    return share


def share_results(
    fleet: Fleet,
    lease: Term | None,
    starts: Mapping[str, PendingStart] | None = None,
    demands: MeasuredDemands | None = None,
) -> None:
    """Save the state after a change, with the ``starts`` of which nobody knows what became of them (None:
    all), and the measured ``demands`` (None: as they were). Where that fails, what was done stays: the
    announced starts still stand in etcd, and this machine saves its state with its next change.
    """
    try:
        if demands is not None:
            save_shared_demands(fleet.state, demands)
        share_state(fleet, lease, starts)
    except EdgectlError as error:
        fleet.warn(f"{error.message}: what this run changed is saved on this machine only; apply again")


def load_pending_starts(fleet: Fleet) -> Mapping[str, PendingStart]:
    """The starts that a holder of the fleet may have sent without saving what became of them."""
    if fleet.inventory.coordination is None:
        return {}
    return load_local_copy(fleet.state, fleet.warn).starts


def find_holder_id(fleet: Fleet) -> str:
    """The name by which hosts know this manager: with ``coordination`` that of all managers that share it."""
    shared = ""
    if fleet.inventory.coordination is not None:
        shared = load_local_copy(fleet.state, fleet.warn).id
    return shared or find_manager_id(fleet.state)


def refresh_state(fleet: Fleet) -> None:
    """Bring the shared state to this machine for a command that only reads; where etcd does not answer, the
    last known one is used, with a warning.
    """
    if fleet.inventory.coordination is None:
        return
    from edgectl.transport import etcd_lease
    from edgectl.transport.etcd_client import EtcdClient

    try:
        keys = etcd_lease.read_fleet_keys(EtcdClient(fleet.inventory.coordination), fleet.inventory.fleet)
        copy = load_local_copy(fleet.state, fleet.warn)
        if keys.state is not None and (copy.id, copy.revision) != (keys.id, keys.state_revision):
            # Where another edgectl of this machine changes the fleet, its files are the newest there are.
            with FleetLock(fleet.state, verb="read", clock=fleet.clock):
                install_newer_state(fleet, keys)
    except LockBusyError:
        return
    except (CoordinationError, StateError) as error:
        fleet.warn(f"{error.message}: places and marks are those that this machine saw last")
