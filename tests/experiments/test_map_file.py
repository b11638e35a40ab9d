# SPDX-License-Identifier: Apache-2.0
"""Metadata files of maps: as written by ROS, and each fault with its position."""

import pytest

from edgectl.errors import InputError
from edgectl.experiments.files.map_file import MapMetadata, parse_map_metadata

ROS1 = """\
image: /home/robot/maps/world.pgm
resolution: 0.050000
origin: [-10.000000, -12.200000, 0.000000]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
ROS2 = """\
image: world.png
mode: trinary
resolution: 0.05
origin:
- -1.5
- 2.0e-1
- 0
negate: 1
occupied_thresh: 0.7
free_thresh: 0.25
"""


def test_what_ros_writes_is_read() -> None:
    assert parse_map_metadata("map.yaml", ROS1.encode()) == MapMetadata(
        image="/home/robot/maps/world.pgm", resolution=0.05, origin=(-10.0, -12.2)
    )
    assert parse_map_metadata("map.yaml", ROS2.encode()) == MapMetadata(
        image="world.png", resolution=0.05, origin=(-1.5, 0.2), negate=True, occupied=0.7, free=0.25
    )


def test_what_other_programs_add_is_their_business() -> None:
    more = "description: {of: lab, floors: [1, 2]}\nversion: 3\n"
    assert parse_map_metadata("map.yaml", (ROS1 + more).encode()) == parse_map_metadata(
        "map.yaml", ROS1.encode()
    )


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("image: /home/robot/maps/world.pgm\n", "", "1:1", "a map needs image"),
        ("resolution: 0.050000\n", "", "1:1", "a map needs resolution"),
        ("0.050000", "0", "2:13", "must be 0.001 to 1000 m"),
        ("0.050000", "fine", "2:13", "must be a number"),
        ("0.050000", ".nan", "2:13", "must be a number"),
        ("[-10.000000, -12.200000, 0.000000]", "[1.0]", "3:9", "must be x, y and yaw"),
        ("[-10.000000, -12.200000, 0.000000]", "here", "3:9", "must be a list"),
        ("-12.200000", "1e300", "3:22", "must be a number of at most"),
        ("-12.200000, 0.000000", "-12.2, 1.57", "3:9", "yaw"),
        ("negate: 0", "negate: 2", "4:9", "must be 0 or 1"),
        ("0.65", "1.65", "5:18", "must be 1 or less"),
        ("negate: 0", "negate: 0\nmode: scale", "5:7", "mode scale"),
        ("image: ", "image: [", "1:8", ""),
    ],
)
def test_each_mistake_has_its_place(old: str, new: str, place: str, words: str) -> None:
    assert old in ROS1
    with pytest.raises(InputError) as caught:
        parse_map_metadata("out/map.yaml", ROS1.replace(old, new, 1).encode())
    told = [
        (f"{problem.line}:{problem.column}", problem.message, problem.file)
        for problem in caught.value.problems
    ]
    assert any(at == place and words in message and file == "out/map.yaml" for at, message, file in told), (
        told
    )


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xfe", b"- a\n- b\n", b"just words", b"\0", b"a: &a [*a]", b"P5\n9 9\n255\n\x80\x80"]
)
def test_what_is_no_sheet_is_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        parse_map_metadata("map.yaml", data)


def test_a_file_that_no_map_has_is_refused_before_it_is_parsed() -> None:
    with pytest.raises(InputError, match="larger than 1 MiB"):
        parse_map_metadata("map.yaml", ROS1.encode() + b"# x\n" * 300_000)
