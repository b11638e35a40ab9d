"""The example fleet that ``init`` writes."""

import json
import shlex
from importlib.resources import files
from pathlib import Path

_DIRECTORY_PLACEHOLDER = b'prelude: cd "$EDGECTL_DEMO"'
_PROGRAMS = ("detection", "follower", "grid", "mapper", "merger", "robot", "wire", "world")
MISSION_FILES = (
    "experiment.yaml",
    "fleet.yaml",
    "tasks.yaml",
    "world.pgm",
    "world.yaml",
    *(f"{name}.py" for name in _PROGRAMS),
)
SCAFFOLD_FILES = (
    "README.md",
    "inventories/local.yaml",
    "tasks/demo.yaml",
    "tasks/workload.py",
    *(f"tasks/mission/{name}" for name in MISSION_FILES),
)


def write_scaffold(directory: Path) -> dict[Path, bool]:
    """Write the example files into ``directory``; each path with whether it is new. Existing files are kept.

    Raises:
        OSError: a file or directory cannot be made.
    """
    source = files("edgectl.scaffold")
    return {
        directory / name: _write_new_file(
            directory / name, _fill_in_directory(source.joinpath(name).read_bytes(), directory)
        )
        for name in SCAFFOLD_FILES
    }


def _fill_in_directory(content: bytes, directory: Path) -> bytes:
    """The content with the programs' directory filled in."""
    return content.replace(
        _DIRECTORY_PLACEHOLDER,
        b"prelude: " + json.dumps(f"cd {shlex.quote(str(directory.resolve()))}").encode(),
    )


def _write_new_file(path: Path, content: bytes) -> bool:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("xb") as file:
            file.write(content)
    except FileExistsError:
        return False
    return True
