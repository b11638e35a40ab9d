# SPDX-License-Identifier: Apache-2.0
"""Whose a name of a ROS 2 graph is, by identifiers; tests/ros asks the same of real nodes."""

import os
import subprocess
from collections.abc import Iterator

import pytest

from edgectl.agent.ros.participants import LEASE_S, Owners, describe_foreign, describe_twice

ME = os.getpid()


def a_gid(pid: int, host: str = "78fd", vendor: str = "010f") -> str:
    return vendor + host + pid.to_bytes(4, "little")[:2].hex() + "aabb" + "00000000" + "00000403"


def an_answer(*ends: tuple[str, float], own: str | None = None) -> dict[str, object]:
    return {"pid": ME, "own": a_gid(ME) if own is None else own, "ends": [list(each) for each in ends]}


@pytest.fixture
def ended() -> Iterator[int]:
    """A process that has ended."""
    with subprocess.Popen(["true"]) as process:
        process.wait()
        yield process.pid


def test_a_node_is_ours_by_its_process_whatever_addresses_its_host_has_had_since() -> None:
    owners = Owners(an_answer((a_gid(ME, host="0000"), 0.0)), {ME})
    assert (list(owners.ours.values()), owners.others, describe_twice("/slam", owners)) == ([ME], False, "")


def test_a_node_of_another_host_is_none_of_ours() -> None:
    owners = Owners(an_answer((a_gid(77, host="1234"), 900.0)), {ME})
    assert owners.others
    assert describe_foreign("/slam", owners) == (
        "node /slam runs on another host, and not as a process of this task"
    )


@pytest.mark.parametrize("age_s", [0.0, LEASE_S - 1.0])
def test_what_may_be_left_of_a_killed_node_of_another_host_is_not_said(age_s: float) -> None:
    """A move away from a host that lost its power leaves one for the time of a lease."""
    owners = Owners(an_answer((a_gid(ME), age_s), (a_gid(77, host="1234"), 900.0)), {ME})
    assert describe_twice("/slam", owners) == ""


def test_a_node_of_another_host_that_stays_is_said() -> None:
    ages = LEASE_S + 1.0, 900.0
    owners = Owners(an_answer((a_gid(ME), ages[0]), (a_gid(77, host="1234"), ages[1])), {ME})
    assert describe_twice("/slam", owners) == "node /slam also runs on another host: its name is used twice"


def test_what_is_left_of_a_killed_node_of_this_host_is_none_of_ours(ended: int) -> None:
    alone = Owners(an_answer((a_gid(ended), 0.0)), {ME})
    assert (alone.others, alone.gone) == (True, True)
    beside = Owners(an_answer((a_gid(ME), 99.0), (a_gid(ended), 99.0)), {ME})
    assert describe_twice("/slam", beside) == ""


@pytest.mark.parametrize("own", ["", a_gid(ME, vendor="0110"), a_gid(ME + 1)])
def test_where_identifiers_state_no_process_only_numbers_count(own: str) -> None:
    one = Owners(an_answer((a_gid(77), 900.0), own=own), {ME})
    assert (one.ours, one.others, describe_twice("/slam", one)) == ({}, False, "")
    two = Owners(an_answer((a_gid(77), 900.0), (a_gid(78), 900.0), own=own), {ME})
    assert describe_twice("/slam", two) == "node /slam is in the graph more than once: its name is used twice"
