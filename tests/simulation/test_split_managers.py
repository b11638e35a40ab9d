# SPDX-License-Identifier: Apache-2.0
"""Short form of the interleavings on split networks, and the proof that they find what is left out."""

import pytest

from tests.simulation.split_managers import SimulatedTerm, SplitSimulation
from tests.simulation.two_managers import DoubledError, run_simulations


def test_nothing_is_doubled() -> None:
    assert run_simulations(SplitSimulation, 1, 200) > 400


def test_without_announced_starts_something_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SplitSimulation, "announces", False)
    with pytest.raises(DoubledError):
        run_simulations(SplitSimulation, 1, 200)


def test_without_the_comparison_of_the_holder_something_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def save(self: SimulatedTerm, places: dict[str, frozenset[str]]) -> None:
        self.simulation.etcd.places = places

    monkeypatch.setattr(SimulatedTerm, "save", save)
    with pytest.raises(DoubledError):
        run_simulations(SplitSimulation, 1, 200)
