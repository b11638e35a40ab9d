# SPDX-License-Identifier: Apache-2.0
"""A node with a map: ``map_node.py 1|2 SEED HEARD``. It has the map of the file SEED, which the first instance takes,
or the one that it hears on /map; it writes it to HEARD/$EDGECTL_HOST and publishes it latched on /map.
"""

import os
import sys
from pathlib import Path
from typing import Any


class Map:
    """The map in memory; it is published when it is another."""

    def __init__(self, heard: Path) -> None:
        self.text = ""
        self.heard = heard / os.environ["EDGECTL_HOST"]
        self.publish: Any = None

    def take(self, text: str) -> None:
        if text != self.text:
            self.text = text
            self.heard.with_suffix(".new").write_text(text)
            self.heard.with_suffix(".new").replace(self.heard)
            self.publish(text)


def take_seed(kept: Map, seed: Path) -> None:
    if seed.exists():
        text = seed.read_text()
        seed.unlink()
        kept.take(text)


def run_ros1(kept: Map, seed: Path) -> None:
    import rospy  # type: ignore[import-not-found]
    from std_msgs.msg import String  # type: ignore[import-not-found]

    rospy.init_node("mapper")
    kept.publish = rospy.Publisher("/map", String, queue_size=1, latch=True).publish
    rospy.Subscriber("/map", String, lambda message: kept.take(message.data))
    take_seed(kept, seed)
    rospy.spin()


def run_ros2(kept: Map, seed: Path) -> None:
    import rclpy  # type: ignore[import-not-found]
    from rclpy.qos import (  # type: ignore[import-not-found]
        DurabilityPolicy,
        QoSProfile,
        ReliabilityPolicy,
    )
    from std_msgs.msg import String

    rclpy.init(args=[])
    node = rclpy.create_node("mapper")
    latched = QoSProfile(
        depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
    )
    publisher = node.create_publisher(String, "/map", latched)
    kept.publish = lambda text: publisher.publish(String(data=text))
    node.create_subscription(String, "/map", lambda message: kept.take(message.data), latched)
    take_seed(kept, seed)
    rclpy.spin(node)


if __name__ == "__main__":
    version, first, folder = sys.argv[1:]
    run = run_ros1 if version == "1" else run_ros2
    run(Map(Path(folder)), Path(first))
