# SPDX-License-Identifier: Apache-2.0
"""Live capacity of links (ADR 0077): readings, how they lower what is declared or assumed, and which idle
links to probe next. Pure.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from edgectl.model.inventory import Inventory
from edgectl.model.link_reading import LinkHistory, LinkObservation, LinkReading, LinkSampleResult
from edgectl.model.snapshot import CapacitySource, HostSample, LinkSample, Snapshot

Pair = tuple[str, str]
Histories = Mapping[Pair, LinkHistory]
Observations = Mapping[Pair, LinkObservation]

# A reading that nothing confirms is forgotten after this time.
MAX_READING_AGE_S = 600.0
# The mean of so many readings counts: a change is followed at the second, and one bad moment counts half.
_MAX_READINGS = 2
# Hosts may report any rate above 0; a share of a smaller capacity overflows.
_MIN_BYTES_PER_S = 1.0
# A link that carries this share of its reading without being the limit carries more than the reading says.
_REFUTED_SHARE = 0.9
# A reading of this share of the upper bound is the bound, seen as exactly as links can be read.
_BOUND_SHARE = 0.9
# One probe of an idle link takes at most SAMPLE_S, and no host takes part in more than 1 % of the time.
SAMPLE_S = 0.09
_SAMPLE_EVERY_S = 100 * SAMPLE_S
# A link that could not be probed, as behind a firewall, is tried again after this time.
_REFUSED_EVERY_S = 600.0
# Most bytes/s that a probe sends: a faster link is found to carry at least that.
MAX_SAMPLE_BYTES_PER_S = 25e6
_MAX_SAMPLES = 8
# Traffic up to this share of the capacity, and up to these bytes/s on the robot's interfaces, is idle.
_IDLE_SHARE, _IDLE_BYTES_PER_S = 0.05, 20e3
# A link whose round trips became so much longer has probably changed: it is probed first.
_RTT_FACTOR, _RTT_MARGIN_MS = 2.0, 5.0
# A robot that has answered an edge once, and then left so many probes over so long a time unanswered, is cut
# off (ADR 0097).
_SILENT_PROBES, _SILENT_S = 3, 5.0
LIVE_SOURCES = frozenset({CapacitySource.TCP, CapacitySource.PROBE, CapacitySource.RADIO})


def observe_link(known: LinkHistory, seen: LinkObservation, now: float) -> LinkHistory:
    """The history with what a probe of the hosts saw: an answer of the robot or none, a connection that the
    link limits, or traffic that refutes the readings.
    """
    known = _note_answer(known, seen, now)
    if seen.carries_bytes_per_s:
        return _add_reading(known, seen.carries_bytes_per_s, CapacitySource.TCP, now)
    return _refute_readings(known, seen.used_bytes_per_s, now)


def _note_answer(known: LinkHistory, seen: LinkObservation, now: float) -> LinkHistory:
    if seen.answered:
        return replace(known, answered=True, silent=0, silent_since=0.0, cut_off=False)
    if not known.answered:
        return known
    since = known.silent_since if known.silent else now
    cut_off = known.silent + 1 >= _SILENT_PROBES and now - since >= _SILENT_S
    return replace(known, silent=known.silent + 1, silent_since=since, cut_off=known.cut_off or cut_off)


def add_sample(known: LinkHistory, result: LinkSampleResult, rtt_ms: float | None, now: float) -> LinkHistory:
    """The history with the result of a probe of the idle link."""
    tried = replace(known, sampled_at=now, refused=result.refused, rtt_ms=rtt_ms)
    if not result.bytes_per_s:
        return tried
    if result.full:
        return _add_reading(tried, result.bytes_per_s, CapacitySource.PROBE, now)
    return _refute_readings(tried, result.bytes_per_s, now)


def _add_reading(known: LinkHistory, rate: float, source: CapacitySource, now: float) -> LinkHistory:
    reading = LinkReading(bytes_per_s=max(rate, _MIN_BYTES_PER_S), at=now, source=source)
    return replace(known, readings=(*_select_recent(known, now), reading)[-_MAX_READINGS:])


def _refute_readings(known: LinkHistory, rate: float, now: float) -> LinkHistory:
    recent = _select_recent(known, now)
    refuted = bool(recent) and rate >= _REFUTED_SHARE * _average(recent)
    return replace(known, readings=() if refuted else recent)


def _average(readings: tuple[LinkReading, ...]) -> float:
    return sum(reading.bytes_per_s for reading in readings) / len(readings)


def _select_recent(known: LinkHistory, now: float) -> tuple[LinkReading, ...]:
    """Readings of the last ten minutes; none of the future, should the clock have been set back."""
    return tuple(reading for reading in known.readings if 0.0 <= now - reading.at <= MAX_READING_AGE_S)


def apply_live_capacities(
    snapshot: Snapshot, histories: Histories, observations: Observations, now: float
) -> Snapshot:
    """``snapshot`` with the live capacity of each link where one is known."""

    def apply(edge: str, sample: HostSample) -> HostSample:
        links = {
            robot: compute_live_link(
                link,
                histories.get((edge, robot), LinkHistory()),
                observations.get((edge, robot), LinkObservation()).radio_bytes_per_s,
                now,
            )
            for robot, link in sample.links.items()
        }
        return replace(sample, links=links) if links != sample.links else sample

    return replace(snapshot, hosts={name: apply(name, sample) for name, sample in snapshot.hosts.items()})


def compute_live_link(link: LinkSample, known: LinkHistory, radio: float | None, now: float) -> LinkSample:
    """The link with its live capacity: the mean of its last readings, and not above the radio's rate.

    The declared or assumed capacity is the upper bound, and holds where the readings are at most 10 % lower;
    one that ``probe --bandwidth`` measured is itself a reading, and the newer counts. A link that is down
    stays down, and one whose robot is cut off goes down.
    """
    nominal = link.capacity_bytes_per_s
    if not nominal:
        return link
    if known.cut_off:
        return replace(link, capacity_bytes_per_s=0.0)
    recent = _select_recent(known, now)
    live, source, age = nominal, link.capacity_source, 0.0
    if recent and (source is CapacitySource.MEASURED or _average(recent) < _BOUND_SHARE * nominal):
        live, source, age = _average(recent), recent[-1].source, round(now - recent[-1].at, 3)
    if radio and radio < live:
        live, source, age = max(radio, _MIN_BYTES_PER_S), CapacitySource.RADIO, 0.0
    if source is link.capacity_source:
        return link
    return replace(
        link, capacity_bytes_per_s=live, capacity_source=source, capacity_age_s=age, nominal=nominal
    )


def choose_links_to_probe(
    inventory: Inventory, snapshot: Snapshot, histories: Histories, observations: Observations, now: float
) -> tuple[Pair, ...]:
    """The idle links whose turn it is: those with longer round trips than before, then the one probed longest
    ago; no two with a host in common.
    """
    busy = _list_resting_hosts(histories, now)
    turns = sorted(
        (not _has_slowed(histories.get(pair), seen), histories.get(pair, LinkHistory()).sampled_at, pair)
        for pair, seen in observations.items()
        if _can_probe(inventory, snapshot, pair, seen) and not _is_refused(histories.get(pair), now)
    )
    chosen: list[Pair] = []
    for *_, pair in turns:
        if busy.isdisjoint(pair) and len(chosen) < _MAX_SAMPLES:
            chosen.append(pair)
            busy |= set(pair)
    return tuple(chosen)


def _list_resting_hosts(histories: Histories, now: float) -> set[str]:
    """Hosts that took part in a probe less than a hundred of its durations ago."""
    return {
        host
        for pair, known in histories.items()
        if 0.0 <= now - known.sampled_at < _SAMPLE_EVERY_S
        for host in pair
    }


def _is_refused(known: LinkHistory | None, now: float) -> bool:
    return known is not None and known.refused and 0.0 <= now - known.sampled_at < _REFUSED_EVERY_S


def _has_slowed(known: LinkHistory | None, seen: LinkObservation) -> bool:
    if known is None or known.rtt_ms is None or seen.rtt_ms is None:
        return False
    return seen.rtt_ms > _RTT_FACTOR * known.rtt_ms + _RTT_MARGIN_MS


def _can_probe(inventory: Inventory, snapshot: Snapshot, pair: Pair, seen: LinkObservation) -> bool:
    """Whether both ends can be asked, a network is between them, and it is idle."""
    edge, robot = (snapshot.hosts.get(name) for name in pair)
    if edge is None or robot is None or not (edge.ok and robot.ok and inventory.hosts[pair[1]].probe):
        return False
    link = edge.links.get(pair[1])
    if link is None or not link.capacity_bytes_per_s or seen.interface in ("", "lo"):
        return False
    idle = _IDLE_SHARE * link.capacity_bytes_per_s
    return seen.used_bytes_per_s <= idle and sum(_list_traffic(robot)) <= max(idle, _IDLE_BYTES_PER_S)


def _list_traffic(robot: HostSample) -> Iterator[float]:
    """Bytes/s on the interfaces of a robot, with UDP and with its other links."""
    for name, interface in robot.device.interfaces.items():
        if name != "lo":
            yield interface.rx_bytes_per_s + interface.tx_bytes_per_s
