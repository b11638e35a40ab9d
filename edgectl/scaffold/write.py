"""Write the scaffold."""

import json
import shlex
from importlib.resources import files
from pathlib import Path

_ANYWHERE = b'prelude: cd "$EDGECTL_DEMO"'
_PROGRAMS = ("detection", "follower", "grid", "mapper", "merger", "robot", "wire", "world")
MISSION = ("experiment.yaml", "fleet.yaml", "tasks.yaml", "world.pgm", "world.yaml", *(f"{name}.py" for name in _PROGRAMS))
FILES = ("README.md", "inventories/local.yaml", "tasks/demo.yaml", "tasks/workload.py", *(f"tasks/mission/{name}" for name in MISSION))


def write(directory: Path) -> dict[Path, bool]:
    """Write the files of the scaffold into ``directory``; for each whether it is new. A file that exists is never touched.

    Raises:
        OSError: a file or directory cannot be made.
    """
    source = files("edgectl.scaffold")
    return {directory / name: _placed(directory / name, _here(source.joinpath(name).read_bytes(), directory)) for name in FILES}


def _here(content: bytes, directory: Path) -> bytes:
    """The content with the place where the programs stand filled in."""
    return content.replace(_ANYWHERE, b"prelude: " + json.dumps(f"cd {shlex.quote(str(directory.resolve()))}").encode())


def _placed(path: Path, content: bytes) -> bool:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("xb") as file:
            file.write(content)
    except FileExistsError:
        return False
    return True
