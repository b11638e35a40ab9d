# SPDX-License-Identifier: Apache-2.0
"""Time and memory of moves with a large state, over SSH and links of 50 Mbit/s in a network namespace."""

import tempfile
from pathlib import Path

import pytest

from tests.e2e.shaped_move import run_moves
from tests.pace import patience
from tests.usecases.shaped_network import find_missing

pytestmark = pytest.mark.skipif(bool(find_missing()), reason=find_missing())


def test_large_state_takes_the_time_of_its_link_and_little_memory() -> None:
    """The gap has no part of the transfer; 80 MB need 50 MB less memory than they are."""
    with tempfile.TemporaryDirectory(prefix="edgectl-links-") as folder:
        small, middle, large, warm = run_moves(Path(folder))
    assert middle["bound_s"] * 0.9 < middle["transfer_s"] < middle["bound_s"] * 1.25 + patience(1.5)
    assert middle["gap_s"] < small["gap_s"] + middle["transfer_s"] / 2 + patience(0.5)
    assert middle["age_s"] > middle["transfer_s"] + middle["gap_s"] / 2
    assert warm["transfer_s"] > middle["bound_s"] * 0.9
    assert warm["gap_s"] < patience(0.5)
    assert large["peak_kib"] - small["peak_kib"] < 48 * 1024
