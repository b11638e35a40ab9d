# SPDX-License-Identifier: Apache-2.0
"""The command that runs beside a task, on its host or in its container (``edgectl exec``)."""

from collections.abc import Sequence

from edgectl.errors import UnansweredError, UsageError, describe_unseen_task
from edgectl.gateway.task_lookup import find_task_process
from edgectl.names import check_known_names
from edgectl.state.manager_state import load_manager_state
from edgectl.transport.shell_command import build_container_command, build_enter_command
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import track_heartbeats

_TIMEOUT_S = 15.0


def find_enter_command(fleet: Fleet, task: str, argv: Sequence[str], *, tty: bool) -> list[str]:
    """The command line that runs ``argv`` where ``task`` runs now; ``tty``: with a terminal.

    Raises:
        UsageError: the task is unknown, or does not run.
        UnansweredError: it may run on a host that does not answer.
        ConnectError: there is no ssh program here.
    """
    placements = load_manager_state(fleet.state, fleet.warn).placements
    check_known_names([task], [*fleet.tasks.tasks, *placements], "task")
    with track_heartbeats(fleet) as near:
        host, found, silent = find_task_process(task, near.inventory, near.transport, timeout=_TIMEOUT_S)
    if host is None or found is None or not found.state.alive or not found.pid:
        placed = placements.get(task)
        if placed is not None and placed.host in silent:
            raise UnansweredError(
                f"nothing was run: {describe_unseen_task(task, placed.host)}",
                hint=f"edgectl doctor {placed.host}",
            )
        if silent:
            raise UnansweredError(
                f"{task} runs on no host that answers; no answer from {', '.join(silent)}",
                hint="edgectl doctor",
            )
        raise UsageError(f"{task} is not running", hint=f"edgectl start {task}")
    if found.container:
        return build_container_command(host, found.engine, found.container, argv, tty=tty)
    return build_enter_command(host, task, found.pid, argv, tty=tty)
