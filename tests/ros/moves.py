# SPDX-License-Identifier: Apache-2.0
"""Moves of a pipeline between hosts in namespaces: ``python -m tests.ros.moves [1|2]`` prints the table of
docs/ros.md.
"""

import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

from tests.faults.fleet import FaultFleet
from tests.ros.lab import (
    CORE,
    NODE,
    NODE2,
    ROBOT,
    SECOND,
    add_core,
    add_task,
    apply,
    open_lab,
    read_times,
    wait_for,
)

PIPELINES = {1: NODE.format(file="pipeline.py") + " 1", 2: NODE2.format(file="pipeline.py") + " 2"}
ORDERS = ("stop-first", "start-first")
HZ = 30


@dataclass(frozen=True)
class Move:
    """One move of the detection, in this version of ROS: ``silence_s`` on the robot between two commands, ``gap_s`` by
    edgectl.
    """

    version: int
    order: str
    silence_s: float
    gap_s: float | None


def add_pipeline(fleet: FaultFleet, version: int, order: str, host: str) -> None:
    """Camera and steering on the robot, detection on an edge: 30 messages of 20 kB a second."""
    run, needs = PIPELINES[version], ["roscore"] if version == 1 else []
    add_task(fleet, "camera", f"{run} camera source /image {HZ} 20000", ROBOT, needs=needs)
    # In ROS 1 a second node of one name throws the first one out.
    name = "detection" if order == "stop-first" else "detection_$EDGECTL_HOST"
    ready = {"ros_node": f"/{name}".replace("$EDGECTL_HOST", host), "timeout": "60s"}
    if order == "start-first" and version == 1:
        # Who is in the graph is not yet connected: the old one shall stay until the new one is heard.
        ready["ros_topic"] = "/detections"
    if order == "start-first" and version == 2:
        # A check of the topic on its own host would not know when the subscriber on another host has discovered it.
        ready = {"command": 'test -e "$HOME/relays-$EDGECTL_PID"', "timeout": "60s"}
    add_task(
        fleet,
        "detection",
        f"{run} {name} relay /image /detections",
        host,
        needs=needs,
        ready=ready,
        handoff={"order": order},
    )
    add_task(fleet, "command", f"{run} command relay /detections /commands", CORE, needs=needs)
    add_task(fleet, "wheels", f"{run} wheels sink /commands $HOME/commands", ROBOT, needs=needs)


def measure_moves(fleet: FaultFleet, version: int, count: int) -> Iterator[Move]:
    """Move the detection to and fro, ``count`` times in each order."""
    if version == 1:
        add_core(fleet)
    for order in ORDERS:
        add_pipeline(fleet, version, order, CORE)
        apply(fleet)
        wait_for(lambda: _is_flowing(fleet), 60.0)
        for number in range(count):
            add_pipeline(fleet, version, order, (SECOND, CORE)[number % 2])
            yield _measure(fleet, version, order)


def _measure(fleet: FaultFleet, version: int, order: str) -> Move:
    began = time.monotonic()
    document = apply(fleet)
    wait_for(lambda: _is_flowing(fleet), 60.0)
    times = [each for each in read_times(fleet, "commands") if each > began - 1.0]
    [action] = [each for each in document["item"]["actions"] if each["task"] == "detection"]
    silence = max(late - early for early, late in pairwise(times))
    return Move(version=version, order=order, silence_s=silence, gap_s=action["downtime_s"])


def _is_flowing(fleet: FaultFleet) -> bool:
    """Whether commands have come for a second."""
    now = time.monotonic()
    return sum(now - 1.5 < each for each in read_times(fleet, "commands")) > HZ / 2


def main(versions: "list[int]") -> None:
    """Print the table: ten moves in each order."""
    print(
        "| ROS | order | moves | silence on the robot, median and most | gap that edgectl says, median and most |"
    )
    print("|---|---|--:|--:|--:|")
    for version in versions:
        with tempfile.TemporaryDirectory() as folder, open_lab(Path(folder), version) as fleet:
            moves = list(measure_moves(fleet, version, count=10))
        for order in ORDERS:
            found = [move for move in moves if move.order == order]
            silence, gaps = [move.silence_s for move in found], [move.gap_s or 0.0 for move in found]
            cells = [f"{median(each):.2f} s, {max(each):.2f} s" for each in (silence, gaps)]
            print(f"| {version} | {order} | {len(found)} | {cells[0]} | {cells[1]} |", flush=True)


if __name__ == "__main__":
    main([int(each) for each in sys.argv[1:]] or list(PIPELINES))
