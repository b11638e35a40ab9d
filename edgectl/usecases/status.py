# SPDX-License-Identifier: Apache-2.0
"""Snapshots and recent samples for get, top and describe, once or repeatedly."""

import dataclasses
from collections.abc import Callable, Iterator

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.event import Event
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.snapshot import Snapshot
from edgectl.transport.connections import REFUSED_BACKOFF_S, BackoffTransport, SessionPool
from edgectl.usecases.fleet import Fleet, show_nothing
from edgectl.usecases.probe import probe_fleet


def probe_repeatedly(
    fleet: Fleet, should_stop: Callable[[], bool], options: ProbeOptions | None = None
) -> Iterator[Snapshot]:
    """One probe, and another each time ``should_stop`` (which waits in between) returns false; sessions stay
    open.
    """
    with SessionPool(fleet.transport, forget_s=REFUSED_BACKOFF_S, converse=True) as pool:
        held = dataclasses.replace(fleet, transport=BackoffTransport(pool), show_probe=show_nothing)
        yield probe_fleet(held, options)
        while not should_stop():
            yield probe_fleet(held, options)


def load_host_points(fleet: Fleet, samples: int) -> tuple[HostPoint, ...]:
    """The newest ``samples`` of each host, oldest first."""
    return fleet.history.use(fleet.state, fleet.warn, lambda store: store.host_points(limit=samples))


def load_task_points(fleet: Fleet, samples: int) -> tuple[TaskPoint, ...]:
    """The newest ``samples`` of each task, oldest first."""
    return fleet.history.use(fleet.state, fleet.warn, lambda store: store.task_points(limit=samples))


def load_last_events(
    fleet: Fleet, count: int, *, host: str | None = None, task: str | None = None
) -> tuple[Event, ...]:
    """The newest ``count`` events of a host or a task, oldest first."""
    return fleet.history.use(
        fleet.state, fleet.warn, lambda store: store.events(host=host, task=task, limit=count)
    )
