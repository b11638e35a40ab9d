# SPDX-License-Identifier: Apache-2.0
"""Tasks that live on a host which cannot reach their robot (ADR 0097)."""

from collections.abc import Iterator

from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks


def list_cut_off_tasks(tasks: Tasks, snapshot: Snapshot) -> Iterator[tuple[str, str, str]]:
    """Task, host and robot of each living task whose link is down while its robot answers the manager."""
    for host, sample in snapshot.hosts.items():
        for name, run in sample.tasks.items():
            for robot in tasks.tasks[name].robots if name in tasks.tasks and run.state.alive else ():
                link, far = sample.links.get(robot), snapshot.hosts.get(robot)
                if link is not None and not link.capacity_bytes_per_s and far is not None and far.ok:
                    yield name, host, robot
