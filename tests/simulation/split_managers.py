# SPDX-License-Identifier: Apache-2.0
"""Interleavings of two managers that share an etcd, on a split network.

The hosts decide by the agent's own rules of the lease (``lease_rules``), the managers sign by their own lease
(``FleetLease``) with a term in etcd. etcd is a model of few lines: one key with a lease, one state that only its holder
may write. Each manager sees a part of the hosts; with two seeds of three the parts have no host in common. A manager
takes the key, reads the state, claims and looks at what it sees, announces its starts, moves tasks, and saves what runs
where. Between any two requests the other manager may act, a host may reboot, a manager may freeze past its lease or die.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from edgectl.errors import CoordinationError, RefusedError
from edgectl.transport.fleet_lease import FleetLease
from tests.simulation.two_managers import HOSTS, LEASE_S, TASKS, Simulation

TTL_S, SHARED = 15.0, "shared"
Places = Mapping[str, frozenset[str]]


@dataclass
class SimulatedEtcd:
    """The key of the holder with its lease, and by task the hosts on which it may run."""

    revision: int = 0
    until: float = 0.0
    places: Places = field(default_factory=dict)


@dataclass
class SimulatedTerm:
    """The lease of one holder, counted by its own clock from before it was asked for."""

    simulation: "SplitSimulation"
    revision: int
    until: float

    def is_over(self) -> bool:
        return self.simulation.now >= self.until

    def renew(self, sent: float) -> None:
        etcd, now = self.simulation.etcd, self.simulation.now
        if etcd.revision == self.revision and now < etcd.until and not self.is_over():
            etcd.until, self.until = now + TTL_S, sent + TTL_S

    def save_state(self, state: bytes) -> int:
        raise NotImplementedError

    def save(self, places: Places) -> None:
        etcd = self.simulation.etcd
        if etcd.revision != self.revision or self.simulation.now >= etcd.until:
            raise CoordinationError("the fleet was lost")
        etcd.places = places


class SplitSimulation(Simulation):
    """One fleet, its two managers, one etcd and one seed. ``announces``: as edgectl does, else it is left out."""

    announces = True

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.etcd = SimulatedEtcd()
        self.terms: list[SimulatedTerm] = []
        number = self.random.randint(1, len(HOSTS) - 1)
        overlap = self.random.choice((0, 0, 1))
        self.inventories = {"ana": HOSTS[:number], "ben": HOSTS[number - overlap :]}

    def disturb(self) -> None:
        """Now and then a renewal is lost, or its manager stands still."""
        super().disturb()
        for term in self.terms[-2:]:
            if self.random.random() < 0.8:
                term.renew(self.now)

    def live(self, name: str) -> Iterator[str]:
        for number in range(4):
            try:
                yield from self.apply_split(name, f"{name}-{number}")
            except (RefusedError, CoordinationError):
                yield "refused"

    def take(self) -> SimulatedTerm | None:
        """The key, if nobody holds it; its revision is later than any before."""
        if self.now < self.etcd.until:
            return None
        self.etcd.revision += 1
        self.etcd.until = self.now + TTL_S
        self.terms.append(SimulatedTerm(self, self.etcd.revision, self.now + TTL_S))
        return self.terms[-1]

    def apply_split(self, name: str, session: str) -> Iterator[str]:
        while (term := self.take()) is None:
            yield "waits"
        yield "taken"
        places = dict(self.etcd.places)
        yield "read"
        lease = FleetLease(
            holder=SHARED,
            manager=name,
            session=session,
            who=name,
            verb="apply",
            clock=lambda: self.now,
            ttl_s=LEASE_S,
            term=term,
        )
        seen: dict[str, set[str]] = {}
        for host in self.inventories[name]:
            claim = lease.build_claim(host)
            yield "claim sent"
            lease.take_reply(host, self.hosts[host].claim(claim, self.now))
            seen[host] = set(self.hosts[host].tasks)
            yield "claimed"
        if lease.refusals:
            return
        yield from self.change(lease, term, seen, places)
        if self.random.random() > 0.1:  # else it dies with its leases
            for host in lease.list_granted():
                self.hosts[host].release(lease.sign_release(host))
                yield "released"
            if self.etcd.revision == term.revision:
                self.etcd.until = 0.0

    def change(
        self,
        lease: FleetLease,
        term: SimulatedTerm,
        seen: dict[str, set[str]],
        places: dict[str, frozenset[str]],
    ) -> Iterator[str]:
        """Announce, move each task to where this manager wants it, save; what may run out of sight is held."""
        wanted = {
            task: self.random.choice(sorted(seen))
            for task in TASKS
            if any(task in tasks for tasks in seen.values())
            or not places.get(task, frozenset()) - seen.keys()
        }
        if self.announces:
            term.save(
                {**places, **{task: places.get(task, frozenset()) | {host} for task, host in wanted.items()}}
            )
            yield "announced"
        for task, host in wanted.items():
            for other in seen:
                if task in seen[other] and other != host:
                    yield from self.send(lease, other, task, starts=False)
            if task not in seen[host]:
                yield from self.send(lease, host, task, starts=True)
        if self.random.random() > 0.1:  # else it is killed before that
            term.save({**places, **{task: frozenset((host,)) for task, host in wanted.items()}})
            yield "saved"
