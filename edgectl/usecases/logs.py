"""logs: what a task printed, from the host where it runs or ran last."""

import contextlib
from collections.abc import Iterator

from edgectl.errors import UsageError
from edgectl.gateway.find import find
from edgectl.model.inventory import Host
from edgectl.model.names import known
from edgectl.transport.base import Session
from edgectl.transport.call import call, stream
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.touch import in_touch

_TIMEOUT_S = 15.0
# The host sends a sign of life every few seconds, however quiet the task.
_IDLE_S = 20.0


def logs(fleet: Fleet, task: str, *, tail: int = 100) -> str:
    """The last ``tail`` lines.

    Raises:
        UsageError: no host that answers knows the task.
        HostError: its host did not give them.
    """
    with in_touch(fleet) as near, _session(near, task) as (host, session):
        answer = call(session, {"op": "logs", "host": host.name, "task": task, "tail": tail}, timeout=_TIMEOUT_S)
    return str(answer.get("text") or "")


def follow(fleet: Fleet, task: str, *, tail: int = 10) -> Iterator[bytes]:
    """The last ``tail`` lines, then everything as it is printed, until the iterator is closed.

    Raises:
        UsageError: no host that answers knows the task.
        HostError: its host did not give them.
    """
    with in_touch(fleet) as near, _session(near, task) as (host, session):
        yield from stream(session, {"op": "follow", "host": host.name, "task": task, "tail": tail}, idle_timeout=_IDLE_S)


@contextlib.contextmanager
def _session(fleet: Fleet, task: str) -> Iterator[tuple[Host, Session]]:
    host = _where(fleet, task)
    with fleet.transport.connect(host, timeout=_TIMEOUT_S) as session:
        yield host, session


def _where(fleet: Fleet, task: str) -> Host:
    found, silent = find(task, fleet.inventory, fleet.transport, timeout=_TIMEOUT_S)
    if found is None:
        known([task], [*fleet.tasks.tasks, *([task] if silent else [])], "task")
        unseen = f"; no answer from {', '.join(silent)}" if silent else ""
        raise UsageError(f"{task} has not run on any host that answers{unseen}", hint="edgectl status")
    return found
