"""Map what a robot's laser sees: an occupancy grid, kept on the robot's blackboard so that a mapper on
another host continues with it.

    python3 mapper.py [--rate 8]

Metrics: ``scans`` per second, ``known`` share of the cells that are known. Ends with success when the robot
reports the end of its mission, and leaves the whole map there as ``final``. Python >= 3.8, standard library
only.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from array import array

import grid
import wire

REACH = 3.5
EVERY_S = 1.0
LEAVE_EVERY_S = 2.0


class Leave:
    """Whether it was told to end."""

    now = False

    def tell(self, *_signal: object) -> None:
        """Leave after this scan."""
        self.now = True


def begin(robot: wire.Link) -> array[int]:
    """The map that is there already, or an empty one."""
    kept = robot.ask("get", name="map")[1]
    cells = grid.empty()
    if len(kept) == len(cells):
        cells = array("b", kept)
    return cells


def work(robot: wire.Link, cells: array[int], rate: float, leave: Leave) -> bool:
    """Map until the mission is over (True), or until told to leave."""
    pace, done, scans = wire.Pace(rate), False, 0
    told = left = time.monotonic()
    while not leave.now:
        header, body = robot.ask("scan", done=done)
        if header["over"]:
            return True
        scan = array("H", body)
        pose = grid.fit(cells, header["pose"], scan)
        grid.learn(cells, pose, scan, REACH)
        scans, done, now = scans + 1, True, time.monotonic()
        if now - told >= EVERY_S:
            wire.report(scans=scans / (now - told), known=1 - cells.count(0) / len(cells))
            told, scans = now, 0
        if now - left >= LEAVE_EVERY_S:
            robot.ask("put", cells.tobytes(), name="map")
            left = now
        pace.wait()
    return False


def main() -> int:
    """Run until the robot's mission is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=8.0, help="at most so many scans per second")
    args, leave = parser.parse_args(), Leave()
    signal.signal(signal.SIGTERM, leave.tell)
    robot = wire.own_robot()
    cells = begin(robot)
    over = work(robot, cells, args.rate, leave)
    robot.ask("put", cells.tobytes(), name="final" if over else "map")
    return 0


if __name__ == "__main__":
    sys.exit(main())
