# SPDX-License-Identifier: Apache-2.0
"""What a manager computes in one cycle, by size of the fleet: ``python -m tests.benchmarks.scale [N ..]``.

CPU of reading the replies, of the plan, of the diff, of the record in the history and of the JSON of the plan, for
N edges and as many tasks, N/4 robots with a link from each of four edges. No host and no network takes part.
"""

import gc
import random
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from edgectl.executor.diff import plan_from_assignment
from edgectl.formats.document import dump_line
from edgectl.formats.kinds import PLAN_KIND
from edgectl.gateway.probe_reply import ReplyContext, decode_host_sample
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.scheduler.assign import assign
from edgectl.state.store import Store
from edgectl.state.store_file import HISTORY_FILE_NAME
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks

SIZES = (10, 100, 1000)
EDGES_PER_ROBOT = 4
Value = TypeVar("Value")


def build_reply(host: str, robots: Sequence[str], chance: random.Random) -> dict[str, object]:
    """The reply of one edge, which carries one task."""
    link = {"rx_bytes_per_s": 1e4, "tx_bytes_per_s": 1e5, "interface": "eth0", "reachable": True}
    task = {
        "state": "ready", "pid": 4711, "age_s": 600.0, "instance": host, "spec_hash": "0123456789abcdef",
        "used_cores": chance.random() / 4, "used_bytes": 6e7, "rx_bytes_per_s": 1e4, "tx_bytes_per_s": 1e5,
    }  # fmt: skip
    return {
        "v": 1,
        "op": "probe",
        "host": host,
        "cpu": {"cores": 4, "used_cores": chance.random()},
        "memory": {"total_bytes": 8e9, "used_bytes": 1e9 * chance.random()},
        "interfaces": {"eth0": {"rx_bytes_per_s": 1e4, "tx_bytes_per_s": 1e5, "speed_bytes_per_s": 125e6}},
        "links": dict.fromkeys(robots, link),
        "tasks": {host.replace("edge", "task"): task},
    }


def measure(act: Callable[[], Value]) -> tuple[Value, float]:
    """What ``act`` gives, and the CPU seconds that it takes."""
    gc.collect()
    began = time.process_time()
    found = act()
    return found, time.process_time() - began


def measure_files(folder: str) -> int:
    """Bytes of the history, with what it has not merged yet."""
    return sum(path.stat().st_size for path in Path(folder).glob(f"{HISTORY_FILE_NAME}*"))


def measure_size(size: int) -> list[float]:
    """Milliseconds of each step, and KiB of history and of JSON."""
    chance = random.Random(size)
    robots = [f"robot{number}" for number in range(max(1, size // EDGES_PER_ROBOT))]
    edges = [an_edge(f"edge{number}") for number in range(size)]
    inventory: Inventory = an_inventory(*edges, *map(a_robot, robots))
    tasks = some_tasks(
        *(
            a_task(
                f"task{number}", cpu=0.25, memory=6e7, throughput=1e5, robots=[robots[number % len(robots)]]
            )
            for number in range(size)
        )
    )
    near = {
        edge.name: [robots[(number // EDGES_PER_ROBOT) % len(robots)]] for number, edge in enumerate(edges)
    }
    replies = {edge.name: build_reply(edge.name, near[edge.name], chance) for edge in edges}

    def read() -> Snapshot:
        hosts = {
            edge.name: decode_host_sample(
                replies[edge.name],
                ReplyContext(host=edge, answered_at=NOW, robots=tuple(near[edge.name])),
            )
            for edge in edges
        }
        return Snapshot(taken_at=NOW, hosts=hosts, manager=ManagerState())

    snapshot, reading = measure(read)
    manager = ManagerState()
    made, planning = measure(lambda: assign(inventory, tasks, snapshot, manager, Policy(), NOW))
    plan, comparing = measure(lambda: plan_from_assignment(inventory, tasks, snapshot, manager, made))
    with tempfile.TemporaryDirectory() as folder, Store.open(Path(folder)) as store:
        store.record_snapshot(snapshot)  # makes the tables and the names
        before = measure_files(folder)
        _, recording = measure(
            lambda: store.record_snapshot(Snapshot(taken_at=NOW + 10, hosts=snapshot.hosts))
        )
        written = measure_files(folder) - before
    text, encoding = measure(lambda: dump_line(PLAN_KIND.encode(plan)))
    steps = (reading, planning, comparing, recording, encoding)
    return [*(1000 * each for each in steps), written / 1024, len(text) / 1024]


def main(arguments: Sequence[str]) -> int:
    """Print a row for each size."""
    titles = ("hosts", "replies", "plan", "diff", "history", "JSON", "history KiB", "JSON KiB")
    print("ms of CPU for", "".join(f"{title:>12}" for title in titles))
    for size in [int(text) for text in arguments] or SIZES:
        print(f"{'':13}{size:>12}" + "".join(f"{each:>12.1f}" for each in measure_size(size)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
