"""The simulated robot of the patrol as a node of ROS 2.

    python3 ros2_robot.py [--rate 5]

Publishes ``camera``, ``laser``, ``pose`` and ``kept/..``, hears ``cmd_vel``, ``detections``, ``mapped``,
``keep`` and ``over``, all below /$EDGECTL_ROBOT. Metrics: ``gap_ms``, the silence before the first result of
another instance; ``age_ms``, how old a picture is when its result comes. TERM ends it. Python >= 3.8, rclpy
and std_msgs.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any

import robot
import ros2_topics as topics
import wire
from std_msgs.msg import Header, String, UInt8MultiArray

POSE_S = 0.1
SENSES = {"frame": ("camera", "detections"), "scan": ("laser", "mapped")}


class Body:
    """The robot of robot.py, which is asked by topics."""

    def __init__(self, member: topics.Member, rate: float) -> None:
        number = max(1, wire.port(os.environ.get("EDGECTL_ROBOT", "robot1")) - wire.PORT)
        self.member, self.made = member, robot.Robot(number)
        self.heard: set[str] = set()
        for name in topics.KEPT:
            self.member.publish("kept/" + name, topics.pack({"name": name}), topics.LATCHED)
        for sense, (topic, results) in SENSES.items():
            member.publisher(topic, UInt8MultiArray, topics.SENSOR)
            member.node.create_timer(1.0 / rate, lambda sense=sense: self.look(sense))
            member.hear(results, Header, lambda message, sense=sense: self.take(sense, message))
        member.node.create_timer(POSE_S, self.tell)
        member.hear("cmd_vel", String, lambda message: self.ask("drive", **json.loads(message.data)))
        member.hear("over", String, lambda _: self.ask("over"))
        member.hear("keep", UInt8MultiArray, self.keep)

    def ask(self, what: str, payload: bytes = b"", **fields: Any) -> tuple[dict[str, Any], bytes]:
        """Ask as a client of robot.py does."""
        return robot.answer(self.made, {"ask": what, **fields}, payload)

    def look(self, sense: str) -> None:
        """Publish a picture or a scan, where somebody hears it."""
        publisher = self.member.publishers[SENSES[sense][0]]
        if publisher.get_subscription_count():
            taken = self.member.node.get_clock().now().to_msg()
            header, body = self.ask(sense)
            publisher.publish(topics.pack({**header, "stamp": [taken.sec, taken.nanosec]}, body))

    def take(self, sense: str, message: Header) -> None:
        """Take in a result."""
        found = json.loads(message.frame_id)
        # While a task is moved both of its instances may give results; the first one of the new ends the gap.
        who = found["who"] if found["who"] not in self.heard else self.made.senses[sense].who
        self.heard.add(found["who"])
        header, _ = self.ask("result", of=sense, number=found["number"], who=who)
        if sense == "frame":
            wire.count(age_ms=header["age_ms"])

    def tell(self) -> None:
        """Publish where it is, its tour, and how many results it has."""
        self.member.publish("pose", topics.say(**self.ask("tour")[0]))

    def keep(self, message: UInt8MultiArray) -> None:
        """Keep data for others."""
        name = topics.unpack(message)[0]["name"]
        self.member.publish("kept/" + name, message, topics.LATCHED)


def main() -> int:
    """Serve until TERM."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=5.0, help="pictures and scans per second")
    member = topics.Member("robot")
    Body(member, parser.parse_args().rate)
    member.spin()
    member.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
