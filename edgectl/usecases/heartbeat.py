"""Record heartbeats of hosts, and send them to idle hosts during a long apply so that self_fence does not
fire.
"""

import contextlib
import dataclasses
import threading
from collections.abc import Iterator

from edgectl.errors import HostError, StateError
from edgectl.executor import host_requests
from edgectl.gateway.fanout import fan_out
from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import Snapshot
from edgectl.state.heartbeats import load_heartbeats, record_heartbeats
from edgectl.state.manager_state import load_manager_state
from edgectl.state.uptime import Uptime
from edgectl.transport.agent_client import ask_host
from edgectl.transport.connections import HeartbeatTransport
from edgectl.usecases.fleet import Fleet

# Two requests closer than this share one heartbeat where each is written before the request is sent.
_MIN_WRITE_INTERVAL_S = 1.0


@contextlib.contextmanager
def track_heartbeats(fleet: Fleet) -> Iterator[Fleet]:
    """The fleet over a transport that records heartbeats; they are saved at the end.

    Where a task stops itself after a silence (``self_fence``), the heartbeat is on disk before the request is
    sent, so that after a crash no host has heard from this manager later than the manager's record says.

    A heartbeat that cannot be written then is a HostError: the request was not sent.
    """
    register = _HeartbeatRecorder(fleet)
    try:
        yield dataclasses.replace(fleet, transport=HeartbeatTransport(fleet.transport, register.note))
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


_HEARTBEAT_TIMEOUT_S = 10.0
_WORKERS = 8
# Fraction of the shortest self_fence between heartbeats: three may be lost.
_SELF_FENCE_SHARE = 0.25


@contextlib.contextmanager
def send_heartbeats(fleet: Fleet, snapshot: Snapshot) -> Iterator[None]:
    """Send heartbeats periodically to every host of ``snapshot`` that answered, if a task has ``self_fence``;
    else do nothing.
    """
    fences = [task.self_fence for task in fleet.tasks.tasks.values() if task.self_fence is not None]
    if not fences:
        yield
        return
    hosts = [
        fleet.inventory.hosts[name]
        for name, sample in snapshot.hosts.items()
        if sample.ok and name in fleet.inventory.hosts
    ]
    over = threading.Event()
    keeper = threading.Thread(
        target=_send_heartbeats_until, args=(fleet, hosts, _SELF_FENCE_SHARE * min(fences), over), daemon=True
    )
    keeper.start()
    try:
        yield
    finally:
        over.set()
        keeper.join(_HEARTBEAT_TIMEOUT_S)


def _send_heartbeats_until(fleet: Fleet, hosts: list[Host], pause: float, over: threading.Event) -> None:
    while not over.wait(pause):
        for _ in fan_out(lambda host: _send_heartbeat(fleet, host, over), hosts, workers=_WORKERS):
            pass


def _send_heartbeat(fleet: Fleet, host: Host, over: threading.Event) -> None:
    """Send one heartbeat; a host that does not take it is found out by the action that needs it."""
    if over.is_set():
        return
    request, seconds = host_requests.build_status_request(host), _HEARTBEAT_TIMEOUT_S
    with contextlib.suppress(HostError):
        ask_host(fleet.transport, host, request, timeout=seconds, connect_timeout=seconds)
