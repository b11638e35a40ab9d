# SPDX-License-Identifier: Apache-2.0
"""Simulated hosts whose readings of one resource are noisy, and a task that just fits on two of them."""

import math
from collections.abc import Callable
from random import Random

from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from tests.builders import GI, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet, FakeHost, Request

# In reverse order of their names.
EDGES = ("zeta", "beta", "alpha")
# Of each edge: cores, bytes, and bytes/s that its link to the robot carries now, half of what is declared.
CAPACITIES = {"cpu": 4.0, "memory": 4 * GI, "network": 10e6}
# Shares of the capacity: what the task declares and uses, and the room beside it.
DEMAND, USED, SPARE = 0.5, 0.425, 0.005


def build_inventory() -> Inventory:
    """The edges and a robot."""
    links = {(edge, "robot1"): 2 * CAPACITIES["network"] for edge in EDGES}
    return an_inventory(*map(an_edge, EDGES), a_robot("robot1"), links=links)


def build_tasks(resource: str) -> Tasks:
    """One task, which demands half of an edge's ``resource``."""
    key = "throughput" if resource == "network" else resource
    amount = DEMAND * CAPACITIES[resource]
    return some_tasks(a_task("slam", robots=["robot1"], **{key: amount}))  # type: ignore[arg-type]


class NoisyReadings:
    """Readings of ``hosts``: zeta and beta have 0.5 % to spare beside the task, alpha has no room for it.

    Each half second of a reading is off by an error with ``deviation`` (share of the host) that lasts for some
    ``lasts`` seconds, or by up to ``up_to`` alike, on its own; a probe is the mean of its window. What links
    carry is read once in a probe, and off in the same way.
    """

    def __init__(
        self,
        hosts: FakeFleet,
        now: Callable[[], float],
        *,
        resource: str = "cpu",
        deviation: float = 0.0,
        lasts: float = 0.0,
        up_to: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.hosts, self.resource, self._now = hosts, resource, now
        self.deviation, self.lasts, self.up_to = deviation, lasts, up_to
        # Of everything else, and beside the task where it runs.
        self.base = {"zeta": 1.0 - SPARE - DEMAND, "beta": 1.0 - SPARE - DEMAND, "alpha": 0.9}
        self.extra = 0.0
        self._errors = dict.fromkeys(EDGES, 0.0)
        self._seen = dict.fromkeys(EDGES, now())
        # Each its own: hosts are probed at once, in any order.
        self._dice = {name: Random(f"{seed} {name}") for name in EDGES}
        for name in EDGES:
            hosts[name].faults["probe"] = lambda request, host=hosts[name]: self._measure(host, request)  # type: ignore[misc]

    @property
    def home(self) -> str:
        """The host of the task; empty where it runs nowhere."""
        return self.hosts.placed.get("slam", "")

    def _measure(self, host: FakeHost, request: Request) -> Request:
        halves = max(1, round(float(str(request["window_s"])) / 0.5))
        error = sum(self._draw_error(host.name) for _ in range(halves)) / halves
        there = "slam" in host.tasks
        share = max(0.0, self.base[host.name] + (USED + self.extra) * there + error)
        amount = share * CAPACITIES[self.resource]
        if there:
            host.tasks["slam"] |= self._build_usage()
        reply = host._probe(request)
        if self.resource == "cpu":
            reply["cpu"] = {"cores": CAPACITIES["cpu"], "used_cores": amount}
        elif self.resource == "memory":
            reply["memory"] = {"total_bytes": CAPACITIES["memory"], "used_bytes": amount}
        else:
            carries = CAPACITIES["network"] * (1.0 + self._draw_error(host.name))
            link = {"rx_bytes_per_s": amount, "tx_bytes_per_s": 0.0, "carries_bytes_per_s": carries}
            reply["links"] = {"robot1": link}
        return reply

    def _draw_error(self, name: str) -> float:
        dice = self._dice[name]
        kept = math.exp(-(self._now() - self._seen[name] + 0.5) / self.lasts) if self.lasts else 0.0
        self._seen[name] = self._now()
        step = dice.gauss(0.0, self.deviation * math.sqrt(1.0 - kept * kept)) if self.deviation else 0.0
        self._errors[name] = kept * self._errors[name] + step
        return self._errors[name] + dice.uniform(-self.up_to, self.up_to)

    def _build_usage(self) -> Request:
        amount = USED * CAPACITIES[self.resource]
        if self.resource == "network":
            return {"rx_bytes_per_s": amount, "links": {"robot1": amount}}
        return {"used_cores" if self.resource == "cpu" else "used_bytes": amount}
