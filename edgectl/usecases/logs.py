# SPDX-License-Identifier: Apache-2.0
"""Logs of a task from the host where it runs or ran last."""

import contextlib
import re
from collections.abc import Generator, Iterator

from edgectl.agent.link import protocol
from edgectl.errors import UnansweredError, UsageError, describe_unseen_task
from edgectl.gateway.task_lookup import find_task_host
from edgectl.model.inventory import Host
from edgectl.names import check_known_names
from edgectl.rules.lost_places import LostPlace, describe_lost_place
from edgectl.state.manager_state import load_manager_state
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
        UsageError: no host knows the task.
        UnansweredError: no host that answers knows the task, or it was last known on one that does not.
        HostError: its host did not return them.
    """
    with track_heartbeats(fleet) as near, _connect_to_task_host(near, task) as (host, session):
        answer = call_agent(
            session,
            {"op": protocol.OP_LOGS, "fleet": host.fleet, "host": host.name, "task": task, "tail": tail},
            timeout=_TIMEOUT_S,
        )
    return str(answer.get("text") or "").encode("utf-8", "replace").decode()


def follow_log(fleet: Fleet, task: str, *, tail: int = 10) -> Generator[bytes, None, None]:
    """The last ``tail`` lines, then new output as it is printed, until the iterator is closed.

    Raises:
        UsageError: no host knows the task.
        UnansweredError: no host that answers knows the task, or it was last known on one that does not.
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
    manager = load_manager_state(fleet.state, fleet.warn)
    placed = manager.placements.get(task)
    if not re.fullmatch(protocol.NAME_PATTERN, task):
        check_known_names([task], [*fleet.tasks.tasks, *manager.placements], "task")
    found, alive, silent = find_task_host(task, fleet.inventory, fleet.transport, timeout=_TIMEOUT_S)
    if not alive and placed is not None and placed.host in silent:
        raise UnansweredError(
            f"no logs of {describe_unseen_task(task, placed.host)}",
            hint=f"edgectl doctor {placed.host}",
        )
    if found is None and silent:
        raise UnansweredError(
            f"{task} is on no host that answers; no answer from {', '.join(silent)}",
            hint="edgectl doctor",
        )
    if found is None and placed is not None and placed.host not in fleet.inventory.hosts:
        raise UnansweredError(
            f"no logs of {task}: it {describe_lost_place(LostPlace(host=placed.host))}", hint="edgectl status"
        )
    if found is None:
        check_known_names([task], fleet.tasks.tasks, "task")
        raise UsageError(f"{task} is on no host: it never ran, or was stopped", hint="edgectl status")
    return found
