"""Map what a robot's laser sees: an occupancy grid, and a scan of each place, with which every new scan is
compared to see that the robot is back there. So the work grows with the way.

    python3 mapper.py [--rate 5]

Grid and places are kept on the robot's blackboard, so that a mapper on another host continues with them.
Metrics: ``scans`` per second, ``places`` known, ``back`` share of the scans that are of a known place,
``map_age_ms`` of each scan when the robot has its result, ``known`` share of the cells that are known. Ends
with success when the robot reports the end of its mission, and leaves the whole map there as ``final``.
Python >= 3.8, standard library only.
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
PLACE_EVERY, BEAMS, ALIKE_MM = 30, 90, 60


class Leave:
    """Whether it was told to end."""

    now = False

    def tell(self, *_signal: object) -> None:
        """Leave after this scan."""
        self.now = True


class Map:
    """What a mapper knows: the grid, a scan of each place (of `BEAMS` beams), and the number of all scans."""

    def __init__(self, cells: array[int], places: list[array[int]]) -> None:
        self.cells, self.places, self.scans = cells, places, 0

    def learn(self, pose: list[float], scan: array[int]) -> bool:
        """Take in one scan; whether it is of a known place."""
        thin = scan[:: len(scan) // BEAMS]
        back = min([differ(thin, place) for place in self.places], default=ALIKE_MM) < ALIKE_MM
        grid.learn(self.cells, grid.fit(self.cells, pose, scan), scan, REACH)
        if self.scans % PLACE_EVERY == 0:
            self.places.append(thin)
        self.scans += 1
        return back


def differ(scan: array[int], place: array[int]) -> float:
    """How much two scans differ in the mean (mm per beam), whatever the direction of the robot was."""
    twice, beams = place + place, len(scan)
    return min(sum(abs(a - b) for a, b in zip(scan, twice[turn:])) for turn in range(beams)) / beams


def begin(robot: wire.Link) -> Map:
    """The map that is there already, or an empty one."""
    kept = robot.ask("get", name="map")[1]
    cells = grid.empty()
    if len(kept) == len(cells):
        cells = array("b", kept)
    beams = array("H", robot.ask("get", name="places")[1])
    return Map(cells, [beams[first : first + BEAMS] for first in range(0, len(beams), BEAMS)])


def leave_map(robot: wire.Link, known: Map, name: str) -> None:
    """Leave grid and places on the robot's blackboard."""
    robot.ask("put", b"".join(place.tobytes() for place in known.places), name="places")
    robot.ask("put", known.cells.tobytes(), name=name)


def work(robot: wire.Link, known: Map, rate: float, leave: Leave) -> bool:
    """Map until the mission is over (True), or until told to leave."""
    pace, scans, back = wire.Pace(rate), 0, 0
    told = left = time.monotonic()
    while not leave.now:
        header, body = robot.ask("scan")
        if header["over"]:
            return True
        back += known.learn(header["pose"], array("H", body))
        wire.count(map_age_ms=wire.give_result(robot, "scan", header["number"]))
        scans, now = scans + 1, time.monotonic()
        if now - told >= EVERY_S:
            share = 1 - known.cells.count(0) / len(known.cells)
            wire.report(scans=scans / (now - told), known=share, places=len(known.places), back=back / scans)
            told, scans, back = now, 0, 0
        if now - left >= LEAVE_EVERY_S:
            leave_map(robot, known, "map")
            left = now
        pace.wait()
    return False


def main() -> int:
    """Run until the robot's mission is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=5.0, help="scans per second at most")
    args, leave = parser.parse_args(), Leave()
    signal.signal(signal.SIGTERM, leave.tell)
    robot = wire.own_robot()
    known = begin(robot)
    over = work(robot, known, args.rate, leave)
    leave_map(robot, known, "final" if over else "map")
    return 0


if __name__ == "__main__":
    sys.exit(main())
