# SPDX-License-Identifier: Apache-2.0
"""Readings of the live capacity of links, kept between calls: a cache, which the next probes fill again."""

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.formats.kinds import DocumentKind
from edgectl.model.encoding import in_document
from edgectl.model.link_reading import LinkHistory
from edgectl.state.json_files import Warn, ignore_warning, load_or_set_aside, write_json


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredHistories:
    """Histories by edge, then robot."""

    links: Mapping[str, Mapping[str, LinkHistory]] = field(
        default_factory=dict, metadata=in_document(required=True)
    )


_FILE_NAME = "live-links.json"
_KIND = DocumentKind(name="file of link readings", version=1, model=_StoredHistories)


def load_link_histories(fleet_dir: Path, warn: Warn = ignore_warning) -> dict[tuple[str, str], LinkHistory]:
    """The histories by (edge, robot); empty where there are none."""
    stored = load_or_set_aside(fleet_dir / _FILE_NAME, _KIND.decode, _StoredHistories(), warn)
    return {(edge, robot): known for edge, robots in stored.links.items() for robot, known in robots.items()}


def save_link_histories(fleet_dir: Path, histories: Mapping[tuple[str, str], LinkHistory]) -> None:
    """Replace the histories.

    Raises:
        StateError: the disk does not take it.
    """
    links: dict[str, dict[str, LinkHistory]] = {}
    for (edge, robot), known in sorted(histories.items()):
        links.setdefault(edge, {})[robot] = known
    write_json(fleet_dir / _FILE_NAME, _KIND.encode(_StoredHistories(links=links)))
