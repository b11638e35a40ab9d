# SPDX-License-Identifier: Apache-2.0
"""Packages of ROS on this machine: directories with a ``package.xml``, found by the package's name."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

_MAX_PACKAGE_DEPTH = 8
_MAX_DIRECTORIES = 50_000
_IGNORED_DIRECTORIES = {"build", "log", "node_modules", "__pycache__"}
_IGNORE_FILES = ("CATKIN_IGNORE", "COLCON_IGNORE", "AMENT_IGNORE")
_PACKAGE_NAME = re.compile(r"<name>\s*([\w.-]+)\s*</name>")


class PackageIndex:
    """Directories of packages below the given ones, found when the first is asked for."""

    def __init__(self, roots: Sequence[str]) -> None:
        self.roots = roots
        self.owners: dict[str, str] = {}
        self._found: dict[str, str] | None = None

    @property
    def directories(self) -> dict[str, str]:
        """Absolute directory of each package."""
        if self._found is None:
            self._found = {}
            for root in self.roots:
                for name, directory in _list_packages(Path(root)):
                    self._found.setdefault(name, directory)
        return {**self.owners, **self._found}

    def find(self, package: str) -> str | None:
        """The directory of a package, None if it is not here."""
        return self.directories.get(package)

    def find_owner(self, file: str) -> tuple[str, str] | None:
        """The package that holds ``file``, and the path of the file in there."""
        path = Path(os.path.abspath(file))  # noqa: PTH100 - links stay, and dots go
        for directory in path.parents:
            name = _read_package_name(directory)
            if name:
                self.owners[name] = str(directory)
                return name, str(path.relative_to(directory))
        return None


def _list_packages(root: Path) -> "list[tuple[str, str]]":
    found = []
    start = len(root.absolute().parts)
    for count, (where, inner, names) in enumerate(os.walk(root.absolute())):
        directory = Path(where)
        if count > _MAX_DIRECTORIES:
            break
        if any(name in names for name in _IGNORE_FILES):
            inner.clear()
            continue
        if "package.xml" in names and (name := _read_package_name(directory)):
            found.append((name, where))
            inner.clear()
        if len(directory.parts) - start >= _MAX_PACKAGE_DEPTH:
            inner.clear()
        inner[:] = sorted(
            each for each in inner if each not in _IGNORED_DIRECTORIES and not each.startswith(".")
        )
    return found


def _read_package_name(directory: Path) -> str:
    try:
        text = (directory / "package.xml").read_text(errors="replace")
    except OSError:
        return ""
    found = _PACKAGE_NAME.search(text)
    return found[1] if found else ""
