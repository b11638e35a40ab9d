"""Moves of a pipeline between hosts in namespaces: ``python -m tests.ros.moves`` prints the table of docs/ros.md."""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

from tests.faults.fleet import FaultFleet
from tests.ros.lab import CORE, NODE, ROBOT, SECOND, add_core, add_task, apply, open_lab, read_times, wait_for

PIPELINE = NODE.format(file="pipeline.py")
ORDERS = ("stop-first", "start-first")
HZ = 30


@dataclass(frozen=True)
class Move:
    """One move of the detection: ``silence_s`` on the robot between two commands, ``gap_s`` by edgectl."""

    order: str
    silence_s: float
    gap_s: float | None


def add_pipeline(fleet: FaultFleet, order: str, host: str) -> None:
    """Camera and steering on the robot, detection on an edge: 30 messages of 20 kB a second."""
    ready = {"timeout": "60s"}
    needs = ["roscore"]
    add_task(fleet, "camera", f"{PIPELINE} 1 camera source /image {HZ} 20000", ROBOT, needs=needs)
    # In ROS 1 a second node of one name throws the first one out.
    name = "detection" if order == "stop-first" else "detection_$EDGECTL_HOST"
    add_task(
        fleet,
        "detection",
        f"{PIPELINE} 1 {name} relay /image /detections",
        host,
        needs=needs,
        ready={"ros_node": f"/detection_{host}" if order != "stop-first" else "/detection", **ready},
        handoff={"order": order},
    )
    add_task(fleet, "command", f"{PIPELINE} 1 command relay /detections /commands", CORE, needs=needs)
    add_task(fleet, "wheels", f"{PIPELINE} 1 wheels sink /commands $HOME/commands", ROBOT, needs=needs)


def measure_moves(fleet: FaultFleet, count: int) -> Iterator[Move]:
    """Move the detection to and fro, ``count`` times in each order."""
    add_core(fleet)
    for order in ORDERS:
        add_pipeline(fleet, order, CORE)
        apply(fleet)
        wait_for(lambda: _is_flowing(fleet), 60.0)
        for number in range(count):
            add_pipeline(fleet, order, (SECOND, CORE)[number % 2])
            yield _measure(fleet, order)


def _measure(fleet: FaultFleet, order: str) -> Move:
    began = time.monotonic()
    document = apply(fleet)
    wait_for(lambda: _is_flowing(fleet), 60.0)
    times = [each for each in read_times(fleet, "commands") if each > began - 1.0]
    [action] = [each for each in document["item"]["actions"] if each["task"] == "detection"]
    silence = max(late - early for early, late in pairwise(times))
    return Move(order=order, silence_s=silence, gap_s=action["downtime_s"])


def _is_flowing(fleet: FaultFleet) -> bool:
    """Whether commands have come for a second."""
    now = time.monotonic()
    return sum(now - 1.5 < each for each in read_times(fleet, "commands")) > HZ / 2


def main() -> None:
    """Print the table: ten moves in each order."""
    with tempfile.TemporaryDirectory() as folder, open_lab(Path(folder)) as fleet:
        moves = list(measure_moves(fleet, count=10))
    print(
        "| order | moves | silence on the robot, median and most | gap that edgectl says, median and most |"
    )
    print("|---|--:|--:|--:|")
    for order in ORDERS:
        found = [move for move in moves if move.order == order]
        silence, gaps = [move.silence_s for move in found], [move.gap_s or 0.0 for move in found]
        cells = [f"{median(each):.2f} s, {max(each):.2f} s" for each in (silence, gaps)]
        print(f"| {order} | {len(found)} | {cells[0]} | {cells[1]} |")


if __name__ == "__main__":
    main()
