# SPDX-License-Identifier: Apache-2.0
"""Files of results of a sweep: one for each world, named by its digest, so that none is computed twice."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from edgectl.errors import FileError
from edgectl.experiments.model.sweep import SweepWorld, WorldResult
from edgectl.formats.document import FormatErrors
from edgectl.formats.kinds import DocumentKind
from edgectl.state.json_files import Warn, read_json, set_aside, write_json

WORLD_KIND = DocumentKind(
    name="sweep-world", version=1, model=WorldResult, writer="edgectl simulate sweep SPEC --out DIR"
)
# Digits of a digest that name a file: no two of a billion worlds meet.
_NAME_DIGITS = 24


def select_worlds(worlds: Iterable[SweepWorld], shard: tuple[int, int] = (1, 1)) -> list[SweepWorld]:
    """The worlds of shard I of N, each digest once, in the order of the sweep."""
    each_once = list({world.digest: world for world in worlds}.values())
    return each_once[shard[0] - 1 :: shard[1]]


def load_results(
    worlds: Iterable[SweepWorld], directories: Sequence[Path], warn: Warn
) -> dict[str, WorldResult]:
    """The results that there are, by digest. A damaged file is set aside with a warning, to be made again.

    Raises:
        StateError: a newer edgectl wrote a file, or it cannot be read.
    """
    found: dict[str, WorldResult] = {}
    for world in worlds:
        for directory in directories:
            result = _load_result(_build_path(directory, world.digest), world.digest, warn)
            if result is not None:
                found[world.digest] = result
                break
    return found


def save_result(directory: Path, result: WorldResult) -> None:
    """Write the file of one world, atomically.

    Raises:
        StateError: the disk does not take it.
    """
    write_json(_build_path(directory, result.digest), WORLD_KIND.encode(result), keep=False)


def create_directory(directory: Path) -> None:
    """Create the directory of the results.

    Raises:
        FileError: it cannot be created.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"cannot create {directory}: {error.strerror}", hint="choose another directory: --out DIR"
        ) from error


def list_missing(worlds: Iterable[SweepWorld], results: Mapping[str, WorldResult]) -> list[SweepWorld]:
    """The worlds without a result."""
    return [world for world in worlds if world.digest not in results]


def _build_path(directory: Path, digest: str) -> Path:
    return directory / f"{digest[:_NAME_DIGITS]}.json"


def _load_result(path: Path, digest: str, warn: Warn) -> WorldResult | None:
    try:
        document = read_json(path)
        result = None if document is None else WORLD_KIND.decode(document)
        why = "" if result is None or result.digest == digest else "it holds another world"
    except FormatErrors as error:
        result, why = None, error.message
    except ValueError as error:
        result, why = None, str(error)
    if not why:
        return result
    warn(f"{path} is damaged ({why}); moved to {set_aside(path).name}, the world is simulated again")
    return None
