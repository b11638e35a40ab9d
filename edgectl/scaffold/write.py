"""Write the scaffold."""

import json
import shlex
from importlib.resources import files
from pathlib import Path

_ANYWHERE = 'prelude: cd "$EDGECTL_DEMO"'
FILES = ("README.md", "inventories/local.yaml", "tasks/demo.yaml", "tasks/workload.py")


def write(directory: Path) -> dict[Path, bool]:
    """Write the files of the scaffold into ``directory``; for each whether it is new. A file that exists is never touched.

    Raises:
        OSError: a file or directory cannot be made.
    """
    source = files("edgectl.scaffold")
    return {directory / name: _placed(directory / name, _here(source.joinpath(name).read_text(), directory)) for name in FILES}


def _here(text: str, directory: Path) -> str:
    """The text with the place where the programs stand filled in."""
    return text.replace(_ANYWHERE, "prelude: " + json.dumps(f"cd {shlex.quote(str(directory.resolve()))}"))


def _placed(path: Path, content: str) -> bool:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(content)
    except FileExistsError:
        return False
    return True
