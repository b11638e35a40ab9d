# SPDX-License-Identifier: Apache-2.0
"""Replies about byte counters: what is believed of them, and what a script for root may contain."""

from typing import Any

import pytest

from edgectl.errors import ReplyError
from edgectl.gateway.byte_counters import decode_counters, decode_counters_facts

FACTS: dict[str, Any] = {
    "nft": "/usr/sbin/nft",
    "uid": 1000,
    "addresses": {"robot1": ["10.0.0.5", "fd00::5"]},
}


def test_counters_are_decoded() -> None:
    robot = {"addresses": ["10.0.0.5"], "counted": True, "rx_bytes": 7, "tx_bytes_per_s": 2.5}
    found = decode_counters("edge1", {"state": "installed", "tasks": True, "robots": {"robot1": robot}})
    assert (found.installed, found.tasks, found.robots["robot1"].rx_bytes) == (True, True, 7.0)
    assert not decode_counters("edge1", {"state": "sudo: no"}).installed


@pytest.mark.parametrize(
    "changed",
    [
        {"nft": "/tmp/nft"},
        {"nft": "/usr/sbin/nft; reboot"},
        {"uid": -1},
        {"uid": "0 ALL=(ALL) ALL"},
        {"addresses": {"robot1": ["10.0.0.5; reboot"]}},
        {"addresses": {"robot1": ["$(reboot)"]}},
        {"addresses": {"robot1": ["010.0.0.5"]}},
        {"addresses": {"robot1": ["fe80::1%eth0' }"]}},
    ],
)
def test_nothing_that_a_host_sends_gets_into_a_script_for_root(changed: dict[str, Any]) -> None:
    assert decode_counters_facts(FACTS).uid == 1000
    with pytest.raises(ReplyError):
        decode_counters_facts({**FACTS, **changed})
