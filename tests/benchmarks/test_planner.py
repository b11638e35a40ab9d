"""The planner stays fast enough for a lab; the whole table is ``python -m tests.benchmarks.planner``."""

from tests.benchmarks.planner import measure, table


def test_a_lab_and_a_hall_are_planned_at_once() -> None:
    lab, hall = measure(3, 10), measure(50, 200)
    # 0.13 s on an idle core; the bound leaves room for a busy machine, and catches a planner that grows with the square
    assert hall.assign_s < 1.5
    assert hall.plan_s < 0.5
    assert hall.peak_bytes < 64 * 2**20
    measured = measure(50, 200, history=True)
    assert measured.assign_s < 2.5, "measured demands cost about as much again, not more"
    assert measured.settled == hall.settled
    assert table([lab, hall]).count("\n") == 3
