# SPDX-License-Identifier: Apache-2.0
"""Live capacity of links (ADR 0077): readings, and how they lower what is declared or assumed. Pure."""

import math
from collections.abc import Mapping
from dataclasses import replace

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
# A reading below this share of the one before is a fall: two of one rate, each within 15 %, differ less.
_FALL_SHARE = 0.7
# Traffic from this share of it on, and below the share that refutes it, confirms a fall.
_FALL_TRAFFIC_SHARE = 0.5
# One probe of an idle link takes at most SAMPLE_S, and no host takes part in more than 1 % of the time: in so
# many probes in any time of so many seconds (ADR 0136).
SAMPLE_S = 0.09
MAX_SAMPLES = 3
BUDGET_S = 100 * SAMPLE_S * MAX_SAMPLES
# A reading so much older than the fall of the link that a robot's tasks use is of where the robot was before.
FRESH_S = BUDGET_S / MAX_SAMPLES
# A robot that has answered an edge once, and then left so many probes over so long a time unanswered, is cut
# off (ADR 0097).
_SILENT_PROBES, _SILENT_S = 3, 5.0
_NOTHING_READ, _NOTHING_SEEN = LinkHistory(), LinkObservation()
LIVE_SOURCES = frozenset({CapacitySource.TCP, CapacitySource.PROBE, CapacitySource.RADIO})


def observe_link(
    known: LinkHistory, seen: LinkObservation, now: float, nominal: float = math.inf
) -> LinkHistory:
    """The history with what a probe of the hosts saw: an answer of the robot or none, a connection that the
    link limits, or traffic that refutes the readings. A fall that bursts show counts at once, since the
    traffic of the whole window stays below it; else the mean with the reading before.

    ``nominal``: bytes/s that it carries where nothing was read of it.
    """
    if says_nothing_new(known, seen):
        return known
    known = _note_answer(known, seen, now)
    if seen.carries_bytes_per_s:
        found = _add_reading(known, seen.carries_bytes_per_s, CapacitySource.TCP, now, nominal)
        # A connection that sends all the time is all of the traffic, and is read again with the next plan.
        in_bursts = seen.used_bytes_per_s < seen.carries_bytes_per_s
        return replace(found, readings=found.readings[-1:]) if in_bursts and found.fell_at == now else found
    return _refute_readings(_confirm_fall(known, seen.used_bytes_per_s), seen.used_bytes_per_s, now)


def says_nothing_new(known: LinkHistory, seen: LinkObservation) -> bool:
    """Whether an idle link without readings answers as it did: most links of a large fleet, looked at in each
    cycle of a watch.
    """
    waits = known.readings or known.silent or known.silent_since or known.cut_off
    return not (waits or seen.carries_bytes_per_s) and bool(seen.answered) == known.answered


def forget_former_readings(known: Histories, now: float) -> dict[Pair, LinkHistory]:
    """The histories without readings of where a robot was before: when the link of its tasks falls ``now``,
    older ones of its other links say no more than what is declared.
    """
    fell = {robot for (_, robot), each in known.items() if each.fell_at == now}
    if not fell:
        return dict(known)
    return {
        pair: replace(each, readings=tuple(one for one in each.readings if one.at > now - FRESH_S))
        if pair[1] in fell
        else each
        for pair, each in known.items()
    }


def _confirm_fall(known: LinkHistory, rate: float) -> LinkHistory:
    """Forget the reading before a fall, once traffic of that size stays below what was read then."""
    if len(known.readings) < _MAX_READINGS or known.readings[-1].at != known.fell_at:
        return known
    last = known.readings[-1].bytes_per_s
    stays = _FALL_TRAFFIC_SHARE * last <= rate < _REFUTED_SHARE * last
    return replace(known, readings=known.readings[-1:]) if stays else known


def _note_answer(known: LinkHistory, seen: LinkObservation, now: float) -> LinkHistory:
    if seen.answered:
        if known.answered and not (known.silent or known.silent_since or known.cut_off):
            return known
        return replace(known, answered=True, silent=0, silent_since=0.0, cut_off=False)
    if not known.answered:
        return known
    since = known.silent_since if known.silent else now
    cut_off = known.silent + 1 >= _SILENT_PROBES and now - since >= _SILENT_S
    return replace(
        known,
        silent=known.silent + 1,
        silent_since=since,
        cut_off=known.cut_off or cut_off,
        fell_at=now if cut_off and not known.cut_off else known.fell_at,
    )


def add_sample(
    known: LinkHistory,
    result: LinkSampleResult,
    rtt_ms: float | None,
    now: float,
    nominal: float = math.inf,
) -> LinkHistory:
    """The history with the result of a probe of the idle link."""
    tried = replace(
        known,
        sampled_at=now,
        sampled_before=list_samples(known, now)[1 - MAX_SAMPLES :],
        refused=result.refused,
        rtt_ms=rtt_ms,
    )
    if not result.bytes_per_s:
        return tried
    if result.full:
        return _add_reading(tried, result.bytes_per_s, CapacitySource.PROBE, now, nominal)
    return _refute_readings(tried, result.bytes_per_s, now)


def list_samples(known: LinkHistory, now: float) -> tuple[float, ...]:
    """When the link was probed, as far as it counts against the budget of its hosts ``now``, oldest first."""
    times = (*known.sampled_before, known.sampled_at)
    return tuple(at for at in times if at and 0.0 <= now - at < BUDGET_S)


def _add_reading(
    known: LinkHistory, rate: float, source: CapacitySource, now: float, nominal: float
) -> LinkHistory:
    reading = LinkReading(bytes_per_s=max(rate, _MIN_BYTES_PER_S), at=now, source=source)
    recent = _select_recent(known, now)
    # The mean would still fall when the second reading after a change comes in.
    before = min(recent[-1].bytes_per_s, nominal) if recent else nominal
    fell = reading.bytes_per_s < _FALL_SHARE * before
    return replace(
        known,
        readings=(*recent, reading)[-_MAX_READINGS:],
        fell_at=now if fell else known.fell_at,
    )


def _refute_readings(known: LinkHistory, rate: float, now: float) -> LinkHistory:
    if not known.readings:
        return known
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
    limited = {edge for (edge, _), each in histories.items() if each.readings or each.cut_off}
    limited |= {edge for (edge, _), seen in observations.items() if seen.radio_bytes_per_s}
    if not limited:
        return snapshot

    def apply(edge: str, sample: HostSample) -> HostSample:
        links = {
            robot: compute_live_link(
                link,
                histories.get((edge, robot), _NOTHING_READ),
                observations.get((edge, robot), _NOTHING_SEEN).radio_bytes_per_s,
                now,
            )
            for robot, link in sample.links.items()
        }
        return replace(sample, links=links) if links != sample.links else sample

    hosts = {
        name: apply(name, sample) if name in limited else sample for name, sample in snapshot.hosts.items()
    }
    return replace(snapshot, hosts=hosts)


def compute_live_link(link: LinkSample, known: LinkHistory, radio: float | None, now: float) -> LinkSample:
    """The link with its live capacity: the mean of its last readings, and not above the radio's rate.

    The declared or assumed capacity is the upper bound, and holds where the readings are at most 10 % lower;
    one that ``probe --bandwidth`` measured is itself a reading, and the newer counts. A link that is down
    stays down, and one whose robot is cut off goes down.
    """
    nominal = link.capacity_bytes_per_s
    if not nominal or not (known.readings or known.cut_off or radio):
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
