# SPDX-License-Identifier: Apache-2.0
"""Images of maps for tests."""

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from PIL import Image

from edgectl.experiments.files.map_file import MapMetadata
from edgectl.experiments.ssim import MapImage

Rows = Sequence[Sequence[int]] | np.ndarray


def encode_pgm(rows: Rows) -> bytes:
    """A binary .pgm of 8 bits."""
    pixels = np.asarray(rows, dtype=np.uint8)
    return f"P5\n# CREATOR: a test\n{pixels.shape[1]} {pixels.shape[0]}\n255\n".encode() + pixels.tobytes()


def encode_png(image: Image.Image) -> bytes:
    """The image as a .png."""
    stream = BytesIO()
    image.save(stream, "PNG")
    return stream.getvalue()


def a_grey_image(rows: Rows) -> Image.Image:
    """An image of 8 bits."""
    return Image.fromarray(np.asarray(rows, dtype=np.uint8))


def draw_room(width: int = 24, height: int = 16) -> np.ndarray:
    """An asymmetric map: outer walls, an inner wall, an obstacle, an unknown corner."""
    cells = np.full((height, width), 254)
    cells[[0, -1], :] = cells[:, [0, -1]] = 0
    cells[: height // 2, width // 3] = 0
    cells[height - 5 : height - 3, 3:6] = 0
    cells[-4:, -5:] = 205
    return cells


def a_map_metadata(x: float = 0.0, y: float = 0.0, resolution: float = 0.5, **more: object) -> MapMetadata:
    """Metadata of a map at a position."""
    return MapMetadata(image="map.pgm", resolution=resolution, origin=(x, y), **more)  # type: ignore[arg-type]


def a_map_image(rows: Rows, lies: MapMetadata | None = None, name: str = "map.pgm") -> MapImage:
    """The rows as a .pgm, with or without metadata."""
    return MapImage(name=name, data=encode_pgm(rows), metadata=lies)
