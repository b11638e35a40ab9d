"""How like the truth a map is that a task has left. Importing this needs the extra ``evidence``."""

from collections.abc import Callable
from pathlib import Path, PurePosixPath

from edgectl.config.maps import read_map
from edgectl.errors import FileError, UsageError
from edgectl.evidence import ssim
from edgectl.evidence.ssim import Picture

MAX_BYTES = 32 * 2**20


def similarity(file: str, fetch: Callable[[str], bytes], truth: Path) -> float:
    """SSIM of the map ``file``, read by ``fetch``, and ``truth`` on this computer. Either is an image, or a ``.yaml`` that names one.

    Raises:
        FileError: a file of this computer cannot be read, or is no image.
        InputError: what is wrong with a ``.yaml``.
        UsageError: the two cannot be compared, or are no maps by their names.
    """
    return ssim.similarity(_picture(file, fetch), _picture(str(truth), local))


def check(truth: Path) -> None:
    """See that a truth can be compared with at all, before anything is done for that.

    Raises:
        FileError, InputError, UsageError: as ``similarity`` does.
    """
    similarity(str(truth), local, truth)


def local(name: str) -> bytes:
    """A file of this computer.

    Raises:
        FileError: it cannot be read, or is too large.
    """
    try:
        with Path(name).open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise FileError(f"{name} cannot be read: {error.strerror}", hint="name a .yaml, .pgm or .png of a map") from None
    if len(data) > MAX_BYTES:
        raise FileError(f"{name} is larger than {MAX_BYTES // 2**20} MiB", hint="check that it is the right file")
    return data


def _picture(name: str, read: Callable[[str], bytes]) -> Picture:
    suffix = PurePosixPath(name).suffix.lower()
    if suffix in (".yaml", ".yml"):
        sheet = read_map(name, read(name))
        image = str(PurePosixPath(name).parent / sheet.image)
        return Picture(name=image, data=read(image), sheet=sheet)
    if suffix not in (".pgm", ".png"):
        raise UsageError(f"{name} is no map by its name", hint="name the .yaml of a map, or its image: .pgm or .png")
    return Picture(name=name, data=read(name))
