# SPDX-License-Identifier: Apache-2.0
"""Rows that are kept and predicted again, and what a percentile of so many jobs can tell."""

from pathlib import Path

import pytest

from edgectl.model.predicted_latency import ServiceTime
from tests.latency.bench import Frame, Link, Measured
from tests.latency.tables import Row, format_record, predict_row, print_rows, read_rows

SMALL, LARGE = Frame(width=176, height=132), Frame(width=240, height=180)
SERVICE = ServiceTime(p50=0.010, p95=0.012)


def build_row(frame: Frame, rate: float, used: float, services: list[float]) -> Row:
    """A row whose jobs take 2 ms more than their service time."""
    latencies = [each + 0.002 for each in services]
    measured = Measured(latencies=latencies, services=services, used=used, foreign=0.01, rtt_ms=0.02)
    return predict_row(frame, Link(rate=rate), used, measured, SERVICE)


def test_the_service_time_of_a_row_is_that_of_the_other_idle_rows_of_its_frame(tmp_path: Path) -> None:
    rows = [
        build_row(SMALL, 100e6, 0.0, [0.010] * 20),
        build_row(LARGE, 100e6, 0.0, [0.090] * 20),
        build_row(SMALL, 30e6, 0.0, [0.020] * 20),
        build_row(SMALL, 100e6, 0.4, [0.050] * 20),
        build_row(LARGE, 30e6, 0.0, [0.070] * 20),
    ]
    file = tmp_path / "rows"
    file.write_text("".join(format_record(row) + "\n" for row in rows))
    again = list(read_rows(file))
    assert [row.measured for row in again] == [row.measured for row in rows]
    assert [(row.frame, row.link, row.load) for row in again] == [
        (row.frame, row.link, row.load) for row in rows
    ]
    services = [row.predicted.service_ms for row in again]
    assert services == pytest.approx([20.0, 70.0, 10.0, 10.0, 90.0]), (
        "half of the jobs of two rows are shorter"
    )


def test_a_percentile_lies_between_two_jobs(capsys: pytest.CaptureFixture[str]) -> None:
    """Of 600 jobs p50 between the 276th and the 325th, p99 between the 590th and the 599th."""
    services = [number / 1000.0 for number in range(600)]
    row = build_row(SMALL, 100e6, 0.0, services)
    assert row.measured.bound_percentile_ms(0.50) == pytest.approx((277.0, 326.0))
    assert row.measured.bound_percentile_ms(0.99) == pytest.approx((591.0, 600.0))
    assert not row.is_surely_within(0.50, 0.10)
    assert row.is_surely_within(0.99, 1.0)
    print_rows([row])
    assert "within 20%: 0 of 1, 0 wherever measured p99 may be" in capsys.readouterr().out
