"""Images made up for tests, as bytes."""

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from PIL import Image

from edgectl.experiments.files.map_file import MapMetadata
from edgectl.experiments.ssim import MapImage

Rows = Sequence[Sequence[int]] | np.ndarray


def pgm(rows: Rows) -> bytes:
    """A binary .pgm of 8 bits."""
    pixels = np.asarray(rows, dtype=np.uint8)
    return f"P5\n# CREATOR: a test\n{pixels.shape[1]} {pixels.shape[0]}\n255\n".encode() + pixels.tobytes()


def png(image: Image.Image) -> bytes:
    """The image as a .png."""
    stream = BytesIO()
    image.save(stream, "PNG")
    return stream.getvalue()


def grey(rows: Rows) -> Image.Image:
    """An image of 8 bits."""
    return Image.fromarray(np.asarray(rows, dtype=np.uint8))


def room(width: int = 24, height: int = 16) -> np.ndarray:
    """A map that looks different from every side: walls around, one inside, an obstacle, a corner that nobody saw."""
    cells = np.full((height, width), 254)
    cells[[0, -1], :] = cells[:, [0, -1]] = 0
    cells[: height // 2, width // 3] = 0
    cells[height - 5 : height - 3, 3:6] = 0
    cells[-4:, -5:] = 205
    return cells


def sheet(x: float = 0.0, y: float = 0.0, resolution: float = 0.5, **more: object) -> MapMetadata:
    """Where a map lies."""
    return MapMetadata(image="map.pgm", resolution=resolution, origin=(x, y), **more)  # type: ignore[arg-type]


def picture(rows: Rows, lies: MapMetadata | None = None, name: str = "map.pgm") -> MapImage:
    """The rows as a .pgm, with or without a sheet."""
    return MapImage(name=name, data=pgm(rows), metadata=lies)
