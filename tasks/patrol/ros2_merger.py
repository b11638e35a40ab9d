"""The merging of the patrol as a node of ROS 2: hears ``kept/final`` of all robots, writes map.pgm, map.yaml.

    python3 ros2_merger.py [--out out]

$EDGECTL_ROBOTS names the robots. The directory is relative to the home directory, wherever the command was
started. Metrics: ``maps`` received. Python >= 3.8, rclpy and std_msgs.
"""

from __future__ import annotations

import argparse
import os
import sys
from array import array
from pathlib import Path

import grid
import ros2_topics as topics
import wire
import world
from std_msgs.msg import UInt8MultiArray


class Gathering:
    """The final map of every robot, by its name."""

    def __init__(self) -> None:
        self.found: dict[str, array[int]] = {}

    def take(self, robot: str, message: UInt8MultiArray) -> None:
        """Take in a map; before the end of its mission a robot has none."""
        body = topics.unpack(message)[1]
        if body:
            self.found[robot] = array("b", body)
            wire.report(maps=len(self.found))


def main() -> int:
    """Run until the map is written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="the directory to write to, from the home directory"
    )
    target, names = (
        Path.home() / parser.parse_args().out,
        os.environ.get("EDGECTL_ROBOTS", "robot1").split(),
    )
    for old in ("map.pgm", "map.yaml"):
        if (target / old).exists():
            (target / old).unlink()
    member, gathered = topics.Member("merger", "patrol"), Gathering()
    for name in names:
        member.hear(
            f"/{name}/kept/final",
            UInt8MultiArray,
            lambda message, name=name: gathered.take(name, message),
            topics.LATCHED,
        )
    member.spin(lambda: len(gathered.found) == len(names))
    if len(gathered.found) == len(names):
        maps = [gathered.found[name] for name in sorted(gathered.found)]
        world.write_map(target, "map", grid.picture(grid.merged(maps)))
    member.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
