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


_Pair = tuple[str, str]


@dataclass(slots=True, eq=False)
class JoinedLinks:
    """The links that were joined last, to take over those whose ends are the very same.

    ``pairs``: the two ends of a link, and what was made of them; ``edges``: the links of an edge, and what
    was made of all; ``peers``: of every host.
    """

    pairs: dict[_Pair, tuple[LinkReply, PeerReply | None, LinkObservation]] = field(default_factory=dict)
    edges: dict[str, tuple[Mapping[str, LinkReply], dict[_Pair, LinkObservation]]] = field(
        default_factory=dict
    )
    peers: dict[str, Mapping[str, PeerReply]] = field(default_factory=dict)


def join_link_ends(
    ends: Mapping[str, LinkEnds],
    partial: Set[_Pair] = frozenset(),
    joined: JoinedLinks | None = None,
) -> dict[_Pair, LinkObservation]:
    """The links by (edge, robot), from the reports of the hosts by name.

    Traffic that is seen only in part (``partial``) does not tell what a link carries. ``joined``: links that
    were made before, of which those are taken whose ends are the very same, and which is kept up.
    """
    joined = JoinedLinks() if joined is None else joined
    peers = {name: each.peers for name, each in ends.items()}
    names = peers.keys() | joined.peers.keys()
    changed = {name for name in names if peers.get(name) is not joined.peers.get(name)}
    joined.peers = peers
    found: dict[_Pair, LinkObservation] = {}
    for edge, each in ends.items():
        known = joined.edges.get(edge)
        if known is None or known[0] is not each.links or not changed.isdisjoint(each.links):
            known = joined.edges[edge] = each.links, _join_edge(edge, each.links, peers, joined)
        found.update(known[1])
    for pair in partial & found.keys():
        found[pair] = replace(found[pair], carries_bytes_per_s=None)
    return found


def _join_edge(
    edge: str,
    links: Mapping[str, LinkReply],
    peers: Mapping[str, Mapping[str, PeerReply]],
    joined: JoinedLinks,
) -> dict[_Pair, LinkObservation]:
    found = {}
    for robot, link in links.items():
        pair, peer = (edge, robot), peers[robot].get(edge) if robot in peers else None
        was = joined.pairs.get(pair)
        if was is None or was[0] is not link or was[1] is not peer:
            was = joined.pairs[pair] = link, peer, _join_link(link, peer)
        found[pair] = was[2]
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
