# SPDX-License-Identifier: Apache-2.0
"""Readings of the live capacity of links, kept between calls: a cache, which the next probes fill again."""

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.formats.kinds import DocumentKind
from edgectl.model.encoding import in_document
from edgectl.model.link_reading import LinkHistory
from edgectl.state.json_files import (
    FileStamp,
    Warn,
    ignore_warning,
    load_or_set_aside,
    read_stamp,
    write_json,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredHistories:
    """Histories by edge, then robot."""

    links: Mapping[str, Mapping[str, LinkHistory]] = field(
        default_factory=dict, metadata=in_document(required=True)
    )


_FILE_NAME = "live-links.json"
_Histories = dict[tuple[str, str], LinkHistory]
# By file: what it was when it was read last, and what it had.
_READ: dict[Path, tuple[FileStamp | None, _Histories]] = {}
_KIND = DocumentKind(name="file of link readings", version=1, model=_StoredHistories)


def load_link_histories(fleet_dir: Path, warn: Warn = ignore_warning) -> _Histories:
    """The histories by (edge, robot); empty where there are none.

    A file that has not changed since is not read again: a watch asks in every cycle.
    """
    path = fleet_dir / _FILE_NAME
    stamp = read_stamp(path)
    known = _READ.get(path)
    if known is None or known[0] != stamp or stamp is None:
        stored = load_or_set_aside(path, _KIND.decode, _StoredHistories(), warn)
        known = _READ[path] = (
            stamp,
            {(edge, robot): each for edge, robots in stored.links.items() for robot, each in robots.items()},
        )
    return dict(known[1])


def save_link_histories(fleet_dir: Path, histories: Mapping[tuple[str, str], LinkHistory]) -> None:
    """Replace the histories.

    Raises:
        StateError: the disk does not take it.
    """
    links: dict[str, dict[str, LinkHistory]] = {}
    for (edge, robot), known in sorted(histories.items()):
        links.setdefault(edge, {})[robot] = known
    write_json(fleet_dir / _FILE_NAME, _KIND.encode(_StoredHistories(links=links)))
