# SPDX-License-Identifier: Apache-2.0
"""Logs of a task from the host where it runs or ran last."""

import contextlib
import queue
import re
import threading
from collections.abc import Callable, Generator, Iterator, Mapping

from edgectl.agent.link import protocol
from edgectl.errors import EdgectlError, UnansweredError, UsageError, describe_unseen_task
from edgectl.gateway.task_lookup import find_task_host
from edgectl.model.inventory import Host
from edgectl.model.text import clean_text
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
_MAX_NOTE = 300
# Each takes a thread and a channel of its connection.
MAX_FOLLOWED = 32
# A longer line is passed on in parts.
_MAX_LINE = 65536


def read_log(
    fleet: Fleet,
    task: str,
    *,
    tail: int | None = 100,
    since_s: float | None = None,
    previous: bool = False,
) -> str:
    """The last ``tail`` lines (None: all that one reply takes), of those that were written in the last
    ``since_s`` seconds, or of the run before the present one. What is not known of their times is a warning.

    Raises:
        UsageError: no host knows the task.
        UnansweredError: no host that answers knows the task, or it was last known on one that does not.
        HostError: its host did not return them, or does not know their times or no earlier run.
    """
    with track_heartbeats(fleet) as near, _connect_to_task_host(near, task) as (host, session):
        request = _build_log_request(protocol.OP_LOGS, host, task, tail, since_s)
        if previous:
            request["previous"] = True
        answer = call_agent(session, request, timeout=_TIMEOUT_S)
    if answer.get("note"):
        fleet.warn(f"log of {task}: {clean_text(answer['note'], _MAX_NOTE)}")
    return str(answer.get("text") or "").encode("utf-8", "replace").decode()


def follow_log(
    fleet: Fleet, task: str, *, tail: int | None = 10, since_s: float | None = None
) -> Generator[bytes, None, None]:
    """What `read_log` reads, then new output as it is printed, until the iterator is closed.

    Raises:
        UsageError: no host knows the task.
        UnansweredError: no host that answers knows the task, or it was last known on one that does not.
        HostError: its host did not return them.
    """
    with track_heartbeats(fleet) as near, _connect_to_task_host(near, task) as (host, session):
        yield from stream_agent_log(
            session,
            _build_log_request(protocol.OP_FOLLOW, host, task, tail, since_s),
            idle_timeout=_IDLE_TIMEOUT_S,
        )


def merge_streams(
    streams: Mapping[str, Callable[[], Iterator[str]]],
) -> Iterator[tuple[str, str | EdgectlError]]:
    """The lines of several streams as they come, each whole and with the name of its stream; an error ends
    one of them.

    The threads are daemons: whoever stops reading waits for no host.
    """
    found: queue.SimpleQueue[tuple[str, str | EdgectlError | None]] = queue.SimpleQueue()

    def read(name: str, open_stream: Callable[[], Iterator[str]]) -> None:
        rest = ""
        try:
            for text in open_stream():
                whole, newline, rest = (rest + text).rpartition("\n")
                if newline or len(rest) > _MAX_LINE:
                    found.put((name, whole + newline if newline else rest))
                    rest = rest if newline else ""
        except EdgectlError as error:
            found.put((name, error))
        finally:
            if rest:
                found.put((name, rest + "\n"))
            found.put((name, None))

    for name, open_stream in streams.items():
        threading.Thread(target=read, args=(name, open_stream), daemon=True).start()
    left = len(streams)
    while left:
        name, text = found.get()
        if text is None:
            left -= 1
        else:
            yield name, text


def _build_log_request(
    op: str, host: Host, task: str, tail: int | None, since_s: float | None
) -> dict[str, object]:
    request: dict[str, object] = {"op": op, "fleet": host.fleet, "host": host.name}
    request |= {"task": task, "tail": tail}
    return request if since_s is None else {**request, "since_s": since_s}


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
