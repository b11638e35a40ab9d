# SPDX-License-Identifier: Apache-2.0
"""SSIM of map files, local or fetched from a host. Importing this module needs the extra ``evidence``."""

from collections.abc import Callable
from pathlib import Path, PurePosixPath

from edgectl.errors import FileError, UsageError
from edgectl.experiments import ssim
from edgectl.experiments.files.map_file import parse_map_metadata
from edgectl.experiments.ssim import MapImage

MAX_MAP_BYTES = 32 * 2**20


def compare_maps(file: str, fetch: Callable[[str], bytes], truth: Path) -> float:
    """SSIM (-1..1) of the map ``file``, read by ``fetch``, and the local file ``truth``.

    Each file is an image or a ``.yaml``.

    Raises:
        FileError: a local file is unreadable or not an image.
        InputError: all faults of a ``.yaml`` file.
        UsageError: the two cannot be compared, or a suffix is unknown.
    """
    return ssim.compute_ssim(_load_map_image(file, fetch), _load_map_image(str(truth), read_local_file))


def check_truth_map(truth: Path) -> None:
    """Check that ``truth`` is a usable ground truth.

    Raises:
        FileError, InputError, UsageError: as `compare_maps`.
    """
    compare_maps(str(truth), read_local_file, truth)


def read_local_file(name: str) -> bytes:
    """The bytes of a local file.

    Raises:
        FileError: it is unreadable or larger than `MAX_MAP_BYTES`.
    """
    try:
        with Path(name).open("rb") as stream:
            data = stream.read(MAX_MAP_BYTES + 1)
    except OSError as error:
        raise FileError(
            f"{name} cannot be read: {error.strerror}", hint="name a map file: .yaml, .pgm or .png"
        ) from None
    if len(data) > MAX_MAP_BYTES:
        raise FileError(
            f"{name} is larger than {MAX_MAP_BYTES // 2**20} MiB", hint="check that it is the right file"
        )
    return data


def _load_map_image(name: str, read: Callable[[str], bytes]) -> MapImage:
    suffix = PurePosixPath(name).suffix.lower()
    if suffix in (".yaml", ".yml"):
        metadata = parse_map_metadata(name, read(name))
        image = str(PurePosixPath(name).parent / metadata.image)
        return MapImage(name=image, data=read(image), metadata=metadata)
    if suffix not in (".pgm", ".png"):
        raise UsageError(
            f"{name} is not a map file", hint="name a map's .yaml file, or its image (.pgm or .png)"
        )
    return MapImage(name=name, data=read(name))
