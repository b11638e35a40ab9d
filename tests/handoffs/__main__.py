# SPDX-License-Identifier: Apache-2.0
"""Measure warm moves over real SSH between two computers in network namespaces, with a line of 2 ms each way (root).

    .venv/bin/python -m tests.handoffs --moves 200
    .venv/bin/python -m tests.handoffs --moves 200 --node ros2

Prints the gap at the subscriber, which is where the manager is, and how often two instances were active at once:
then it fails.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.faults.namespace_host import find_missing_for_namespaces
from tests.handoffs.ros_subscriber import PYTHON
from tests.handoffs.scene import Scene
from tests.handoffs.scenes import SCENES
from tests.handoffs.subscriber import Message, count_overlaps, list_gaps_ms

_NAMES = {"tcp": "a TCP task", "ros2": "a lifecycle node of ROS 2"}


def measure_moves(scene: Scene, moves: int) -> tuple[list[float], list[float]]:
    """Make ``moves`` warm moves; each gap at the subscriber and each downtime by the manager's clock, in ms."""
    scene.start()
    downtimes = []
    for number in range(moves):
        (action,) = scene.move().actions
        downtimes.append(1e3 * (action.downtime_s or 0.0))
        if number % 20 == 19:
            print(f"{number + 1} moves, {describe_spread(downtimes)} by the manager", flush=True)
    return list_gaps_ms(scene.subscriber.take()), downtimes


def describe_spread(values_ms: Sequence[float]) -> str:
    ranked = sorted(values_ms)
    picks = {name: ranked[min(len(ranked) - 1, int(share * len(ranked)))] for name, share in _SHARES.items()}
    return ", ".join(f"{name} {value:.1f} ms" for name, value in picks.items())


_SHARES = {"p50": 0.5, "p95": 0.95, "p99": 0.99, "most": 1.0}


def describe_messages(messages: Sequence[Message], moves: int) -> str:
    sent, heard = count_overlaps(messages, moves), len(list_gaps_ms(messages)) - moves
    return f"{len(messages)} messages, {sent} times two active, {heard} times two heard"


def find_missing(node: str) -> str:
    """Why this cannot be measured here; empty if it can."""
    if node == "ros2" and not PYTHON.exists():
        return "rclpy is not installed: .ci/need-ros"
    return find_missing_for_namespaces()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moves", type=int, default=200)
    parser.add_argument("--node", choices=sorted(SCENES), default="tcp", help="what is moved")
    parser.add_argument("--delay", type=float, default=2.0, help="of a line, in ms, each way")
    options = parser.parse_args()
    if why := find_missing(options.node):
        raise SystemExit(f"cannot measure here: {why}")
    began, load = time.monotonic(), os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="edgectl-handoffs-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        with SCENES[options.node](folder, options.delay) as scene:
            gaps, downtimes = measure_moves(scene, options.moves)
            messages = scene.subscriber.take()
    print(f"{options.moves} warm moves of {_NAMES[options.node]}, lines of {options.delay:g} ms each way")
    print(f"gap at the subscriber: {describe_spread(gaps)}")
    print(f"downtime by the manager: {describe_spread(downtimes)}")
    print(f"{describe_messages(messages, options.moves)}")
    print(f"{time.monotonic() - began:.0f} s; load {load:.1f} before, {os.getloadavg()[0]:.1f} at the end")
    raise SystemExit(count_overlaps(messages, options.moves) != 0)


if __name__ == "__main__":
    main()
