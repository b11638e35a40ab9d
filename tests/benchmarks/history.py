# SPDX-License-Identifier: Apache-2.0
"""Cost of the history: recording and querying snapshots of 50 hosts, 200 links and 200 tasks. ``python -m
tests.benchmarks.history``.
"""

import argparse
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from edgectl.model.resource import Usage
from edgectl.model.snapshot import LinkSample, Snapshot, TaskSample, TaskState
from edgectl.state.store import Retention, Store
from edgectl.state.store_file import HISTORY_FILE_NAME
from tests.builders import NOW, a_sample, a_snapshot

HOSTS, TASKS_EACH, LINKS_EACH = 50, 4, 4
GOAL_S = 0.05


def build_snapshot(number: int, chance: random.Random) -> Snapshot:
    """Return the fleet's snapshot, ten seconds after the previous one."""
    hosts = {}
    for host in range(HOSTS):
        tasks = {
            f"task-{host}-{each}": TaskSample(
                state=TaskState.READY, started_at=NOW, used=Usage(cpu=chance.random(), memory=chance.random() * 1e9, network=chance.random() * 1e6), instance=f"{host:08d}{each:08d}", spec_hash=f"{each:016d}",
            )
            for each in range(TASKS_EACH)
        }  # fmt: skip
        links = {
            f"robot{each}": LinkSample(
                capacity_bytes_per_s=1e7, used_bytes_per_s=chance.random() * 1e7, rtt_ms=chance.random()
            )
            for each in range(LINKS_EACH)
        }
        hosts[f"edge{host}"] = a_sample(used=chance.random(), tasks=tasks, links=links)
    return a_snapshot(hosts, taken_at=NOW + 10 * number)


def measure_time(act: Callable[[], object]) -> tuple[float, float]:
    """Return seconds of CPU and of the wall clock."""
    wall, cpu = time.perf_counter(), time.process_time()
    act()
    return time.process_time() - cpu, time.perf_counter() - wall


def record_snapshot(directory: Path, snapshot: Snapshot) -> None:
    with Store.open(directory) as store:
        store.record_snapshot(snapshot)


def print_time(what: str, times: list[tuple[float, float]]) -> float:
    cpu = statistics.median(time[0] for time in times)
    print(f"{what:55}{cpu * 1000:9.1f} ms CPU{statistics.median(time[1] for time in times) * 1000:9.1f} ms")
    return cpu


def main() -> int:
    """Return the exit status: 1 if recording a snapshot took more CPU than its goal."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--snapshots", type=int, default=400)
    count = parser.parse_args().snapshots
    chance = random.Random(1)
    with tempfile.TemporaryDirectory(prefix="edgectl-history-") as place:
        directory = Path(place)
        made = [build_snapshot(number, chance) for number in range(count // 2)]
        cost = print_time(
            "record a snapshot, file reopened",
            [measure_time(partial(record_snapshot, directory, each)) for each in made],
        )
        with Store.open(directory) as store:
            made = [build_snapshot(number, chance) for number in range(count // 2, count)]
            print_time(
                "record a snapshot, file open",
                [measure_time(partial(store.record_snapshot, each)) for each in made],
            )
            print_time(
                "the newest 60 samples of each of 200 tasks",
                [measure_time(lambda: store.task_points(limit=60)) for _ in range(5)],
            )
            print_time(
                "the newest 60 samples of each of 50 hosts",
                [measure_time(lambda: store.host_points(limit=60)) for _ in range(5)],
            )
            print_time(
                f"all {count} samples of one task",
                [measure_time(lambda: store.task_points("task-7-1")) for _ in range(5)],
            )
        size = (directory / HISTORY_FILE_NAME).stat().st_size
        print(f"{'file, per snapshot':55}{size / count / 1024:9.1f} KiB")
        with Store.open(directory, retention=Retention(max_bytes=size // 2)) as store:
            print_time(f"halve a file of {size / 2**20:.0f} MiB", [measure_time(lambda: store.prune(NOW))])
        print(f"{'afterwards':55}{(directory / HISTORY_FILE_NAME).stat().st_size / 2**20:9.1f} MiB")
    return 1 if cost > GOAL_S else 0


if __name__ == "__main__":
    sys.exit(main())
