"""The mapping of the patrol as a node of ROS 2: hears ``laser``, publishes ``mapped``.

    python3 ros2_mapper.py

Grid and places are kept by the robot (``keep``), so that a mapper on another host continues with them.
Metrics as in mapper.py, without ``map_age_ms``. Ends with success at the end of the mission, and leaves the
map as ``final``. Python >= 3.8, rclpy and std_msgs.
"""

from __future__ import annotations

import sys
import time
from array import array

import mapper
import ros2_topics as topics
import wire
from std_msgs.msg import Header, UInt8MultiArray


class Mapping:
    """The map that grows with each scan."""

    def __init__(self, member: topics.Member) -> None:
        self.member, self.board = member, topics.Board(member)
        member.publisher("mapped", Header)
        self.known = mapper.begin(self.board)
        self.told = self.left = time.monotonic()
        self.scans, self.back, self.finished = 0, 0, False

    def learn(self, message: UInt8MultiArray) -> None:
        """Take in a scan, or leave at the end of the mission."""
        if self.member.over:
            return
        header, body = topics.unpack(message)
        if header["over"]:
            self.finished = True
            self.member.leave()
            return
        self.back += self.known.learn(header["pose"], array("H", body))
        self.member.publish("mapped", topics.give_result(header))
        self.scans, now = self.scans + 1, time.monotonic()
        if now - self.told >= mapper.EVERY_S:
            cells = self.known.cells
            wire.report(
                scans=self.scans / (now - self.told),
                known=1 - cells.count(0) / len(cells),
                places=len(self.known.places),
                back=self.back / self.scans,
            )
            self.told, self.scans, self.back = now, 0, 0
        if now - self.left >= mapper.LEAVE_EVERY_S:
            mapper.leave_map(self.board, self.known, "map")
            self.left = now


def main() -> int:
    """Run until the robot's mission is over."""
    member = topics.Member("mapper")
    made = Mapping(member)
    member.hear("laser", UInt8MultiArray, made.learn, topics.SENSOR)
    member.spin()
    mapper.leave_map(made.board, made.known, "final" if made.finished else "map")
    made.board.settle()
    member.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
