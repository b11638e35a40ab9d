# SPDX-License-Identifier: Apache-2.0
"""A second look at all hosts for a task that was alive in the plan and is gone when it is to be stopped."""

import queue
import threading
from collections.abc import Iterable
from functools import partial

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.executor import host_requests
from edgectl.executor.host_requests import Request
from edgectl.executor.step_run import RunContext, StepRun
from edgectl.model.inventory import Host
from edgectl.model.standby import is_standby_entry

_HINT = "edgectl apply, which plans from what runs then"
_Answer = Request | HostError


class ConcurrentChangeError(HostError):
    """Another manager changed the task since the plan was made; ``located``: the host that runs it now."""

    def __init__(self, message: str, *, located: str | None, host: str) -> None:
        super().__init__(message, hint=_HINT, host=host)
        self.located = located


def check_gone_everywhere(act: StepRun, host: Host) -> None:
    """Ask all hosts of the plan for a task that was alive on ``host`` in the snapshot and is not any more.

    Raises:
        ConcurrentChangeError: it runs on another host, has completed or was started with a newer
            generation; or it may, because a host does not answer.
    """
    entries = {
        name: _get_entry(answer, act.name) for name, answer in _ask_hosts(act.run, act.name, host).items()
    }
    for name, entry in entries.items():
        if _runs_elsewhere(act, entry):
            raise ConcurrentChangeError(
                f"{act.name} no longer runs on {host.name} and runs on {name}: another manager moved it",
                located=name,
                host=name,
            )
    there = entries.get(host.name)
    if there is not None and there.get("state") == protocol.COMPLETED:
        raise ConcurrentChangeError(
            f"{act.name} completed on {host.name} meanwhile", located=host.name, host=host.name
        )
    for name, entry in entries.items():
        if entry is None:
            raise ConcurrentChangeError(
                f"{act.name} no longer runs on {host.name}, and {name} does not answer: it may run there",
                located=host.name,
                host=name,
            )
        if _get_generation(entry) > act.generation:
            raise ConcurrentChangeError(
                f"another manager started {act.name} on {name} meanwhile", located=host.name, host=name
            )


def _runs_elsewhere(act: StepRun, entry: Request | None) -> bool:
    """Whether an instance lives that this very action did not start (a start-first move has its own)."""
    alive = entry is not None and entry.get("state") in protocol.ALIVE_STATES
    return (
        alive
        and not is_standby_entry(entry)
        and entry is not None
        and entry.get("instance") != (act.started or None)
    )


def _get_generation(entry: Request) -> int:
    generation = entry.get("generation")
    return generation if type(generation) is int and generation <= protocol.MAX_GENERATION else 0


def _get_entry(answer: _Answer, task: str) -> Request | None:
    """The entry of the task; empty where the host has none, None where it did not answer."""
    found = None if isinstance(answer, HostError) else answer.get("tasks")
    if not isinstance(found, dict):
        return None
    entry = found.get(task, {})
    return entry if isinstance(entry, dict) else None


def _ask_hosts(run: RunContext, task: str, old: Host) -> dict[str, _Answer]:
    """The answers of ``old`` and of every host that answered when the plan was made."""
    known = [
        run.hosts[name] for name, sample in run.plan.snapshot.hosts.items() if sample.ok and name in run.hosts
    ]
    return _ask_at_once(run, task, {host.name: host for host in (old, *known)}.values())


def _ask_at_once(run: RunContext, task: str, hosts: Iterable[Host]) -> dict[str, _Answer]:
    """One request to each host at the same time; daemon threads, so that a second Ctrl-C need not wait."""
    answers: queue.SimpleQueue[tuple[str, _Answer]] = queue.SimpleQueue()

    def ask(host: Host) -> None:
        try:
            answers.put((host.name, run.ask(host, host_requests.build_status_request(host, task))))
        except HostError as error:
            answers.put((host.name, error))

    threads = [threading.Thread(target=partial(ask, host), daemon=True) for host in hosts]
    for thread in threads:
        thread.start()
    return dict(answers.get() for _ in threads)
