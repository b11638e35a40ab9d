# SPDX-License-Identifier: Apache-2.0
"""Time and memory of a plan, from a lab to a thousand hosts: ``python -m tests.benchmarks.planner``.

Fails where the decisions of the largest fleet are not those of ``DIGESTS``, on either path.
"""

import gc
import hashlib
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import edgectl.scheduler.assign as planner
from edgectl.executor.diff import plan_from_assignment
from edgectl.model.assignment import Assignment
from edgectl.model.demand import ZERO, Demand
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, MeasuredDemand
from edgectl.model.policy import Policy
from edgectl.model.resource import TASK_RESOURCES
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from tests.builders import (
    GI,
    NOW,
    a_link,
    a_robot,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)

SIZES = ((3, 10), (50, 200), (100, 1000), (1000, 10000))
KINDS = 10
# By hosts, tasks, and whether every demand is measured: `digest_decisions`, with and without NumPy. A change that is
# to decide otherwise states the new ones.
DIGESTS = {
    (40, 120, False): "719134b08589e210",
    (40, 120, True): "96ef121fcf4fa485",
    (1000, 10000, False): "e8fb15578b83bd2b",
    (1000, 10000, True): "eaf9f61009507e66",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannerRow:
    """One size: CPU seconds of assign, of diff and plan (one thread, so these are wall seconds on an idle
    machine).

    ``peak_bytes``: increase of the peak resident memory by both, sizes growing within one process.
    """

    hosts: int
    tasks: int
    assign_s: float
    plan_s: float
    peak_bytes: int
    settled: bool
    digest: str


def build_fleet(hosts: int, tasks: int) -> tuple[Inventory, Tasks, Snapshot]:
    """Build a fleet: edges of three sizes, a robot for every ten of them, and tasks of ten kinds that fill
    about half of the capacity.
    """
    robots = [f"robot{number}" for number in range(1, max(3, hosts // 10) + 1)]
    edges = [f"edge{number}" for number in range(1, hosts + 1)]
    inventory = an_inventory(*map(an_edge, edges), *map(a_robot, robots))
    samples = {
        name: a_sample(cores=float(4 + 4 * (n % 3)), used=0.1 * (n % 7), memory=(4 + 4 * (n % 3)) * GI, used_memory=0.2 * GI * (n % 5),
                       links={robot: a_link(10e6 + 1e5 * ((n + k) % 11)) for k, robot in enumerate(robots)})
        for n, name in enumerate(edges)
    }  # fmt: skip
    per_task = 4.0 * hosts / tasks
    made = [
        a_task(f"task{n}", cpu=per_task * (1 + n % KINDS) / KINDS, memory=per_task * GI * (KINDS - n % KINDS) / KINDS,
               throughput=2e4 * (n % KINDS), robots=[robots[n % len(robots)]], needs=[f"task{n - 1}"] if n % 2 else [])
        for n in range(tasks)
    ]  # fmt: skip
    return inventory, some_tasks(*made), a_snapshot(samples)


def add_measured_demand(work: Tasks) -> tuple[Tasks, ManagerState]:
    """Replace declared demands by measured ones, on all three classes of hosts; no two tasks are alike."""
    measured = {
        (task.name, kind): MeasuredDemand(
            samples=412, span_s=900.0, used={name: (quantity or ZERO).value * (1.0 + 1e-6 * number) for name, quantity in task.demand.items()},
        )
        for number, task in enumerate(work.tasks.values())
        for kind in ("4c-4Gi", "8c-8Gi", "12c-12Gi")
    }  # fmt: skip
    silent = {name: replace(task, demand=Demand()) for name, task in work.tasks.items()}
    return replace(work, tasks=silent), ManagerState(managed=True, measured=measured)


def measure_size(hosts: int, tasks: int, *, history: bool = False) -> PlannerRow:
    """Measure one size from a cold start, settling included; with ``history`` every demand is measured."""
    inventory, work, snapshot = build_fleet(hosts, tasks)
    work, memory = add_measured_demand(work) if history else (work, ManagerState(managed=True))
    gc.collect()
    before = read_peak_bytes()
    started = time.process_time()
    assignment = planner.assign(inventory, work, snapshot, memory, Policy(), NOW)
    assigned = time.process_time()
    plan_from_assignment(inventory, work, snapshot, memory, assignment)
    ended = time.process_time()
    return PlannerRow(
        hosts=hosts, tasks=tasks, assign_s=assigned - started, plan_s=ended - assigned, peak_bytes=read_peak_bytes() - before,
        settled=assignment.settled, digest=digest_decisions(assignment),
    )  # fmt: skip


def digest_decisions(assignment: Assignment) -> str:
    """Return a digest of who goes where and why, of all totals and leads, and of gamma, to the last bit."""
    lines = [
        f"{each.task} {each.verdict.value} {each.reason.value} {each.subject} {each.host} {each.challenger} {each.total!r} {each.lead!r}"
        for each in assignment.decisions
    ]
    names = [resource.name for resource in TASK_RESOURCES]
    lines += [
        f"{host} { {name: load.used[name] for name in names}!r} {dict(load.links)!r}"
        for host, load in assignment.expected.items()
    ]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def read_peak_bytes() -> int:
    """Return the peak resident memory of this process in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def format_table(rows: Sequence[PlannerRow]) -> str:
    """Format the rows as Markdown; growth is of the time per task-host pair from the row above."""
    lines = [
        "| hosts x tasks | assign CPU s | diff CPU s | us per task | ns per pair | growth | peak MiB | settled |",
        "|---|---|---|---|---|---|---|---|",
    ]
    previous = None
    for row in rows:
        pair = row.assign_s / (row.hosts * row.tasks) * 1e9
        growth = f"{pair / previous:.2f}" if previous else "-"
        previous = pair
        lines.append(
            f"| {row.hosts} x {row.tasks} | {row.assign_s:.4f} | {row.plan_s:.4f} | {row.assign_s / row.tasks * 1e6:.0f} | {pair:.0f} | {growth} "
            f"| {row.peak_bytes / 2**20:.1f} | {'yes' if row.settled else 'no'} |"
        )
    return "\n".join(lines)


def main(sizes: Sequence[tuple[int, int]] = SIZES) -> None:
    """Print the table, and the same with every demand measured."""
    digests = []
    for history in (False, True):
        rows = [measure_size(hosts, tasks, history=history) for hosts, tasks in sizes]
        print(format_table(rows) + "\n")
        digests.append(rows[-1].digest)
    print("the largest in pure Python, declared and measured:")
    planner.MIN_ARRAY_PAIRS = sys.maxsize
    rows = [measure_size(*sizes[-1], history=history) for history in (False, True)]
    print(format_table(rows))
    check_digests(sizes[-1], digests)
    check_digests(sizes[-1], [row.digest for row in rows])


def check_digests(size: tuple[int, int], digests: Sequence[str]) -> None:
    """Exit where the decisions, with declared and with measured demands, are not those that are known."""
    for history, digest in zip((False, True), digests, strict=True):
        known = DIGESTS.get((*size, history), digest)
        if digest != known:
            sys.exit(f"the decisions of {size[0]} x {size[1]} have the digest {digest}, not {known}")


if __name__ == "__main__":
    main(SIZES[: int(sys.argv[1])] if len(sys.argv) > 1 else SIZES)
