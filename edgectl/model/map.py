"""Maps as map_server writes them."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSheet:
    """What the ``.yaml`` of a map says: where its ``image`` is and lies, and what its greys mean.

    ``resolution``: m per cell. ``origin``: x and y in m of the outer corner of the lowest left cell. A cell is occupied where its darkness
    (its brightness where ``negate``) is above ``occupied``, free where it is below ``free``, both 0..1, and unknown between.
    """

    image: str
    resolution: float
    origin: tuple[float, float]
    negate: bool = False
    occupied: float = 0.65
    free: float = 0.196
