# SPDX-License-Identifier: Apache-2.0
"""A run goes on where the recorded ones ended: with the next seeds, the rarest faults first, until its time is over."""

import time
from pathlib import Path

from tests.faults import fault_list
from tests.faults.injection_record import (
    Case,
    add_record,
    build_rows,
    count_seeds,
    order_cases,
    read_records,
)
from tests.faults.oracle import OracleVerdict
from tests.faults.registry import InjectionResult, draw_seeds, format_table, run_fault

CASES: list[Case] = [
    (each, "loopback", 2)
    for each in fault_list.list_faults()
    if "loopback" in each.kinds and not each.missing()
][:4]


def test_the_next_run_begins_with_the_rarest_faults_and_the_next_seeds(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    assert order_cases(CASES, read_records(path)) == CASES
    for case, times in zip(CASES, (2, 0, 1, 0), strict=True):
        for seed in draw_seeds(case[0], case[1], times, 7):
            add_record(path, case, 7, seed, InjectionResult(injected=4), seconds=1.0)
    found = read_records(path)
    assert order_cases(CASES, found) == [CASES[1], CASES[3], CASES[2], CASES[0]]
    assert [count_seeds(found, case, 7) for case in CASES] == [2, 0, 1, 0]
    assert [count_seeds(found, case, 8) for case in CASES] == [0, 0, 0, 0]
    recorded = [each.seed for each in found if each.fault == CASES[0][0].name]
    assert len({*recorded, *draw_seeds(CASES[0][0], CASES[0][1], 5, 7)[2:]}) == 5


def test_a_line_that_a_kill_cut_short_is_no_injection(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    add_record(path, CASES[0], 1, 11, InjectionResult(), seconds=1.0)
    with path.open("a") as file:
        file.write('{"day": "2026')
    assert [each.seed for each in read_records(path)] == [11]


def test_the_table_of_a_record_counts_all_runs(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    add_record(path, CASES[0], 1, 11, InjectionResult(injected=4), seconds=10.0)
    lost = OracleVerdict(lost=("slam does not run",), doubled=("nav runs 2 times", "nav overlapped"))
    add_record(path, CASES[0], 2, 12, InjectionResult(injected=3, wrong=lost), seconds=5.0)
    add_record(path, CASES[1], 2, 13, InjectionResult(wrong="a traceback"), seconds=1.0)
    first, second = build_rows(read_records(path))
    assert (first.injected, first.survived, first.lost, first.doubled, first.good) == (7, 6, 1, 2, False)
    assert (second.injected, second.survived, second.lost) == (1, 0, 0)
    assert "| **all** | | 8 | 6 | 1 | 2 | 16 |" in format_table([first, second])
    assert "seed 12): slam does not run; nav runs 2 times" in first.failures[0]


def test_nothing_begins_when_the_time_is_over() -> None:
    row = run_fault(*CASES[0], 1, until=time.monotonic())
    assert (row.injected, row.not_run) == (0, "no time left")
    assert "NOT RUN: 1 of 1 faults (no time left)." in format_table([row])
