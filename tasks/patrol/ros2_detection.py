"""The detection of the patrol as a node of ROS 2: hears ``camera``, publishes ``detections``.

    python3 ros2_detection.py

The node is called detection_$EDGECTL_HOST, so that two may live while it is moved. Metrics: ``fps``,
``frame_ms``, ``recall`` as in detection.py. Ends with success at the end of the mission. Python >= 3.8, rclpy
and std_msgs.
"""

from __future__ import annotations

import os
import sys
import time

import detection
import ros2_topics as topics
import wire
from std_msgs.msg import Header, UInt8MultiArray


class Eye:
    """Looks at each picture; what it found in the last second."""

    def __init__(self, member: topics.Member) -> None:
        self.member = member
        member.publisher("detections", Header)
        self.began, self.frames, self.busy, self.sought, self.found = time.monotonic(), 0, 0.0, 0, 0

    def look(self, message: UInt8MultiArray) -> None:
        """Publish the balls of a picture, or leave at the end of the mission."""
        arrived = time.monotonic()
        header, pixels = topics.unpack(message)
        if header["over"]:
            self.member.leave()
            return
        balls = detection.detect(pixels, header["size"][0])
        self.member.publish("detections", topics.give_result(header, balls=balls))
        now = time.monotonic()
        self.frames, self.busy = self.frames + 1, self.busy + now - arrived
        self.sought, self.found = (
            self.sought + header["balls"],
            self.found + min(len(balls), header["balls"]),
        )
        if now - self.began >= detection.EVERY_S:
            recall = self.found / self.sought if self.sought else 1.0
            wire.report(
                fps=self.frames / (now - self.began),
                frame_ms=1000 * self.busy / self.frames,
                recall=recall,
            )
            self.began, self.frames, self.busy = now, 0, 0.0


def main() -> int:
    """Run until the robot's mission is over."""
    member = topics.Member("detection_" + os.environ.get("EDGECTL_HOST", "here"))
    member.hear("camera", UInt8MultiArray, Eye(member).look, topics.SENSOR)
    member.spin()
    member.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
