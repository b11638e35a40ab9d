# SPDX-License-Identifier: Apache-2.0
"""Time of the search for room of unplaced tasks: ``python -m tests.benchmarks.repair [FLEETS]``.

CPU of the search alone, of fleets that are filled to 88 to 95 %: the least of several turns in one process, because
readings differ by what else the machine does.
"""

import sys
from collections.abc import Iterable, Sequence
from statistics import median
from time import process_time

import pytest

from edgectl.scheduler.choice import Choice
from edgectl.scheduler.decided_plan import DecidedPlan
from edgectl.scheduler.repair import repair_plan
from tests.quality.measures import measure_yardstick
from tests.scheduler.tight_fleets import TightFleet, build_full_fleet

SIZES = ((5, 20), (10, 50))
TURNS = 15


def collect_plans(fleets: Iterable[TightFleet]) -> list[DecidedPlan]:
    """The plans in which a task of these fleets found no room."""
    found: list[DecidedPlan] = []

    def note_plan(plan: DecidedPlan) -> dict[str, Choice]:
        found.append(plan)
        return {}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edgectl.scheduler.repair.repair_plan", note_plan)
        for fleet in fleets:
            fleet.assign()
    return found


def measure_searches(plans: Sequence[DecidedPlan], turns: int) -> list[float]:
    """Milliseconds of the search of each plan, the least of all turns."""
    least = [float("inf")] * len(plans)
    for _ in range(turns):
        for index, plan in enumerate(plans):
            began = process_time()
            repair_plan(plan)
            least[index] = min(least[index], 1000 * (process_time() - began))
    return least


def main(arguments: Sequence[str]) -> int:
    """Print a row for each size."""
    fleets = int(arguments[0]) if arguments else 50
    print(f"yardstick {measure_yardstick():.2f} s; {fleets} fleets of each size")
    for edges, tasks in SIZES:
        plans = collect_plans(build_full_fleet(edges, tasks, seed) for seed in range(fleets))
        found = measure_searches(plans, TURNS)
        print(f"{edges} x {tasks}: median {median(found):.2f} ms, most {max(found):.1f} ms of {len(found)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
