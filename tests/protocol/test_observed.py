# SPDX-License-Identifier: Apache-2.0
"""What is seen on real hosts is a behaviour of the model; what nobody may do is none."""

from pathlib import Path

import pytest

from tests.protocol.observed import Observation, check_observation, list_observable_faults, observe_fault
from tests.protocol.recorder import Event, Group, add_events

FAULTS = {each.name: each for each in list_observable_faults()}


def grant(host: str, session: str, manager: str) -> frozenset[Event]:
    return frozenset({Event(kind="grant", host=host, session=session, holder=manager, manager=manager)})


def change(kind: str, host: str, task: str = "slam") -> frozenset[Event]:
    return frozenset({Event(kind=kind, host=host, task=task)})


ANA_HAS_BOTH = [grant("y", "s1", "ana"), grant("x", "s1", "ana")]
# Name -> what was seen, and whether the model allows it.
CASES = {
    "a move": ([*ANA_HAS_BOTH, change("start", "y"), grant("y", "s2", "ana"), grant("x", "s2", "ana"),
                change("stop", "y"), change("start", "x")], True),
    "a start on a second host before the stop on the first": (
        [*ANA_HAS_BOTH, change("start", "y"), grant("y", "s2", "ana"), grant("x", "s2", "ana"),
         change("start", "x"), change("stop", "y")], False),
    "a start on a host that nobody was granted": ([grant("y", "s1", "ana"), change("start", "x")], False),
    "a stop after which the other manager starts": (
        [*ANA_HAS_BOTH, change("start", "y"), grant("y", "s2", "ben"), grant("x", "s2", "ben"),
         change("stop", "y"), change("start", "x")], True),
    "a start by a manager that was told of the first instance": (
        [*ANA_HAS_BOTH, change("start", "y"), grant("y", "s2", "ben"), grant("x", "s2", "ben"),
         change("start", "x")], False),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_model_allows_what_a_manager_may_do(name: str, tmp_path: Path) -> None:
    looks, allowed = CASES[name]
    fits, verdict = check_observation(Observation(fault=name, seed=0, looks=looks, gaps=[]), tmp_path)
    assert fits is allowed, verdict.text[-2000:]


def test_what_is_seen_later_is_not_taken_for_what_happened_later() -> None:
    """The machine was busy between the looks at two hosts, while a task was stopped on one and started on the other."""
    groups: list[Group] = []
    add_events(groups, change("start", "x"), 0.1, 1.0)
    add_events(groups, change("stop", "y"), 0.0, 1.2)
    assert groups == [(change("start", "x") | change("stop", "y"), 1.2)]
    add_events(groups, change("start", "y"), 1.2, 1.3)
    add_events(groups, change("start", "y"), 1.2, 1.4)
    assert [events for events, _ in groups[1:]] == [change("start", "y")] * 2


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["two managers with etcd: the network is split, both act at once"])
def test_a_fault_on_real_hosts_is_a_behaviour_of_the_model(name: str, tmp_path: Path) -> None:
    seen = observe_fault(FAULTS[name], 1, sample=True)
    assert seen.gaps == []
    assert min(seen.count("grant"), seen.count("start")) >= 3
    fits, verdict = check_observation(seen, tmp_path)
    assert fits, f"{[sorted(look) for look in seen.looks]}\n{verdict.text[-2000:]}"
