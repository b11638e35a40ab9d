# SPDX-License-Identifier: Apache-2.0
"""A watch over simulated hosts, on a clock that jumps instead of waiting."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

from edgectl.model.cycle import Cycle
from edgectl.model.inventory import Host, Inventory
from edgectl.model.task import Tasks
from edgectl.state.uptime import Uptime
from edgectl.transport.fake import FakeSession, FakeTransport
from edgectl.usecases.control import Control, ControlRequest
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.watch import WatchOptions, watch_fleet
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet

EVERY = 10.0


class SteppedClock:
    """Wall clock and uptime in step; ``cost``: time that each reading of the wall clock takes, as if the work
    took it.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.cost = 0.01

    def wall(self) -> float:
        self.seconds += self.cost
        return NOW + self.seconds

    def uptime(self) -> Uptime:
        return Uptime(boot="boot", seconds=self.seconds)


class JumpingWait(Control):
    """Waits by advancing the clock; requests of the test are executed first."""

    def __init__(self, hands: SteppedClock) -> None:
        super().__init__()
        self.hands = hands
        self.waited: list[float] = []

    def wait(self, seconds: float) -> ControlRequest | None:
        wish = super().wait(0)
        if wish is None:
            self.hands.seconds += seconds
        self.waited = [*self.waited[-9:], seconds]
        return wish


class WatchSite:
    """Two edges, a robot, two tasks and a watch over them. ``transport`` keeps no list of requests, unlike
    the FakeTransport below it.
    """

    def __init__(
        self, state: Path, *, tasks: Tasks | None = None, inventory: Inventory | None = None
    ) -> None:
        inventory = inventory or an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"))
        tasks = tasks or some_tasks(
            a_task("slam", cpu=1.0, robots=["robot1"]),
            a_task("navigation", cpu=0.5, robots=["robot1"], needs=["slam"]),
        )
        self.hosts = FakeFleet.of(inventory.hosts)
        self.hands = SteppedClock()
        self.control = JumpingWait(self.hands)
        self.transport = UnrecordedTransport(self.hosts.transport)
        self.fleet = Fleet(
            inventory=inventory,
            tasks=tasks,
            transport=self.transport,
            state=state,
            clock=self.hands.wall,
            uptime=self.hands.uptime,
        )

    def watch(
        self, cycles: int, between: Mapping[int, Callable[[], object]] | None = None, **changes: Any
    ) -> Iterator[Cycle]:
        """Run the watch; events in ``between`` happen after the cycle of that number. Changes are for
        `WatchOptions`.
        """
        options = dataclasses.replace(
            WatchOptions(every=EVERY, apply=True, control=self.control, cycles=cycles), **changes
        )
        with closing(watch_fleet(self.fleet, options)) as running:
            for cycle in islice(running, 2 * cycles):
                yield cycle
                (between or {}).get(cycle.number, int)()


class UnrecordedTransport(FakeTransport):
    """Wraps a FakeTransport: counts connections and drops recorded requests."""

    def __init__(self, within: FakeTransport) -> None:
        super().__init__({})
        self.within = within
        self.connected: dict[str, int] = {}
        within._note = lambda name, request: None  # type: ignore[method-assign]

    def connect(self, host: Host, *, timeout: float) -> FakeSession:
        self.connected[host.name] = self.connected.get(host.name, 0) + 1
        return self.within.connect(host, timeout=timeout)
