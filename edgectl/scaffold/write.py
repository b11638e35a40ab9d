# SPDX-License-Identifier: Apache-2.0
"""The example fleet that ``init`` writes."""

import json
import re
import secrets
import shlex
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

_DIRECTORY_PLACEHOLDER = b'prelude: cd "$EDGECTL_DEMO"'
_FLEET_PLACEHOLDER = re.compile(rb"^fleet: (\w+)$", re.MULTILINE)
_PROGRAMS = ("detection", "follower", "grid", "mapper", "merger", "radio", "robot", "wire", "world")
_NODES = ("detection", "follower", "mapper", "merger", "robot", "topics")
MISSION_FILES = (
    "experiment.yaml",
    "fleet.yaml",
    "ros2.yaml",
    "tasks.yaml",
    "world.pgm",
    "world.yaml",
    *(f"{name}.py" for name in _PROGRAMS),
    *(f"ros2_{name}.py" for name in _NODES),
)
SCAFFOLD_FILES = (
    "README.md",
    "edgectl.yaml",
    "inventories/local.yaml",
    "tasks/demo.yaml",
    "tasks/workload.py",
    *(f"tasks/patrol/{name}" for name in MISSION_FILES),
)


# Files that a user edits -> the kind of their schema.
_KINDS = {
    "edgectl.yaml": "project",
    "inventories/local.yaml": "inventory",
    "tasks/demo.yaml": "tasks",
    "tasks/patrol/fleet.yaml": "inventory",
    "tasks/patrol/tasks.yaml": "tasks",
    "tasks/patrol/ros2.yaml": "tasks",
    "tasks/patrol/experiment.yaml": "experiment",
}
SCHEMAS_DIR = ".edgectl/schemas"
NO_SCHEMAS: Mapping[str, str] = {}


def write_scaffold(directory: Path, schemas: Mapping[str, str] = NO_SCHEMAS) -> dict[Path, bool]:
    """Write the example files into ``directory``; each path with whether it is new. Existing files are kept.

    ``schemas``: the text of each JSON Schema by kind. They stand in ``.edgectl/schemas``, and the YAML files
    name them for editors.

    Raises:
        OSError: a file or directory cannot be made.
    """
    source = files("edgectl.scaffold")
    contents = {
        name: _name_fleet(_fill_in_directory(source.joinpath(name).read_bytes(), directory))
        for name in SCAFFOLD_FILES
    }
    for name, kind in _KINDS.items():
        if kind not in schemas:
            continue
        contents[name] = _build_schema_line(name, kind) + contents[name]
    contents |= {f"{SCHEMAS_DIR}/{kind}.json": text.encode() for kind, text in schemas.items()}
    return {
        directory / name: _write_new_file(directory / name, content) for name, content in contents.items()
    }


def _build_schema_line(name: str, kind: str) -> bytes:
    """The first line of a YAML file, by which editors find its schema."""
    return f"# yaml-language-server: $schema={'../' * name.count('/')}{SCHEMAS_DIR}/{kind}.json\n".encode()


def _fill_in_directory(content: bytes, directory: Path) -> bytes:
    """The content with the programs' directory filled in."""
    return content.replace(
        _DIRECTORY_PLACEHOLDER,
        b"prelude: " + json.dumps(f"cd {shlex.quote(str(directory.resolve()))}").encode(),
    )


def _name_fleet(content: bytes) -> bytes:
    """The content with a fleet of its own: nobody else on the same hosts has its name."""
    return _FLEET_PLACEHOLDER.sub(rb"fleet: \1-%s" % secrets.token_hex(3).encode(), content)


def _write_new_file(path: Path, content: bytes) -> bool:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("xb") as file:
            file.write(content)
    except FileExistsError:
        return False
    return True
