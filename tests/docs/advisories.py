# SPDX-License-Identifier: Apache-2.0
"""The list of known holes in docs/dependencies.md, against the floors of pyproject.toml and what is installed.

``python -m tests.docs.advisories`` prints the comparison; ``make audit`` does where the public advisories cannot be
reached.
"""

import re
import sys
import tomllib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

from tests.views.fixtures import ROOT

PAGE = ROOT / "docs" / "dependencies.md"
_ROW = re.compile(r"^\| (\S+) \| ([0-9.]+) \| (.+?) \| (\d{4}-\d\d-\d\d) \|$", re.MULTILINE)
Advisory = tuple[str, str, str]


def read_advisories() -> dict[str, Advisory]:
    """Package -> first version without the holes, the holes, and the date of the look-up."""
    return {name: (safe, holes, day) for name, safe, holes, day in _ROW.findall(PAGE.read_text())}


def read_floors() -> dict[str, str]:
    """Package -> lowest version that pyproject.toml admits."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = sum(project["optional-dependencies"].values(), project["dependencies"])
    found = (re.match(r"([\w-]+)>=([0-9.]+)", each) for each in declared)
    return {each[1]: each[2] for each in found if each}


def as_numbers(text: str) -> tuple[int, ...]:
    """A version, to be compared; words at its end do not count. Zeros at its end neither."""
    numbers = [int(part) for part in re.findall(r"\d+", text)]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)


def list_open_holes(floors: Mapping[str, str]) -> list[str]:
    """One line for each package whose floor, or installed version, is below the first safe one."""
    lines = []
    for name, (safe, holes, _) in read_advisories().items():
        try:
            installed = version(name)
        except PackageNotFoundError:
            installed = safe
        for what, found in (("floor", floors.get(name, "0")), ("installed", installed)):
            if as_numbers(found) < as_numbers(safe):
                lines.append(f"{name}: {what} {found} is below {safe} ({holes})")
    return lines


if __name__ == "__main__":
    for package, (safe_version, _, date) in read_advisories().items():
        print(f"{package} >= {safe_version}, as known on {date}")
    open_holes = list_open_holes(read_floors())
    print("\n".join(open_holes) or "no known hole")
    sys.exit(bool(open_holes))
