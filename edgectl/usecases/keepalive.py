"""While a long change waits for one host, the others hear of this manager too: their tasks must not take it for lost."""

import contextlib
import threading
from collections.abc import Iterator

from edgectl.errors import HostError
from edgectl.executor import requests
from edgectl.gateway.fanout import fan_out
from edgectl.model.inventory import Host
from edgectl.model.snapshot import Snapshot
from edgectl.transport.call import call
from edgectl.usecases.fleet import Fleet

_TIMEOUT_S = 10.0
_AT_ONCE = 8
# Of the shortest self_fence: three calls may be lost.
_SHARE = 0.25


@contextlib.contextmanager
def kept_alive(fleet: Fleet, snapshot: Snapshot) -> Iterator[None]:
    """Ask every host of ``snapshot`` that answered from time to time, where a task has ``self_fence``; else do nothing."""
    fences = [task.self_fence for task in fleet.tasks.tasks.values() if task.self_fence is not None]
    if not fences:
        yield
        return
    hosts = [fleet.inventory.hosts[name] for name, sample in snapshot.hosts.items() if sample.ok and name in fleet.inventory.hosts]
    over = threading.Event()
    keeper = threading.Thread(target=_keep, args=(fleet, hosts, _SHARE * min(fences), over), daemon=True)
    keeper.start()
    try:
        yield
    finally:
        over.set()
        keeper.join(_TIMEOUT_S)


def _keep(fleet: Fleet, hosts: list[Host], pause: float, over: threading.Event) -> None:
    while not over.wait(pause):
        for _ in fan_out(lambda host: _call(fleet, host, over), hosts, workers=_AT_ONCE):
            pass


def _call(fleet: Fleet, host: Host, over: threading.Event) -> None:
    """One sign of life; a host that does not take it is found out by the action that needs it."""
    if over.is_set():
        return
    with contextlib.suppress(HostError), fleet.transport.connect(host, timeout=_TIMEOUT_S) as session:
        call(session, requests.status(host), timeout=_TIMEOUT_S)
