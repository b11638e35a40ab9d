"""Wait for the maps of all robots and merge them: map.pgm and map.yaml, as map_server writes them.

    python3 merger.py [--out out]

$EDGECTL_ROBOTS names the robots, $EDGECTL_ROBOT_HOSTS their addresses. The directory is relative to the home
directory (or the task's workdir), wherever the command was started. Metrics: ``maps`` received. Python
>= 3.8, standard library only.
"""

from __future__ import annotations

import argparse
import os
import sys
from array import array
from pathlib import Path

import grid
import wire
import world

EVERY_S = 0.5


def gather(robots: list[wire.Link]) -> list[array[int]]:
    """The final map of every robot, once all are there."""
    pace, found = wire.Pace(1 / EVERY_S), {}
    while len(found) < len(robots):
        for number, robot in enumerate(robots):
            if number not in found and (body := robot.ask("get", name="final")[1]):
                found[number] = array("b", body)
                wire.report(maps=len(found))
        pace.wait()
    return [found[number] for number in sorted(found)]


def main() -> int:
    """Run until the map is written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="the directory to write to, from the home directory"
    )
    args = parser.parse_args()
    target = Path.home() / args.out
    for old in ("map.pgm", "map.yaml"):
        if (target / old).exists():
            (target / old).unlink()
    names, addresses = (
        os.environ.get("EDGECTL_ROBOTS", "robot1").split(),
        os.environ.get("EDGECTL_ROBOT_HOSTS", "127.0.0.1").split(),
    )
    maps = gather([wire.Link(address, name) for name, address in zip(names, addresses)])
    world.write_map(target, "map", grid.picture(grid.merged(maps)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
