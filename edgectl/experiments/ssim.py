"""How like the truth a map is: the structural similarity (SSIM) of two images. Bytes in, one number out."""

import struct
import warnings
from dataclasses import dataclass
from io import BytesIO
from typing import Any, TypeAlias

import numpy as np
from PIL import Image
from skimage.metrics import structural_similarity

from edgectl.errors import FileError, UsageError
from edgectl.experiments.files.map_file import MapMetadata

Pixels: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[Any]]
# As map_saver writes them.
_OCCUPIED, _UNKNOWN, _FREE = 0.0, 205.0, 254.0
_WHITE = 255.0
_WINDOW_PIXELS = 7
_MAX_PIXELS = 2**24
_STRIP_PIXELS = 2**20
_ssim: Any = structural_similarity  # has no types
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
    """An image under the ``name`` by which it is spoken of; with its ``sheet`` it is a map that has its place in the world."""

    name: str
    data: bytes
    metadata: MapMetadata | None = None


def compute_ssim(produced: MapImage, truth: MapImage) -> float:
    """The mean SSIM, -1..1, over windows of 7 x 7 pixels. Two maps with sheets are compared cell by cell on the grid of ``truth``.

    Raises:
        FileError: an image cannot be read.
        UsageError: sizes differ, the maps do not overlap, or there is less than a window.
    """
    one, other = _decode_map_pixels(produced), _decode_map_pixels(truth)
    if produced.metadata and truth.metadata:
        laid = _resample_to_grid(one, produced.metadata, truth.metadata, other.shape)
        if laid is None:
            raise UsageError(
                f"{produced.name} and {truth.name} do not overlap",
                hint="check origin and resolution of both .yaml files",
            )
        one = laid
    elif one.shape != other.shape:
        hint = "compare the .yaml of both maps, which say where they lie, or images of one size"
        raise UsageError(
            f"{produced.name} has {_format_pixel_size(one)} pixels, {truth.name} {_format_pixel_size(other)}",
            hint=hint,
        )
    if min(other.shape) < _WINDOW_PIXELS:
        raise UsageError(
            f"{truth.name} has {_format_pixel_size(other)} pixels, too few to compare",
            hint=f"SSIM looks at windows of {_WINDOW_PIXELS}x{_WINDOW_PIXELS}",
        )
    return _compute_mean_ssim(one, other)


def _compute_mean_ssim(one: Pixels, other: Pixels) -> float:
    """Over all windows, a strip of rows at a time: scikit-image takes some 130 bytes for each pixel."""
    rows = one.shape[0] - _WINDOW_PIXELS + 1
    step, total = max(1, _STRIP_PIXELS // one.shape[1]), 0.0
    for top in range(0, rows, step):
        count = min(step, rows - top)
        part = slice(top, top + count + _WINDOW_PIXELS - 1)
        total += count * float(
            _ssim(
                one[part].astype(float), other[part].astype(float), win_size=_WINDOW_PIXELS, data_range=_WHITE
            )
        )
    return total / rows


def _format_pixel_size(pixels: Pixels) -> str:
    return f"{pixels.shape[1]}x{pixels.shape[0]}"


def _decode_map_pixels(picture: MapImage) -> Pixels:
    """Greys from 0 to 255; of a map with a sheet what they mean: occupied, unknown or free."""
    grey, sheet = _decode_grey_pixels(picture), picture.metadata
    if sheet is None:
        return grey
    occupancy = (grey if sheet.negate else _WHITE - grey) / _WHITE
    cells: Pixels = np.full(grey.shape, _UNKNOWN, dtype=np.float32)
    cells[occupancy < sheet.free] = _FREE
    cells[occupancy > sheet.occupied] = _OCCUPIED
    return cells


def _decode_grey_pixels(picture: MapImage) -> Pixels:
    hint = "name a .pgm or .png as map_saver writes them"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # whatever a decoder thinks of the file, we say it
            with Image.open(BytesIO(picture.data), formats=("PNG", "PPM")) as image:
                if image.width * image.height > _MAX_PIXELS:
                    raise FileError(
                        f"{picture.name} has {image.width}x{image.height} pixels, too many to compare",
                        hint="scale it down",
                    )
                return _to_grey_pixels(image)
    except _DECODE_ERRORS as error:
        raise FileError(f"{picture.name} is no image that can be read", hint=hint) from error


def _to_grey_pixels(image: Image.Image) -> Pixels:
    """Brightness from 0 to 255. Colours by their luminance; how transparent a pixel is makes no difference."""
    if image.mode.startswith("I"):  # 16 bits
        return np.asarray(image, dtype=np.float32) * np.float32(_WHITE / 65535)
    flat = image.convert("RGBA") if image.mode == "P" else image
    return np.asarray(flat.convert("L"), dtype=np.float32)


def _resample_to_grid(
    cells: Pixels, sheet: MapMetadata, grid: MapMetadata, shape: tuple[int, ...]
) -> Pixels | None:
    """The cells that lie under the centres of the grid's; unknown where there are none. None if that is everywhere."""
    height, width = cells.shape
    columns = _compute_cell_indices(
        np.arange(shape[1]), grid.resolution, grid.origin[0] - sheet.origin[0], sheet.resolution
    )
    rows = (
        height
        - 1
        - _compute_cell_indices(
            np.arange(shape[0])[::-1], grid.resolution, grid.origin[1] - sheet.origin[1], sheet.resolution
        )
    )
    x, y = (columns >= 0) & (columns < width), (rows >= 0) & (rows < height)
    if not (x.any() and y.any()):
        return None
    laid: Pixels = np.full(shape, _UNKNOWN, dtype=np.float32)
    laid[np.ix_(y, x)] = cells[np.ix_(rows[y].astype(int), columns[x].astype(int))]
    return laid


def _compute_cell_indices(numbers: Pixels, side: float, offset: float, other_side: float) -> Pixels:
    """Numbers of the other map's cells under the centres of these, along one axis; centres on a border belong to the farther cell."""
    return np.floor(((numbers + 0.5) * side + offset) / other_side + 1e-6)
