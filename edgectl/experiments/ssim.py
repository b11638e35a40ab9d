# SPDX-License-Identifier: Apache-2.0
"""Structural similarity (SSIM) of two maps, given as bytes."""

import struct
import warnings
from dataclasses import dataclass
from io import BytesIO
from typing import Any, TypeAlias

import numpy as np
from PIL import Image

from edgectl.errors import FileError, UsageError
from edgectl.experiments.files.map_file import MapMetadata

Pixels: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[Any]]
# Grey values that map_saver writes.
_OCCUPIED, _UNKNOWN, _FREE = 0.0, 205.0, 254.0
_WHITE = 255.0
_WINDOW_PIXELS = 7
_MAX_PIXELS = 2**24
_STRIP_PIXELS = 2**20
_DECODE_ERRORS = (
    OSError,
    SyntaxError,
    ValueError,
    EOFError,
    struct.error,
    OverflowError,
    Image.DecompressionBombError,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapImage:
    """An image file; with ``metadata`` it is a map with a position. ``name``: for messages."""

    name: str
    data: bytes
    metadata: MapMetadata | None = None


def compute_ssim(produced: MapImage, truth: MapImage) -> float:
    """The mean SSIM, -1..1, over windows of 7 x 7 pixels.

    Two maps with metadata are compared on the grid of ``truth``.

    Raises:
        FileError: an image cannot be read.
        UsageError: sizes differ, the maps do not overlap, or they are smaller than a window.
    """
    one, other = _decode_map_pixels(produced), _decode_map_pixels(truth)
    if produced.metadata and truth.metadata:
        resampled = _resample_to_grid(one, produced.metadata, truth.metadata, other.shape)
        if resampled is None:
            raise UsageError(
                f"{produced.name} and {truth.name} do not overlap",
                hint="check origin and resolution of both .yaml files",
            )
        one = resampled
    elif one.shape != other.shape:
        hint = "compare the .yaml files of both maps, which state their positions, or images of the same size"
        raise UsageError(
            f"{produced.name} has {_format_pixel_size(one)} pixels, {truth.name} {_format_pixel_size(other)}",
            hint=hint,
        )
    if min(other.shape) < _WINDOW_PIXELS:
        raise UsageError(
            f"{truth.name} has {_format_pixel_size(other)} pixels, too few to compare",
            hint=f"SSIM needs at least {_WINDOW_PIXELS}x{_WINDOW_PIXELS} pixels",
        )
    return _compute_mean_ssim(one, other)


def _compute_mean_ssim(one: Pixels, other: Pixels) -> float:
    """The mean over all windows, computed in strips of rows: scikit-image takes some 130 bytes per pixel."""
    # Its import takes half a second, most of which is scipy's.
    from skimage.metrics import structural_similarity

    untyped: Any = structural_similarity
    rows = one.shape[0] - _WINDOW_PIXELS + 1
    step, total = max(1, _STRIP_PIXELS // one.shape[1]), 0.0
    for top in range(0, rows, step):
        count = min(step, rows - top)
        part = slice(top, top + count + _WINDOW_PIXELS - 1)
        total += count * float(
            untyped(
                one[part].astype(float), other[part].astype(float), win_size=_WINDOW_PIXELS, data_range=_WHITE
            )
        )
    return total / rows


def _format_pixel_size(pixels: Pixels) -> str:
    return f"{pixels.shape[1]}x{pixels.shape[0]}"


def _decode_map_pixels(image_file: MapImage) -> Pixels:
    """Grey values 0..255; with metadata, the values of occupied, unknown and free cells."""
    grey, metadata = _decode_grey_pixels(image_file), image_file.metadata
    if metadata is None:
        return grey
    occupancy = (grey if metadata.negate else _WHITE - grey) / _WHITE
    cells: Pixels = np.full(grey.shape, _UNKNOWN, dtype=np.float32)
    cells[occupancy < metadata.free] = _FREE
    cells[occupancy > metadata.occupied] = _OCCUPIED
    return cells


def _decode_grey_pixels(image_file: MapImage) -> Pixels:
    hint = "name a .pgm or .png file as written by map_saver"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a decoder's warning is reported as our error
            with Image.open(BytesIO(image_file.data), formats=("PNG", "PPM")) as image:
                if image.width * image.height > _MAX_PIXELS:
                    raise FileError(
                        f"{image_file.name} has {image.width}x{image.height} pixels, too many to compare",
                        hint="scale it down",
                    )
                return _to_grey_pixels(image)
    except _DECODE_ERRORS as error:
        raise FileError(f"{image_file.name} is not a readable image", hint=hint) from error


def _to_grey_pixels(image: Image.Image) -> Pixels:
    """Brightness 0..255: the luminance of colours; transparency is ignored."""
    if image.mode.startswith("I"):  # 16 bits
        return np.asarray(image, dtype=np.float32) * np.float32(_WHITE / 65535)
    flat = image.convert("RGBA") if image.mode == "P" else image
    return np.asarray(flat.convert("L"), dtype=np.float32)


def _resample_to_grid(
    cells: Pixels, metadata: MapMetadata, grid: MapMetadata, shape: tuple[int, ...]
) -> Pixels | None:
    """The cells of a map at the cell centres of ``grid``, unknown outside of it; None without overlap."""
    height, width = cells.shape
    columns = _compute_cell_indices(
        np.arange(shape[1]), grid.resolution, grid.origin[0] - metadata.origin[0], metadata.resolution
    )
    rows = (
        height
        - 1
        - _compute_cell_indices(
            np.arange(shape[0])[::-1],
            grid.resolution,
            grid.origin[1] - metadata.origin[1],
            metadata.resolution,
        )
    )
    x, y = (columns >= 0) & (columns < width), (rows >= 0) & (rows < height)
    if not (x.any() and y.any()):
        return None
    resampled: Pixels = np.full(shape, _UNKNOWN, dtype=np.float32)
    resampled[np.ix_(y, x)] = cells[np.ix_(rows[y].astype(int), columns[x].astype(int))]
    return resampled


def _compute_cell_indices(numbers: Pixels, side: float, offset: float, other_side: float) -> Pixels:
    """Indices of the other map's cells at these cell centres, along one axis; on a border, the higher one."""
    return np.floor(((numbers + 0.5) * side + offset) / other_side + 1e-6)
