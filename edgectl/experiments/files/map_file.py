# SPDX-License-Identifier: Apache-2.0
"""Reader of the metadata files of ROS map_server."""

import math
from dataclasses import dataclass
from typing import Any

from edgectl.config.fields import list_reader, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.config.scalars import INVALID, NodeReader, quantity_reader, read_text, report_wrong_type
from edgectl.config.source import MAX_INPUT_BYTES, decode_source
from edgectl.config.yaml_parser import parse_yaml
from edgectl.units import QuantityError


@dataclass(frozen=True, slots=True, kw_only=True)
class MapMetadata:
    """The ``.yaml`` file of a map: image file, position and thresholds.

    ``resolution``: m per cell. ``origin``: x and y in m of the outer corner of the lower left cell. A cell is
    occupied if its darkness (with ``negate``, its brightness) is above ``occupied``, free if it is below
    ``free``, and unknown between them; both thresholds are in 0..1.
    """

    image: str
    resolution: float
    origin: tuple[float, float]
    negate: bool = False
    occupied: float = 0.65
    free: float = 0.196


# Cells from 1 mm to 1 km and coordinates of this planet: results computed from them stay finite.
_MIN_RESOLUTION_M, _MAX_RESOLUTION_M, _MAX_MAGNITUDE = 1e-3, 1e3, 1e8


def _parse_bounded_number(raw: object) -> float:
    if (
        isinstance(raw, bool)
        or not isinstance(raw, int | float)
        or not math.isfinite(raw)
        or abs(raw) > _MAX_MAGNITUDE
    ):
        raise QuantityError(f"must be a number of at most {_MAX_MAGNITUDE:g}", "write 0.05")
    return float(raw)


def _read_resolution(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    value = quantity_reader(_parse_bounded_number)(node, problems)
    if value is not INVALID and not _MIN_RESOLUTION_M <= value <= _MAX_RESOLUTION_M:
        problems.add(
            node.mark,
            ProblemCode.QUANTITY,
            f"must be {_MIN_RESOLUTION_M:g} to {_MAX_RESOLUTION_M:g} m, not {node.text}",
            "write the edge length of a cell in m",
        )
        return INVALID
    return value


def _read_origin(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    values = list_reader(quantity_reader(_parse_bounded_number))(node, problems)
    if values is INVALID:
        return INVALID
    if len(values) not in (2, 3):
        return report_wrong_type(node, problems, "must be x, y and yaw", "write [0, 0, 0]")
    if len(values) == 3 and values[2] != 0:
        problems.add(
            node.mark,
            ProblemCode.QUANTITY,
            "maps with a yaw cannot be compared",
            "save the map with a yaw of 0",
        )
        return INVALID
    return values[:2]


def _read_negate(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    return (
        bool(node.value)
        if node.value in (0, 1)
        else report_wrong_type(node, problems, "must be 0 or 1", "write 0")
    )


def _read_mode(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value == "trinary":
        return node.value
    problems.add(
        node.mark,
        ProblemCode.WORD,
        f"maps of mode {node.text or '?'} cannot be compared",
        "save the map with mode: trinary",
    )
    return INVALID


_read_threshold = quantity_reader(_parse_bounded_number, at_most=1.0)
MAP_METADATA_KEYS: dict[str, NodeReader] = {
    "image": read_text,
    "resolution": _read_resolution,
    "origin": _read_origin,
    "negate": _read_negate,
    "occupied_thresh": _read_threshold,
    "free_thresh": _read_threshold,
    "mode": _read_mode,
}


def _decode_bounded(name: str, data: bytes, problems: Problems) -> Source | None:
    """The text of the file; hosts send files of any size, and YAML takes twenty times theirs."""
    if len(data) <= MAX_INPUT_BYTES:
        return decode_source(name, data, problems)
    nowhere = Mark(Source(file=name, text="", lines=()), 0, 0)
    message = f"the file is larger than {MAX_INPUT_BYTES // 2**20} MiB"
    problems.add(nowhere, ProblemCode.SIZE, message, "name the .yaml file of a map")
    return None


def parse_map_metadata(name: str, data: bytes) -> MapMetadata:
    """The metadata in the bytes of the file ``name``. Unknown keys are ignored: other programs add their own.

    Raises:
        InputError: all faults of the file.
    """
    problems = Problems()
    source = _decode_bounded(name, data, problems)
    node = parse_yaml(source, problems) if source is not None else None
    if node is not None and isinstance(node.value, dict):
        node = Node(
            {key: inner for key, inner in node.value.items() if key in MAP_METADATA_KEYS},
            node.mark,
            keys=node.keys,
        )
    fields = (
        None
        if node is None
        else read_fields(
            node, problems, MAP_METADATA_KEYS, required=("image", "resolution", "origin"), what="a map"
        )
    )
    problems.check()
    assert fields is not None  # noqa: S101 - no problems: it was read
    values = fields.values
    return MapMetadata(
        image=values["image"],
        resolution=values["resolution"],
        origin=values["origin"],
        negate=values.get("negate", False),
        occupied=values.get("occupied_thresh", 0.65),
        free=values.get("free_thresh", 0.196),
    )
