# SPDX-License-Identifier: Apache-2.0
"""What one item of the patrol takes, for ``cycles:`` of docs/scenarios/patrol.yaml; no mission is run.

    python -m tests.experiments.lab.items [--seconds 10]

CPU per item by the counters of programs that run alone on this machine, and the time of a picture over the shaped links of the lab,
on computers in namespaces (root).
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import psutil

from tests.experiments.lab.hosts import Lab, lab
from tests.experiments.lab.patrol import PATROL, wire
from tests.faults.namespace_host import NamespaceHost
from tests.pace import patience

# Its port is that of no other robot here.
ROBOT = "robot77"
# Asks for a picture, waits as long as one is looked at, and tells its result; prints the seconds of each picture.
CLIENT = """
import sys, time
sys.path.insert(0, sys.argv[1])
import wire
link = wire.Link(sys.argv[2], sys.argv[3])
link.ask("pose")
for _ in range(int(sys.argv[4])):
    began = time.monotonic()
    header, _ = link.ask("frame")
    took = time.monotonic() - began
    time.sleep(0.036)
    link.ask("result", of="frame", number=header["number"], who="x")
    print(took)
    time.sleep(max(0.0, 0.2 - (time.monotonic() - began)))
"""


@contextmanager
def running(
    *programs: str, prefix: tuple[str, ...] = (), address: str = "127.0.0.1"
) -> Iterator[dict[str, psutil.Process]]:
    """The programs of the patrol, for a robot at this address; ended afterwards."""
    env = {**os.environ, "EDGECTL_ROBOT": ROBOT, "EDGECTL_ROBOT_HOST": address}
    started: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for program in programs:
            words = [*prefix, sys.executable, str(PATROL / f"{program}.py")]
            started[program] = subprocess.Popen(words, env=env, stdout=subprocess.DEVNULL)
        yield {name: psutil.Process(process.pid) for name, process in started.items()}
    finally:
        for process in reversed(started.values()):
            process.terminate()
            process.wait(patience(30))


def measure_cpu_ms(program: str, sense: str, seconds: float) -> tuple[float, float]:
    """CPU (ms) of this program and of the robot for one item of this sense, without what their start takes."""
    with running("robot") as robot, running(program) as task:
        link = wire.Link("127.0.0.1", ROBOT)
        processes = {**robot, **task}
        deadline = time.monotonic() + patience(30)
        while not link.ask("pose")[0]["taken"][sense]:
            assert time.monotonic() < deadline, f"{program} gives no results"
            time.sleep(0.1)
        before, first = _read_cpu_s(processes), link.ask("pose")[0]["taken"][sense]
        time.sleep(seconds)
        after, count = _read_cpu_s(processes), link.ask("pose")[0]["taken"][sense] - first
        link.close()
    assert count > 0, f"no item of {program} in {seconds} s"
    return tuple(1000 * (after[name] - before[name]) / count for name in (program, "robot"))  # type: ignore[return-value]


def _read_cpu_s(processes: Mapping[str, psutil.Process]) -> dict[str, float]:
    times = {name: process.cpu_times() for name, process in processes.items()}
    return {name: each.user + each.system for name, each in times.items()}


def measure_picture_s(made: Lab, near: str, pictures: int) -> float:
    """Median time (s) until edge1 has a picture of robot1, whose near edge is ``near``."""
    robot, edge = made.hosts["robot1"], made.hosts["edge1"]
    assert isinstance(robot, NamespaceHost)
    assert isinstance(edge, NamespaceHost)
    shape = [*made.prefix, sys.executable, str(PATROL / "radio.py"), f"robot1={near}"]
    subprocess.run(shape, env=made.environment, check=True, timeout=patience(30))
    address = robot.login[0]
    with running("robot", prefix=("nsenter", "-t", str(robot.pid), "-n"), address=address):
        words = ["nsenter", "-t", str(edge.pid), "-n", sys.executable, "-c", CLIENT]
        fetched = subprocess.run(
            [*words, str(PATROL), address, ROBOT, str(pictures)],
            capture_output=True,
            text=True,
            check=True,
            timeout=patience(60 + pictures),
        )
    return statistics.median(map(float, fetched.stdout.split()))


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What one item of the patrol takes.")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    seconds = parser.parse_args().seconds
    for program, sense in (("detection", "frame"), ("mapper", "scan")):
        own, source = measure_cpu_ms(program, sense, seconds)
        print(f"{program}: cpu {own:.1f} ms, source_cpu {source:.1f} ms", flush=True)
    with tempfile.TemporaryDirectory(prefix="edgectl-items-") as directory, lab(Path(directory)) as made:
        if not made.prefix:
            sys.exit(f"no shaped links here: {made.wanting}")
        for near, rate in (("edge1", 2e6), ("edge2", 2e5)):
            took = measure_picture_s(made, near, int(2 * seconds))
            print(
                f"a picture at {rate / 1e6:g} MB/s: {took:.3f} s, as {took * rate / 1e3:.0f} kB", flush=True
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
