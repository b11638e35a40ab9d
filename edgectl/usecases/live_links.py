# SPDX-License-Identifier: Apache-2.0
"""Live capacity of the links of a fleet: read at every probe, and by probes of idle links on request."""

import math
from collections.abc import Mapping, Set
from dataclasses import replace

from edgectl.errors import StateError
from edgectl.model.event import Event, EventKind
from edgectl.model.link_reading import LinkHistory, LinkObservation
from edgectl.model.snapshot import Snapshot
from edgectl.rules.live_links import (
    add_sample,
    apply_live_capacities,
    forget_former_readings,
    observe_link,
    says_nothing_new,
)
from edgectl.state.link_readings import load_link_histories, save_link_histories
from edgectl.usecases.fleet import Fleet

_NOTHING = LinkHistory()


def measure_live_links(
    fleet: Fleet,
    snapshot: Snapshot,
    observations: Mapping[tuple[str, str], LinkObservation],
    *,
    probe_idle: bool,
) -> Snapshot:
    """``snapshot`` with the live capacity of its links, from ``observations`` and the readings of earlier
    calls.

    ``probe_idle``: also probe the idle links whose turn it is, unless the inventory says ``probe_links:
    false``. The readings are kept; a disk that does not take them costs a warning.
    """
    stored = load_link_histories(fleet.state, fleet.warn)
    blind = {robot.name for robot in fleet.inventory.robots if not robot.probe}
    answers = _answer_for(blind, observations) if blind else observations
    observed = {
        pair: observe_link(
            stored.get(pair, _NOTHING),
            link,
            snapshot.taken_at,
            _find_nominal(snapshot, pair) if link.carries_bytes_per_s else math.inf,
        )
        for pair, link in answers.items()
        if not says_nothing_new(stored.get(pair, _NOTHING), link)
    }
    news = forget_former_readings(observed, snapshot.taken_at)
    changed = {pair: each for pair, each in news.items() if each is not stored.get(pair, _NOTHING)}
    _record_cut_links(fleet, snapshot, stored, changed)
    seen = apply_live_capacities(snapshot, news, observations, snapshot.taken_at)
    if probe_idle and fleet.inventory.probe_links:
        from edgectl.gateway.bandwidth import probe_idle_links
        from edgectl.rules.link_turns import choose_links_to_probe, find_link_use, split_into_rounds

        known = {pair: news.get(pair) or stored.get(pair, _NOTHING) for pair in observations}
        use = find_link_use(seen, {name: task.robots for name, task in fleet.tasks.tasks.items()})
        chosen = choose_links_to_probe(fleet.inventory, seen, known, observations, snapshot.taken_at, use)
        for pairs in split_into_rounds(chosen):
            rates = {pair: _find_nominal(snapshot, pair) for pair in pairs}
            for pair, result in probe_idle_links(fleet.inventory, fleet.transport, rates).items():
                known[pair] = changed[pair] = add_sample(
                    known[pair], result, observations[pair].rtt_ms, snapshot.taken_at, rates[pair]
                )
        seen = apply_live_capacities(snapshot, known, observations, snapshot.taken_at)
    # Links of hosts that did not answer now are kept.
    gone = {
        pair for pair in stored if pair not in observations and not fleet.inventory.hosts.keys() >= {*pair}
    }
    if gone or changed:
        kept = {pair: each for pair, each in {**stored, **changed}.items() if pair not in gone}
        _save(fleet, stored, {pair: each for pair, each in kept.items() if each != _NOTHING})
    return seen


def _answer_for(
    blind: Set[str], observations: Mapping[tuple[str, str], LinkObservation]
) -> dict[tuple[str, str], LinkObservation]:
    """The observations, where robots that are never contacted (``blind``) never count as cut off."""
    return {
        pair: replace(link, answered=True) if pair[1] in blind else link
        for pair, link in observations.items()
    }


def _find_nominal(snapshot: Snapshot, pair: tuple[str, str]) -> float:
    """Bytes/s that the link carries where no live reading says less."""
    link = snapshot.hosts[pair[0]].links.get(pair[1])
    return math.inf if link is None else link.nominal_bytes_per_s


def _record_cut_links(
    fleet: Fleet,
    snapshot: Snapshot,
    stored: Mapping[tuple[str, str], LinkHistory],
    changed: Mapping[tuple[str, str], LinkHistory],
) -> None:
    """Record an event for each edge that, since the last probe, is cut off from a robot that answers here, or
    is not any more; ``changed``: the histories that are not as they were ``stored``.
    """
    events = [
        _build_link_event(snapshot.taken_at, edge, robot, cut_off=link.cut_off)
        for (edge, robot), link in changed.items()
        if link.cut_off != stored.get((edge, robot), _NOTHING).cut_off
        and robot in snapshot.hosts
        and snapshot.hosts[robot].ok
    ]
    if events:
        fleet.history.use(fleet.state, fleet.warn, lambda store: store.record_events(events))


def _build_link_event(at: float, edge: str, robot: str, *, cut_off: bool) -> Event:
    if cut_off:
        return Event(
            at=at, kind=EventKind.LINK_DOWN, host=edge, message=f"{robot} does not answer it any more"
        )
    return Event(at=at, kind=EventKind.LINK_BACK, host=edge, message=f"{robot} answers it again")


def _save(
    fleet: Fleet,
    stored: Mapping[tuple[str, str], LinkHistory],
    known: Mapping[tuple[str, str], LinkHistory],
) -> None:
    if known == stored:
        return
    try:
        save_link_histories(fleet.state, known)
    except StateError as error:
        fleet.warn(f"readings of links are not kept: {error.message}")
