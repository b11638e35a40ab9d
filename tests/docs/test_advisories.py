# SPDX-License-Identifier: Apache-2.0
"""No version that pyproject.toml admits has a hole that docs/dependencies.md lists."""

from tests.docs.advisories import list_open_holes, read_advisories, read_floors


def test_floors_are_above_known_holes() -> None:
    assert {"paramiko", "jinja2", "pillow", "cryptography"} <= read_advisories().keys()
    assert list_open_holes(read_floors()) == []


def test_a_floor_below_a_hole_is_found() -> None:
    lines = list_open_holes({**read_floors(), "jinja2": "3.1"})
    assert [line.split(" (")[0] for line in lines] == ["jinja2: floor 3.1 is below 3.1.6"]
