# SPDX-License-Identifier: Apache-2.0
"""State of a task after the end of its command, and restart back-off, without waiting."""

import pytest

from edgectl.agent.link.fast_json import Document
from edgectl.agent.supervise import restart_policy


def delays(count: int, *, apart: float = 1.0, jitter: float = 0.0) -> list[float | None]:
    """Delays after runs that fail every ``apart`` seconds."""
    history: list[float] = []
    found = []
    for number in range(count):
        found.append(restart_policy.compute_delay(history, number * apart, jitter))
        history.append(number * apart)
    return found


def test_doubles_and_gives_up_after_five_restarts_in_ten_minutes() -> None:
    assert delays(6) == [1.0, 2.0, 4.0, 8.0, 16.0, None]


def test_grows_to_five_minutes_where_failures_are_rare() -> None:
    # Every 151 s: at most four restarts fall within 600 s before each failure, so restarts continue.
    assert delays(11, apart=151.0) == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 300.0, 300.0]


def test_jitter_is_a_quarter() -> None:
    assert delays(1, jitter=1.0) == [1.25]
    assert delays(1, jitter=-1.0) == [0.75]


def test_health_is_forgiven_at_600_seconds() -> None:
    assert restart_policy.select_history([1.0, 2.0], 599.9) == [1.0, 2.0]
    assert restart_policy.select_history([1.0, 2.0], 600.0) == []


def test_boundary_of_the_window() -> None:
    assert restart_policy.compute_delay([0.0, 1.0, 2.0, 3.0, 4.0], 599.9, 0.0) is None
    assert restart_policy.compute_delay([0.0, 1.0, 2.0, 3.0, 4.0], 600.0, 0.0) == 32.0


CRASH: Document = {"exit_code": 3, "detail": "exited with 3"}
CLEAN: Document = {"exit_code": 0, "detail": "exited with 0"}
LOST: Document = {"exit_code": None, "detail": "ended"}
KILLED: Document = {"exit_code": 137, "detail": "killed"}


@pytest.mark.parametrize(
    ("spec", "outcome", "state", "given_up"),
    [
        ({}, CRASH, "", None),
        ({}, KILLED, "", None),
        ({}, LOST, "", None),
        ({}, CLEAN, "failed", False),
        ({"restart": "always"}, CLEAN, "", None),
        ({"restart": "never"}, CRASH, "failed", True),
        ({"restart": "never"}, CLEAN, "failed", True),
        ({"kind": "job"}, CLEAN, "completed", None),
        ({"kind": "job", "restart": "always"}, CLEAN, "completed", None),
        ({"kind": "job"}, CRASH, "", None),
        ({"kind": "job"}, LOST, "", None),
        ({"kind": "job", "restart": "never"}, CRASH, "failed", True),
    ],
)
def test_an_end_is_final_or_restarted(
    spec: Document, outcome: Document, state: str, given_up: bool | None
) -> None:
    """An empty state: it is restarted."""
    found = restart_policy.decide_end(spec, outcome, [], False)
    assert (found or {}).get("state", "") == state
    assert (found or {}).get("given_up") == given_up
    assert found is None or {**found, **outcome} == found, "the exit is recorded with the state"


@pytest.mark.parametrize("kind", ["service", "job"])
def test_a_clean_exit_that_another_has_caused_is_a_failure(kind: str) -> None:
    assert restart_policy.decide_end({"kind": kind}, CLEAN, [], False, True) is None
    never = restart_policy.decide_end({"kind": kind, "restart": "never"}, CLEAN, [], False, True)
    assert never == {**CLEAN, "state": "failed", "given_up": True}
    stopped = restart_policy.decide_end({"kind": kind}, CLEAN, [], True, True)
    assert stopped == {**CLEAN, "state": "stopped", "left": []}


@pytest.mark.parametrize("spec", [{}, {"restart": "always"}, {"restart": "never"}, {"kind": "job"}])
def test_what_was_stopped_or_cannot_be_ended_is_never_restarted(spec: Document) -> None:
    assert restart_policy.decide_end(spec, CRASH, [], True) == {**CRASH, "state": "stopped", "left": []}
    assert restart_policy.decide_end(spec, CRASH, [7], True) == {**CRASH, "state": "stopped", "left": [7]}
    stuck = {"state": "failed", "left": [7], "exit_code": 3, "detail": "processes cannot be stopped: [7]"}
    assert restart_policy.decide_end(spec, CRASH, [7], False) == stuck
