# SPDX-License-Identifier: Apache-2.0
"""Short form of the interleavings of two managers, and the proof that they find a missing rule."""

import pytest

from edgectl.agent.supervise import lease_rules
from edgectl.transport import fleet_lease
from tests.simulation import two_managers
from tests.simulation.two_managers import DoubledError, Simulation, run_simulations


def test_nothing_is_doubled() -> None:
    assert run_simulations(Simulation, 1, 400) > 1000


@pytest.mark.parametrize("rule", ["find_refusal", "find_fault"])
def test_without_one_of_the_rules_something_is(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lease_rules, rule, lambda *_words: "" if rule == "find_fault" else None)
    monkeypatch.setattr(fleet_lease, "LEASE_S", 1e9)
    with pytest.raises(DoubledError):
        run_simulations(Simulation, 1, 400)


def test_without_the_hosts_of_the_other_manager_something_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(two_managers, "list_unlisted_hosts", lambda _samples: [])
    with pytest.raises(DoubledError):
        run_simulations(Simulation, 1, 400)
