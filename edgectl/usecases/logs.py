"""Logs of a task from the host where it runs or ran last."""

import contextlib
from collections.abc import Generator, Iterator

from edgectl.agent.link import protocol
from edgectl.errors import UsageError
from edgectl.gateway.task_lookup import find_task_host
from edgectl.model.inventory import Host
from edgectl.names import check_known_names
from edgectl.transport.agent_client import call_agent, stream_agent_log
from edgectl.transport.base import Session
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import track_heartbeats

_TIMEOUT_S = 15.0
# The host sends a heartbeat every few seconds, also while the task prints nothing.
_IDLE_TIMEOUT_S = 20.0


def read_log(fleet: Fleet, task: str, *, tail: int = 100) -> str:
    """The last ``tail`` lines.

    Raises:
        UsageError: no host that answers knows the task.
        HostError: its host did not return them.
    """
    with track_heartbeats(fleet) as near, _connect_to_task_host(near, task) as (host, session):
        answer = call_agent(
            session,
            {"op": protocol.OP_LOGS, "fleet": host.fleet, "host": host.name, "task": task, "tail": tail},
            timeout=_TIMEOUT_S,
        )
    return str(answer.get("text") or "")


def follow_log(fleet: Fleet, task: str, *, tail: int = 10) -> Generator[bytes, None, None]:
    """The last ``tail`` lines, then new output as it is printed, until the iterator is closed.

    Raises:
        UsageError: no host that answers knows the task.
        HostError: its host did not return them.
    """
    with track_heartbeats(fleet) as near, _connect_to_task_host(near, task) as (host, session):
        yield from stream_agent_log(
            session,
            {"op": protocol.OP_FOLLOW, "fleet": host.fleet, "host": host.name, "task": task, "tail": tail},
            idle_timeout=_IDLE_TIMEOUT_S,
        )


@contextlib.contextmanager
def _connect_to_task_host(fleet: Fleet, task: str) -> Iterator[tuple[Host, Session]]:
    host = _get_task_host(fleet, task)
    with fleet.transport.connect(host, timeout=_TIMEOUT_S) as session:
        yield host, session


def _get_task_host(fleet: Fleet, task: str) -> Host:
    found, silent = find_task_host(task, fleet.inventory, fleet.transport, timeout=_TIMEOUT_S)
    if found is None:
        check_known_names([task], [*fleet.tasks.tasks, *([task] if silent else [])], "task")
        unseen = f"; no answer from {', '.join(silent)}" if silent else ""
        raise UsageError(f"{task} has not run on any host that answers{unseen}", hint="edgectl status")
    return found
