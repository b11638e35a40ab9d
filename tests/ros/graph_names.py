# SPDX-License-Identifier: Apache-2.0
"""Observer of a graph of ROS 2 for the tests: ``graph_names.py FILE`` writes the names of all nodes, each 0.1 s."""

import sys
import time
from pathlib import Path

import rclpy  # type: ignore[import-not-found]


def main(path: str) -> None:
    """Observe until killed; the observer itself is left out."""
    rclpy.init(args=[])
    node = rclpy.create_node("observer")
    while True:
        names = sorted(space.rstrip("/") + "/" + name for name, space in node.get_node_names_and_namespaces())
        Path(path + ".new").write_text("\n".join(name for name in names if name != "/observer"))
        Path(path + ".new").replace(path)
        time.sleep(0.1)


if __name__ == "__main__":
    main(sys.argv[1])
