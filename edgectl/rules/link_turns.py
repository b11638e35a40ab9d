# SPDX-License-Identifier: Apache-2.0
"""Turns of idle links: which are probed next, within the budget of their hosts (ADR 0136). Pure."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from enum import IntEnum

from edgectl.dataclass import dataclass
from edgectl.model.inventory import Inventory
from edgectl.model.link_reading import LinkHistory, LinkObservation
from edgectl.model.snapshot import HostSample, LinkSample, Snapshot, TaskSample
from edgectl.rules.live_links import (
    BUDGET_S,
    FRESH_S,
    MAX_SAMPLES,
    SAMPLE_S,
    Histories,
    Observations,
    Pair,
    list_samples,
)

# Between two probes of a host, where nothing urges.
_SAMPLE_EVERY_S = 100 * SAMPLE_S
# A link that could not be probed, as behind a firewall, is tried again after this time.
_REFUSED_EVERY_S = 600.0
# Most bytes/s that a probe sends: a faster link is found to carry at least that.
MAX_SAMPLE_BYTES_PER_S = 25e6
# Of all links at once.
_MAX_CHOSEN = 16
# Traffic up to this share of the capacity, and up to these bytes/s on the robot's interfaces, is idle.
_IDLE_SHARE, _IDLE_BYTES_PER_S = 0.05, 20e3
# A link whose round trips became so much longer has probably changed: it is probed first.
_RTT_FACTOR, _RTT_MARGIN_MS = 2.0, 5.0
# A link of which nothing was read for so long comes before those of robots whose tasks suffer.
_OVERDUE_S = 10 * BUDGET_S
# The share of recent values above the deadline from which a task is late.
_LATE_SHARE = 0.05
# The age of a reading counts so much where the robot has no task that runs.
_UNUSED_WEIGHT = 0.25


class Urgency(IntEnum):
    """Why a link is probed, most urgent first.

    The link of the robot's tasks fell, and its own reading is older; its own round trips are longer, or it
    was not probed for long; the robot's tasks suffer; its turn.
    """

    FELL = 0
    OVERDUE = 1
    SUFFERS = 2
    TURN = 3


# Probes of a host in the time of its budget up to which each may add one: the rest is kept for what may fall.
_SHARES = {
    Urgency.FELL: MAX_SAMPLES,
    Urgency.OVERDUE: 1,
    Urgency.SUFFERS: MAX_SAMPLES - 1,
    Urgency.TURN: 1,
}
# They send over another link of the robot.
_BESIDE_TRAFFIC = (Urgency.FELL, Urgency.SUFFERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkUse:
    """Links and robots whose capacity matters now.

    ``used``: links of an edge to the robots of the tasks that run there. ``served``: robots with a task that
    runs anywhere. ``late``: those of them with a task that misses its deadline.
    """

    used: Set[Pair] = frozenset()
    served: Set[str] = frozenset()
    late: Set[str] = frozenset()


def find_link_use(snapshot: Snapshot, robots: Mapping[str, Sequence[str]]) -> LinkUse:
    """The links in use, by what runs where; ``robots`` by task."""
    running = [
        (host, robot, task)
        for host, sample in snapshot.hosts.items()
        for name, task in sample.tasks.items()
        if task.state.alive
        for robot in robots.get(name, ())
    ]
    return LinkUse(
        used={(host, robot) for host, robot, _ in running if robot in snapshot.hosts[host].links},
        served={robot for _, robot, _ in running},
        late={robot for _, robot, task in running if _is_late(task)},
    )


def _is_late(task: TaskSample) -> bool:
    seen = task.latency
    return seen is not None and seen.recent_misses > _LATE_SHARE * seen.recent_count


def choose_links_to_probe(
    inventory: Inventory,
    snapshot: Snapshot,
    histories: Histories,
    observations: Observations,
    now: float,
    use: LinkUse | None = None,
) -> tuple[Pair, ...]:
    """The links to probe now, most urgent first.

    All links of a robot at once, where the link of its tasks fell since they were probed; else one for each
    host. Of equal urgency those with longer round trips than before come first, then the oldest reading,
    weighted by how much it varied.
    """
    use = use or LinkUse()
    urgencies = {
        pair: _find_urgency(pair, snapshot, histories, observations, use, now) for pair in observations
    }
    turns = sorted(
        (
            urgency,
            not _has_slowed(histories.get(pair), observations[pair]),
            -_weigh_age(histories.get(pair), now, served=not use.used or pair[1] in use.served),
            pair,
        )
        for pair, urgency in urgencies.items()
        if _can_probe(inventory, snapshot, pair, observations[pair], urgency)
        and not _is_refused(histories.get(pair), now)
    )
    # With no task on an edge nothing can fall.
    shares = _SHARES if use.used else dict.fromkeys(Urgency, MAX_SAMPLES)
    return _spend_budget([(urgency, pair) for urgency, _, _, pair in turns], histories, now, shares)


def _spend_budget(
    turns: Sequence[tuple[Urgency, Pair]], histories: Histories, now: float, shares: Mapping[Urgency, int]
) -> tuple[Pair, ...]:
    """Those of ``turns`` for which the budgets of both hosts suffice.

    The first of each urgency keeps its hosts free where it has to wait; so each link gets its turn.
    """
    times = [
        (host, at) for pair, known in histories.items() for at in list_samples(known, now) for host in pair
    ]
    spent = Counter(host for host, _ in times)
    resting = {host for host, at in times if now - at < _SAMPLE_EVERY_S}
    begun = {Urgency.FELL}
    chosen: list[Pair] = []
    for urgency, pair in turns:
        fits = all(spent[host] < shares[urgency] for host in pair)
        if fits and len(chosen) < _MAX_CHOSEN and (urgency is Urgency.FELL or resting.isdisjoint(pair)):
            chosen.append(pair)
            spent.update(pair)
            resting |= set(pair)
        elif urgency not in begun:
            resting |= set(pair)
        begun.add(urgency)
    return tuple(chosen)


def split_into_rounds(pairs: Sequence[Pair]) -> list[tuple[Pair, ...]]:
    """The links in rounds one after the other, in each of which no two have a host in common."""
    rounds: list[list[Pair]] = []
    for pair in pairs:
        for made in rounds:
            if set(pair).isdisjoint(host for other in made for host in other):
                made.append(pair)
                break
        else:
            rounds.append([pair])
    return [tuple(made) for made in rounds]


def _find_urgency(
    pair: Pair,
    snapshot: Snapshot,
    histories: Histories,
    observations: Observations,
    use: LinkUse,
    now: float,
) -> Urgency:
    robot = pair[1]
    own = histories.get(pair, LinkHistory())
    suffers = robot in use.late
    for other in use.used:
        if other == pair or other[1] != robot:
            continue
        known, link = histories.get(other, LinkHistory()), snapshot.hosts[other[0]].links[robot]
        if _carries_less(link) and known.fell_at - FRESH_S > _find_last_reading(own):
            return Urgency.FELL
        slowed = other in observations and _has_slowed(known, observations[other])
        suffers = suffers or slowed or _carries_less(link)
    if suffers:
        return Urgency.SUFFERS
    if _has_slowed(histories.get(pair), observations[pair]):
        return Urgency.OVERDUE
    return Urgency.TURN if 0.0 <= now - _find_last_reading(own) <= _OVERDUE_S else Urgency.OVERDUE


def _carries_less(link: LinkSample) -> bool:
    """Whether it carries less now than its nominal capacity; a link that is cut off carries nothing."""
    return not link.capacity_bytes_per_s or link.nominal is not None


def _find_last_reading(known: LinkHistory) -> float:
    """When the link was last probed or read from traffic, 0 for never."""
    return max(known.sampled_at, known.readings[-1].at if known.readings else 0.0)


def _weigh_age(known: LinkHistory | None, now: float, *, served: bool) -> float:
    """Seconds since the last reading, up to twice as many where the last two differ."""
    known = known or LinkHistory()
    read_at = _find_last_reading(known)
    age = now - read_at if read_at <= now else now
    rates = [reading.bytes_per_s for reading in known.readings]
    varied = 1.0 - min(rates) / max(rates) if rates else 0.0
    return age * (1.0 + varied) * (1.0 if served else _UNUSED_WEIGHT)


def _is_refused(known: LinkHistory | None, now: float) -> bool:
    return known is not None and known.refused and 0.0 <= now - known.sampled_at < _REFUSED_EVERY_S


def _has_slowed(known: LinkHistory | None, seen: LinkObservation) -> bool:
    if known is None or known.rtt_ms is None or seen.rtt_ms is None:
        return False
    return seen.rtt_ms > _RTT_FACTOR * known.rtt_ms + _RTT_MARGIN_MS


def _can_probe(
    inventory: Inventory, snapshot: Snapshot, pair: Pair, seen: LinkObservation, urgency: Urgency
) -> bool:
    """Whether both ends can be asked, a network is between them, and it is idle.

    A robot whose tasks suffer sends over another link all the time; its other links are probed all the same.
    """
    edge, robot = (snapshot.hosts.get(name) for name in pair)
    if edge is None or robot is None or not (edge.ok and robot.ok and inventory.hosts[pair[1]].probe):
        return False
    link = edge.links.get(pair[1])
    if link is None or not link.capacity_bytes_per_s or seen.interface in ("", "lo"):
        return False
    idle = _IDLE_SHARE * link.capacity_bytes_per_s
    if seen.used_bytes_per_s > idle:
        return False
    return urgency in _BESIDE_TRAFFIC or sum(_list_traffic(robot)) <= max(idle, _IDLE_BYTES_PER_S)


def _list_traffic(robot: HostSample) -> Iterator[float]:
    """Bytes/s on the interfaces of a robot, with UDP and with its other links."""
    for name, interface in robot.device.interfaces.items():
        if name != "lo":
            yield interface.rx_bytes_per_s + interface.tx_bytes_per_s
