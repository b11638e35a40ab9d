# SPDX-License-Identifier: Apache-2.0
"""Bound on the planner's time; the whole table is ``python -m tests.benchmarks.planner``."""

from tests.benchmarks.planner import format_table, measure_size


def test_a_lab_and_a_hall_are_planned_at_once() -> None:
    lab, hall = measure_size(3, 10), measure_size(50, 200)
    # 0.13 s on an idle core; the bound leaves room for a busy machine, and fails a planner of quadratic time
    assert hall.assign_s < 1.5
    assert hall.plan_s < 0.5
    assert hall.peak_bytes < 64 * 2**20
    measured = measure_size(50, 200, history=True)
    assert measured.assign_s < 2.5, "measured demands at most double the time"
    assert measured.settled == hall.settled
    assert format_table([lab, hall]).count("\n") == 3
