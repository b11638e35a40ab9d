# SPDX-License-Identifier: Apache-2.0
"""Short form of ``make fuzz``, and proof that it finds planted bugs."""

import time
from pathlib import Path

import pytest

from tests.fuzz.run import count_cases, run_target
from tests.fuzz.targets import Target, build_targets
from tests.pace import patience

CASES = 120


def test_decoders_read_or_refuse_whatever_is_damaged(tmp_path: Path) -> None:
    with build_targets(tmp_path) as found:
        assert len(found) >= 7
        for target in found:
            tally = run_target(target, seed=1, cases=CASES, until=time.monotonic() + patience(60))
            assert tally.bad == []
            assert tally.cases == count_cases(target, CASES)
            assert tally.accepted + tally.refused == tally.cases
            assert tally.accepted


@pytest.mark.parametrize("wrong", [ValueError("x"), RecursionError(), KeyError("k")])
def test_a_foreign_exception_is_noticed(wrong: Exception) -> None:
    def read(_data: bytes) -> object:
        raise wrong

    tally = run_target(
        Target("planted", [b"x"], read), seed=1, cases=3, until=time.monotonic() + patience(10)
    )
    assert len(tally.bad) == 3


def test_a_slow_case_is_noticed() -> None:
    def read(_data: bytes) -> object:
        end = time.process_time() + 1.1
        while time.process_time() < end:
            pass
        return None

    assert (
        "took 1."
        in run_target(
            Target("planted", [b"x"], read), seed=1, cases=1, until=time.monotonic() + patience(10)
        ).bad[0]
    )
