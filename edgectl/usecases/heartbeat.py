# SPDX-License-Identifier: Apache-2.0
"""Record heartbeats of hosts, and send them to idle hosts during a long apply and between the requests of a
watch, so that self_fence does not fire and the hold of the fleet lasts.
"""

import contextlib
import dataclasses
import threading
from collections.abc import Callable, Iterable, Iterator

from edgectl.errors import HostError, RefusedError, StateError
from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState
from edgectl.model.task import Tasks
from edgectl.state.heartbeats import load_heartbeats, record_heartbeats
from edgectl.state.manager_state import load_manager_state
from edgectl.state.uptime import Uptime
from edgectl.transport.agent_client import ask_host
from edgectl.transport.connections import HeartbeatCallback, HeartbeatTransport
from edgectl.usecases.fleet import Fleet

# Two requests closer than this share one heartbeat where each is written before the request is sent.
_MIN_WRITE_INTERVAL_S = 1.0


@contextlib.contextmanager
def track_heartbeats(fleet: Fleet) -> Iterator[Fleet]:
    """The fleet over a transport that records heartbeats; they are saved at the end.

    Where a task stops itself after a silence (``self_fence``), the heartbeat is on disk before the request is
    sent, so that after a crash no host has had a later contact than the manager's record shows.

    A heartbeat that cannot be written then is a HostError: the request was not sent.
    """
    with record_noted_heartbeats(fleet) as note:
        yield dataclasses.replace(fleet, transport=HeartbeatTransport(fleet.transport, note))


@contextlib.contextmanager
def record_noted_heartbeats(fleet: Fleet) -> Iterator[HeartbeatCallback]:
    """A function that records a heartbeat of a host, as `track_heartbeats` does."""
    register = _HeartbeatRecorder(fleet)
    try:
        yield register.note
    finally:
        register.save()


def load_state_with_heartbeats(fleet: Fleet) -> ManagerState:
    """The manager's state of the fleet with its heartbeats and fences."""
    manager, contacts = load_manager_state(fleet.state, fleet.warn), load_heartbeats(fleet.state, fleet.warn)
    return dataclasses.replace(
        manager,
        contact=contacts.to_instants(fleet.clock(), fleet.uptime()),
        fenced=contacts.fenced,
        orphans=contacts.orphans,
    )


class _HeartbeatRecorder:
    """The heartbeats of one command; safe from any thread."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._at_once = any(task.self_fence is not None for task in fleet.tasks.tasks.values())
        self._heard: dict[str, Uptime] = {}
        self._written: dict[str, Uptime] = {}
        self._guard = threading.Lock()

    def note(self, host: str) -> None:
        """Record a heartbeat of ``host`` now."""
        now = self._fleet.uptime()
        with self._guard:
            self._heard[host] = now
            written = self._written.get(host)
            if self._at_once and (written is None or now.seconds - written.seconds > _MIN_WRITE_INTERVAL_S):
                self._write(host, now)

    def _write(self, host: str, now: Uptime) -> None:
        try:
            record_heartbeats(self._fleet.state, {host: now})
        except StateError as error:
            raise HostError(error.message, hint=error.hint, host=host) from error
        self._written[host] = now

    def save(self) -> None:
        """Save the recorded heartbeats. A full disk is only a warning here: what must be durable was written
        before.
        """
        with self._guard:
            try:
                record_heartbeats(self._fleet.state, self._heard)
            except StateError as error:
                self._fleet.warn(f"{error.message}: the last heartbeats of the hosts are not recorded")


_MAX_HEARTBEAT_TIMEOUT_S = 10.0
# Fraction of the shortest self_fence, and of the lease, between heartbeats: three (two) may be lost.
_SELF_FENCE_SHARE, _LEASE_SHARE = 0.25, 1 / 3


def compute_heartbeat_pause_s(fleet: Fleet) -> float | None:
    """Seconds between two heartbeats of a host; None where no task fences itself and nothing is held."""
    pauses = [_SELF_FENCE_SHARE * fence for fence in list_self_fences(fleet.tasks)]
    if fleet.lease is not None:
        pauses.append(_LEASE_SHARE * fleet.lease.ttl_s)
    return min(pauses, default=None)


def list_self_fences(tasks: Tasks) -> list[float]:
    """The ``self_fence`` (s) of each task that has one."""
    return [task.self_fence for task in tasks.tasks.values() if task.self_fence is not None]


@contextlib.contextmanager
def send_heartbeats(fleet: Fleet, list_hosts: Callable[[], Iterable[str]]) -> Iterator[None]:
    """Send heartbeats periodically to the hosts that ``list_hosts`` names then; they renew the lease too.

    Nothing is sent where no task has ``self_fence`` and nothing is held. A host that hangs delays no other.
    """
    pause = compute_heartbeat_pause_s(fleet)
    if pause is None:
        yield
        return
    over = threading.Event()
    keeper = threading.Thread(
        target=_send_heartbeats_until, args=(fleet, list_hosts, pause, over), daemon=True
    )
    keeper.start()
    try:
        yield
    finally:
        over.set()
        keeper.join(_MAX_HEARTBEAT_TIMEOUT_S)


def _send_heartbeats_until(
    fleet: Fleet, list_hosts: Callable[[], Iterable[str]], pause: float, over: threading.Event
) -> None:
    """One thread for each host that is asked, none while the last one of that host still waits."""
    asking: dict[str, threading.Thread] = {}
    with track_heartbeats(fleet) as tracked:
        while not over.wait(pause):
            for name in list_hosts():
                if name in tracked.inventory.hosts and not (name in asking and asking[name].is_alive()):
                    host = tracked.inventory.hosts[name]
                    asking[name] = threading.Thread(
                        target=_send_heartbeat, args=(tracked, host, pause, over), daemon=True
                    )
                    asking[name].start()
        for thread in asking.values():
            thread.join(min(pause, _MAX_HEARTBEAT_TIMEOUT_S))


def _send_heartbeat(fleet: Fleet, host: Host, pause: float, over: threading.Event) -> None:
    """Send one heartbeat; a host that does not take it is found out by the action that needs it.

    It waits no longer than one pause: a connection that was lost is replaced with the next heartbeat.
    """
    from edgectl.executor import host_requests

    seconds, lease = min(pause, _MAX_HEARTBEAT_TIMEOUT_S), fleet.lease
    try:
        if over.is_set():
            return
        request = (
            host_requests.build_status_request(host)
            if lease is None
            else host_requests.build_renewal_request(host, lease.sign(host.name))
        )
        sent = 0.0 if lease is None else lease.now()
        ask_host(fleet.transport, host, request, timeout=seconds, connect_timeout=seconds)
        if lease is not None:
            lease.extend(host.name, sent)
    except RefusedError:
        return
    except HostError:
        if lease is not None:
            lease.note_silent(host.name)
