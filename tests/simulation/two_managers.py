# SPDX-License-Identifier: Apache-2.0
"""Interleavings of two managers over simulated hosts.

The hosts decide by the agent's own rules of the lease (``lease_rules``), each on its own clock; the managers sign by
their own lease (``FleetLease``). Everything else is a model of few lines: a manager claims all hosts that it
has, looks, moves every task to where it wants it, and gives the fleet back. In half of the fleets one manager has a
host that the other lacks; then the agent's and the manager's own rules of ADR 68 say what is held. Between any two
requests the other manager may act, a host may reboot, a manager may freeze past its lease or die. The judge counts
the living instances of each task after every step.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import cast

from edgectl.agent.supervise import grants, lease_rules
from edgectl.errors import RefusedError
from edgectl.gateway.host_probe import drop_known_hosts
from edgectl.model.inventory import Role
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import HostSample, HostStatus
from edgectl.rules.other_managers import is_up_to_date, list_unlisted_hosts
from edgectl.transport.fleet_lease import FleetLease

HOSTS, TASKS, LEASE_S = ("edge1", "edge2", "edge3"), ("t0", "t1"), 30.0
_Document = dict[str, object]


class DoubledError(AssertionError):
    """Two instances of a task were alive."""


@dataclass
class SimulatedHost:
    """A host with its own clock (``offset``), its lease and its living tasks."""

    offset: float
    boots: int = 1
    record: _Document = field(default_factory=dict)
    tasks: set[str] = field(default_factory=set)
    listings: dict[str, _Document] = field(default_factory=dict)

    def reboot(self, now: float) -> None:
        """Begin a new uptime; nothing lives any more."""
        self.offset, self.boots = -now, self.boots + 1
        self.tasks.clear()

    def claim(self, claim: _Document, now: float) -> _Document:
        refusal = lease_rules.find_refusal(self.record, {}, claim, now + self.offset, f"boot{self.boots}")
        if refusal is not None:
            return refusal
        self.record = lease_rules.build_grant(self.record, claim, now + self.offset, f"boot{self.boots}")
        holder = str(claim["holder"])
        self.listings[holder] = lease_rules.build_listing(self.listings.get(holder, {}), claim)
        return {"state": "granted", "epoch": self.record["epoch"]}

    def measure(self, holder: str) -> HostSample:
        """What this manager is told of the grants, as a probe tells it."""
        told = grants.merge_listings(list(self.listings.values()), holder)
        return HostSample(
            role=Role.EDGE,
            status=HostStatus.OK,
            grant=cast("int", self.record["epoch"]),
            foreign_grant=lease_rules.find_other_epoch(self.record, holder),
            foreign_hosts=tuple(told["hosts"]),
        )

    def change(self, signature: _Document, now: float) -> None:
        """Accept a changing request, which renews the lease."""
        fault = lease_rules.find_fault(self.record, signature, now + self.offset, f"boot{self.boots}")
        if fault:
            raise RefusedError(fault)
        self.record = lease_rules.extend_record(self.record, now + self.offset)

    def release(self, signature: _Document) -> None:
        if all(self.record.get(key) == signature[key] for key in ("holder", "session", "epoch")):
            self.record["until"] = 0.0


class Simulation:
    """One fleet, its two managers and one seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.now = 1000.0
        self.hosts = {name: SimulatedHost(offset=self.random.uniform(0, 1e5)) for name in HOSTS}
        self.changes = 0
        lacks = self.random.choice(("", *HOSTS)) if self.random.random() < 0.5 else ""
        self.inventories = {"ana": HOSTS, "ben": tuple(host for host in HOSTS if host != lacks)}

    def run(self) -> int:
        """Interleave two managers, each with some runs; the number of changes on hosts."""
        lives = {name: self.live(name) for name in ("ana", "ben")}
        while lives:
            name = self.random.choice(sorted(lives))
            for _ in range(self.random.choice((1, 1, 3, 10))):
                if name in lives and next(lives[name], None) is None:
                    del lives[name]
                self.disturb()
                self.judge()
        return self.changes

    def disturb(self) -> None:
        """Time passes, now and then more than a lease; now and then a host reboots."""
        self.now += self.random.choice(
            (0.01, 0.1, 1.0, 5.0, 12.0, 40.0 if self.random.random() < 0.2 else 0.5)
        )
        if self.random.random() < 0.03:
            self.hosts[self.random.choice(HOSTS)].reboot(self.now)

    def judge(self) -> None:
        for task in TASKS:
            places = [name for name, host in self.hosts.items() if task in host.tasks]
            if len(places) > 1:
                raise DoubledError(f"{task} runs on {places}")

    def live(self, name: str) -> Iterator[str]:
        """Some runs of one manager; after each yield anything may have happened."""
        for number in range(4):
            session = f"{name}-{number}"
            lease = FleetLease(
                holder=name,
                session=session,
                who=name,
                verb="apply",
                clock=lambda: self.now,
                ttl_s=LEASE_S,
                hosts=self.inventories[name],
            )
            try:
                yield from self.apply(name, lease)
            except RefusedError:
                yield "refused"

    def apply(self, name: str, lease: FleetLease) -> Iterator[str]:
        """Claim, look, move what is not where this manager wants it, release."""
        seen: dict[str, set[str]] = {}
        samples: dict[str, HostSample] = {}
        hosts = self.inventories[name]
        for host in hosts:
            claim = lease.build_claim(host)
            yield "claim sent"
            lease.take_reply(host, self.hosts[host].claim(claim, self.now))
            seen[host] = set(self.hosts[host].tasks)
            if not lease.refusals:
                samples[host] = drop_known_hosts(self.hosts[host].measure(name), set(hosts))
            yield "claimed"
        if not lease.refusals and self.random.random() > 0.05:  # else it dies with its lease
            held = list_unlisted_hosts(samples) and not is_up_to_date(ManagerState(), samples)
            for task in TASKS:
                if any(task in tasks for tasks in seen.values()) or not held:
                    yield from self.move(lease, task, seen)
        elif not lease.refusals:
            return
        for host in lease.list_granted():
            self.hosts[host].release(lease.sign_release(host))
            yield "released"

    def move(self, lease: FleetLease, task: str, seen: dict[str, set[str]]) -> Iterator[str]:
        wanted = self.random.choice(sorted(seen))
        places = [host for host in seen if task in seen[host]]
        if places == [wanted]:
            return
        for host in places:
            yield from self.send(lease, host, task, starts=False)
        yield from self.send(lease, wanted, task, starts=True)

    def send(self, lease: FleetLease, name: str, task: str, *, starts: bool) -> Iterator[str]:
        """Sign a request, which arrives later, if ever."""
        signature, sent = lease.sign(name), self.now
        yield "sent"
        host = self.hosts[name]
        host.change(signature, self.now)
        (host.tasks.add if starts else host.tasks.discard)(task)
        self.changes += 1
        lease.extend(name, sent)
        yield "carried out"


def run_simulations(simulation: type[Simulation], first_seed: int, count: int) -> int:
    """Run ``count`` interleavings of one kind; the number of changes on hosts.

    Raises:
        DoubledError: with its seed.
    """
    changes = 0
    for seed in range(first_seed, first_seed + count):
        try:
            changes += simulation(seed).run()
        except DoubledError as error:
            raise DoubledError(f"seed {seed}: {error}") from error
    return changes
