"""Link capacities that ``probe --bandwidth`` measured, in bytes/s by (edge, robot)."""

import math
from collections.abc import Mapping
from pathlib import Path

from edgectl.state.files import FORMAT_VERSION, Warn, load_or_set_aside, silent, write_json

_NAME = "links.json"
Capacities = Mapping[tuple[str, str], float]


def load_links(fleet_dir: Path, warn: Warn = silent) -> Capacities:
    """The measured capacities; empty where none were measured."""
    return load_or_set_aside(fleet_dir / _NAME, _decode, {}, warn)


def save_links(fleet_dir: Path, capacities: Capacities) -> None:
    """Replace the measured capacities."""
    links: dict[str, dict[str, float]] = {}
    for (edge, robot), value in sorted(capacities.items()):
        links.setdefault(edge, {})[robot] = value
    write_json(fleet_dir / _NAME, {"format_version": FORMAT_VERSION, "links": links})


def _decode(document: dict[str, object]) -> Capacities:
    edges = document.get("links")
    if not isinstance(edges, dict) or not all(isinstance(robots, dict) for robots in edges.values()):
        raise ValueError("links must be an object of objects")
    return {(edge, robot): _rate(value) for edge, robots in edges.items() for robot, value in robots.items()}


def _rate(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
        raise ValueError(f"not a rate: {value!r}")
    return float(value)
