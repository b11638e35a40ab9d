# SPDX-License-Identifier: Apache-2.0
"""Waiting for tasks: probes until each has come as far as asked, one has failed, or the time is over."""

import time
from collections.abc import Callable, Sequence

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.names import check_known_names
from edgectl.rules.awaited_state import AwaitedState, TaskProgress, find_progress
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.status import probe_repeatedly

# No reading is shown, so the host does not have to measure for long.
_WINDOW_S = 0.05


def wait_for_tasks(
    fleet: Fleet,
    names: Sequence[str],
    awaited: AwaitedState,
    *,
    timeout_s: float,
    pause: Callable[[], bool],
    report: Callable[[TaskProgress, float], None],
) -> tuple[TaskProgress, ...]:
    """Probe until every task of ``names`` has reached ``awaited``, one has failed, or ``timeout_s`` is over.

    ``pause`` waits for the next probe and returns whether to end. ``report`` is called once with each task
    that has reached it and the seconds that took. Returns the progress of each as seen last.

    Raises:
        UsageError: neither a task file lists a name, nor does a host know it.
    """
    began = time.monotonic()
    reported = set[str]()
    progress: tuple[TaskProgress, ...] = ()

    def should_stop() -> bool:
        return time.monotonic() - began >= timeout_s or pause()

    for snapshot in probe_repeatedly(fleet, should_stop, ProbeOptions(window=_WINDOW_S)):
        known = {name for host in snapshot.hosts.values() for name in host.tasks}
        check_known_names(names, dict.fromkeys([*fleet.tasks.tasks, *sorted(known)]), "task")
        progress = tuple(
            find_progress(name, fleet.tasks.tasks.get(name), awaited, snapshot)
            for name in dict.fromkeys(names)
        )
        for each in progress:
            if each.reached and each.task not in reported:
                reported.add(each.task)
                report(each, time.monotonic() - began)
        if all(each.reached for each in progress) or any(each.failed for each in progress):
            break
    return progress
