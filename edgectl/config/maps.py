"""The ``.yaml`` beside a map's image, as map_server and map_saver of ROS and ROS 2 write it."""

import math
from typing import Any

from edgectl.config.fields import bare, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import Code, Problems
from edgectl.config.scalars import INVALID, Read, amount, text, wrong_type
from edgectl.config.source import decoded
from edgectl.config.yaml12 import parse_yaml
from edgectl.model.map import MapSheet

# Cells of a millimetre to a kilometre, on this planet: whatever is computed of them stays finite.
_FINEST, _COARSEST, _FARTHEST = 1e-3, 1e3, 1e8


def _finite(raw: object) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not math.isfinite(raw) or abs(raw) > _FARTHEST:
        raise ValueError(f"must be a number of at most {_FARTHEST:g}; write 0.05")
    return float(raw)


def _resolution(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    value = amount(_finite)(node, problems)
    if value is not INVALID and not _FINEST <= value <= _COARSEST:
        problems.add(node.mark, Code.QUANTITY, f"must be {_FINEST:g} to {_COARSEST:g} m, not {node.text}", "write the side of a cell in m")
        return INVALID
    return value


def _origin(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    values = bare(amount(_finite))(node, problems)
    if values is INVALID:
        return INVALID
    if len(values) not in (2, 3):
        return wrong_type(node, problems, "must be x, y and yaw", "write [0, 0, 0]")
    if len(values) == 3 and values[2] != 0:
        problems.add(node.mark, Code.QUANTITY, "a map that is turned (yaw) cannot be compared", "save it again with a yaw of 0")
        return INVALID
    return values[:2]


def _negate(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    return bool(node.value) if node.value in (0, 1) else wrong_type(node, problems, "must be 0 or 1", "write 0")


def _mode(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value == "trinary":
        return node.value
    problems.add(node.mark, Code.WORD, f"maps of mode {node.text or '?'} cannot be compared", "save it with mode: trinary")
    return INVALID


_SHARE = amount(_finite, at_most=1.0)
SHEET: dict[str, Read] = {
    "image": text, "resolution": _resolution, "origin": _origin, "negate": _negate, "occupied_thresh": _SHARE, "free_thresh": _SHARE,
    "mode": _mode,
}  # fmt: skip


def read_map(name: str, data: bytes) -> MapSheet:
    """The sheet in the bytes of a file that is called ``name``. Keys that are not ours are other programs' business.

    Raises:
        InputError: everything that is wrong with it.
    """
    problems = Problems()
    source = decoded(name, data, problems)
    node = parse_yaml(source, problems) if source is not None else None
    if node is not None and isinstance(node.value, dict):
        node = Node({key: inner for key, inner in node.value.items() if key in SHEET}, node.mark, keys=node.keys)
    fields = None if node is None else read_fields(node, problems, SHEET, required=("image", "resolution", "origin"), what="a map")
    problems.check()
    assert fields is not None  # noqa: S101 - without a problem there are some
    values = fields.values
    return MapSheet(
        image=values["image"], resolution=values["resolution"], origin=values["origin"], negate=values.get("negate", False),
        occupied=values.get("occupied_thresh", 0.65), free=values.get("free_thresh", 0.196),
    )  # fmt: skip
