"""Drive a robot along its tour; it leaves each stop only after its sensors there were read often enough.

    python3 follower.py [--speed 1.5] [--scans 10] [--frames 12] [--tour 9]

Completed stops are kept on the robot's blackboard, so that a follower on another host continues with the
next. At the end it declares the mission over. Metrics: ``stops`` completed, ``progress``: their share of the
tour. Python >= 3.8, standard library only.
"""

from __future__ import annotations

import argparse
import math
import sys

import wire

RATE = 10.0
SCANS, FRAMES = 10, 12
NEAR = 0.08
FASTEST_TURN = 5.0


def steer(pose: list[float], goal: list[float], speed: float) -> tuple[float, float]:
    """Forward (m/s) and turn (rad/s) towards the goal; it turns first, and slows down before the goal."""
    ahead, aside = goal[0] - pose[0], goal[1] - pose[1]
    off = math.remainder(math.atan2(aside, ahead) - pose[2], 2 * math.pi)
    turn = max(-FASTEST_TURN, min(FASTEST_TURN, 5.0 * off))
    return (min(speed, 3.0 * math.hypot(ahead, aside)) if abs(off) < 0.4 else 0.0), turn


def drive(robot: wire.Link, goal: list[float], pace: wire.Pace, speed: float) -> None:
    """Until the robot is there."""
    pose = robot.ask("pose")[0]["pose"]
    while math.hypot(goal[0] - pose[0], goal[1] - pose[1]) > NEAR:
        forward, turn = steer(pose, goal, speed)
        pose = robot.ask("drive", forward=forward, turn=turn)[0]["pose"]
        pace.wait()
    robot.ask("drive", forward=0.0, turn=0.0)


def look(robot: wire.Link, pace: wire.Pace, wanted: dict[str, int]) -> None:
    """Until so many scans and frames were taken here."""
    before = robot.ask("pose")[0]["taken"]
    taken = before
    while any(taken[name] - before[name] < count for name, count in wanted.items()):
        pace.wait()
        taken = robot.ask("pose")[0]["taken"]


def main() -> int:
    """Run until the tour is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--speed", type=float, default=1.5, help="m/s")
    parser.add_argument("--scans", type=int, default=SCANS, help="scans to be taken at each stop")
    parser.add_argument("--frames", type=int, default=FRAMES, help="frames to be taken at each stop")
    parser.add_argument("--tour", type=int, default=1000, help="maximum number of stops")
    args = parser.parse_args()
    robot, pace = wire.own_robot(), wire.Pace(RATE)
    tour = robot.ask("tour")[0]["tour"][: args.tour]
    done = int(robot.ask("get", name="stops")[1] or b"0")
    for number, goal in enumerate(tour[done:], start=done + 1):
        drive(robot, goal, pace, args.speed)
        look(robot, pace, {"scan": args.scans, "frame": args.frames})
        robot.ask("put", b"%d" % number, name="stops")
        wire.report(stops=number, progress=number / len(tour))
    robot.ask("over")
    return 0


if __name__ == "__main__":
    sys.exit(main())
