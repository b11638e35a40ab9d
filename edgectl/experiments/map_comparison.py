"""How like the truth a map is that a task has left. Importing this needs the extra ``evidence``."""

from collections.abc import Callable
from pathlib import Path, PurePosixPath

from edgectl.errors import FileError, UsageError
from edgectl.experiments import ssim
from edgectl.experiments.files.map_file import parse_map_metadata
from edgectl.experiments.ssim import MapImage

MAX_MAP_BYTES = 32 * 2**20


def compare_maps(file: str, fetch: Callable[[str], bytes], truth: Path) -> float:
    """SSIM of the map ``file``, read by ``fetch``, and ``truth`` on this computer. Either is an image, or a ``.yaml`` that names one.

    Raises:
        FileError: a file of this computer cannot be read, or is no image.
        InputError: what is wrong with a ``.yaml``.
        UsageError: the two cannot be compared, or are no maps by their names.
    """
    return ssim.compute_ssim(_load_map_image(file, fetch), _load_map_image(str(truth), read_local_file))


def check_truth_map(truth: Path) -> None:
    """See that a truth can be compared with at all, before anything is done for that.

    Raises:
        FileError, InputError, UsageError: as ``similarity`` does.
    """
    compare_maps(str(truth), read_local_file, truth)


def read_local_file(name: str) -> bytes:
    """A file of this computer.

    Raises:
        FileError: it cannot be read, or is too large.
    """
    try:
        with Path(name).open("rb") as stream:
            data = stream.read(MAX_MAP_BYTES + 1)
    except OSError as error:
        raise FileError(
            f"{name} cannot be read: {error.strerror}", hint="name a .yaml, .pgm or .png of a map"
        ) from None
    if len(data) > MAX_MAP_BYTES:
        raise FileError(
            f"{name} is larger than {MAX_MAP_BYTES // 2**20} MiB", hint="check that it is the right file"
        )
    return data


def _load_map_image(name: str, read: Callable[[str], bytes]) -> MapImage:
    suffix = PurePosixPath(name).suffix.lower()
    if suffix in (".yaml", ".yml"):
        sheet = parse_map_metadata(name, read(name))
        image = str(PurePosixPath(name).parent / sheet.image)
        return MapImage(name=image, data=read(image), metadata=sheet)
    if suffix not in (".pgm", ".png"):
        raise UsageError(
            f"{name} is no map by its name", hint="name the .yaml of a map, or its image: .pgm or .png"
        )
    return MapImage(name=name, data=read(name))
