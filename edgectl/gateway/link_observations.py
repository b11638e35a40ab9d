# SPDX-License-Identifier: Apache-2.0
"""Links as both ends report them: each end knows what limits its own sending."""

from collections.abc import Mapping, Set
from dataclasses import field, replace

from edgectl.dataclass import dataclass
from edgectl.gateway.replies import LinkReply, PeerReply
from edgectl.model.link_reading import LinkObservation

_NO_PEER = PeerReply()


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkEnds:
    """Of an edge its ``links`` by robot, of a robot its ``peers`` by edge."""

    links: Mapping[str, LinkReply] = field(default_factory=dict)
    peers: Mapping[str, PeerReply] = field(default_factory=dict)


# By (edge, robot): the two ends, and what was made of them.
JoinedLinks = dict[tuple[str, str], tuple[LinkReply, PeerReply | None, LinkObservation]]


def join_link_ends(
    ends: Mapping[str, LinkEnds],
    partial: Set[tuple[str, str]] = frozenset(),
    joined: JoinedLinks | None = None,
) -> dict[tuple[str, str], LinkObservation]:
    """The links by (edge, robot), from the reports of the hosts by name.

    Traffic that is seen only in part (``partial``) does not tell what a link carries. ``joined``: links that
    were made before, of which those are taken whose ends are the very same, and which is kept up.
    """
    joined = {} if joined is None else joined
    found = {}
    for edge, each in ends.items():
        for robot, link in each.links.items():
            pair, peer = (edge, robot), ends[robot].peers.get(edge) if robot in ends else None
            was = joined.get(pair)
            if was is None or was[0] is not link or was[1] is not peer:
                was = joined[pair] = link, peer, _join_link(link, peer)
            found[pair] = was[2]
    for pair in partial & found.keys():
        found[pair] = replace(found[pair], carries_bytes_per_s=None)
    return found


def _join_link(link: LinkReply, peer: PeerReply | None) -> LinkObservation:
    """The limit that either end met counts, and the slower of two radios."""
    far = peer or _NO_PEER
    carries = [rate for rate in (link.carries_bytes_per_s, far.carries_bytes_per_s) if rate]
    radios = [rate for rate in (link.radio_bytes_per_s, far.radio_bytes_per_s) if rate]
    return LinkObservation(
        used_bytes_per_s=link.rx_bytes_per_s + link.tx_bytes_per_s,
        carries_bytes_per_s=max(carries, default=None),
        radio_bytes_per_s=min(radios, default=None),
        interface=link.interface,
        rtt_ms=link.rtt_ms,
        answered=link.reachable,
    )
