"""The follower of the patrol as a node of ROS 2: hears ``pose``, publishes ``cmd_vel``, at the end ``over``.

    python3 ros2_follower.py [--speed 1.5] [--scans 10] [--frames 12] [--tour 9]

Completed stops are kept by the robot (``keep``). Metrics as in follower.py. Python >= 3.8, rclpy and
std_msgs.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import Any

import follower
import ros2_topics as topics
import wire
from std_msgs.msg import String


class Tour:
    """Which stop comes next, and what was known when the robot came there."""

    def __init__(self, member: topics.Member, args: argparse.Namespace) -> None:
        self.member, self.board, self.args = member, topics.Board(member), args
        member.publisher("cmd_vel", String)
        member.publisher("over", String)
        self.wanted = {"scan": args.scans, "frame": args.frames}
        self.done = int(self.board.ask("get", name="stops")[1] or b"0")
        self.before: dict[str, int] = {}

    def go(self, message: String) -> None:
        """Answer a pose by a velocity."""
        state = json.loads(message.data)
        if state["over"]:
            self.member.leave()
        elif self.done >= len(goals := state["tour"][: self.args.tour]):
            self.member.publish("over", topics.say())
        else:
            forward, turn = self.steer(state, goals)
            self.member.publish("cmd_vel", topics.say(forward=forward, turn=turn))

    def steer(self, state: dict[str, Any], goals: list[list[float]]) -> tuple[float, float]:
        """Forward (m/s) and turn (rad/s); at a stop none, until so many scans and frames were taken there."""
        pose, goal, taken = state["pose"], goals[self.done], state["taken"]
        if not self.before:
            if math.hypot(goal[0] - pose[0], goal[1] - pose[1]) > follower.NEAR:
                return follower.steer(pose, goal, self.args.speed)
            self.before = taken
        if all(taken[name] - self.before[name] >= count for name, count in self.wanted.items()):
            self.done, self.before = self.done + 1, {}
            self.board.ask("put", b"%d" % self.done, name="stops")
            wire.report(stops=self.done, progress=self.done / len(goals))
        return 0.0, 0.0


def main() -> int:
    """Run until the tour is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--speed", type=float, default=1.5, help="m/s")
    parser.add_argument("--scans", type=int, default=follower.SCANS, help="scans to be taken at each stop")
    parser.add_argument("--frames", type=int, default=follower.FRAMES, help="frames to be taken at each stop")
    parser.add_argument("--tour", type=int, default=1000, help="maximum number of stops")
    args = parser.parse_args()
    member = topics.Member("follower")
    tour = Tour(member, args)
    member.hear("pose", String, tour.go)
    member.spin()
    tour.board.settle()
    member.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
