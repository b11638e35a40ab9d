# SPDX-License-Identifier: Apache-2.0
"""The lease of a fleet on one real host: one manager at a time changes it."""

import time
from typing import Any

import pytest

from edgectl.agent.supervise import lease_rules
from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost

BOOT, LATER_BOOT = "boot-1", "boot-2"


def a_claim(holder: str = "ana", session: str = "s1", *, ttl: float = 30.0, **fields: Any) -> dict[str, Any]:
    return {
        "holder": holder,
        "session": session,
        "who": f"{holder}@lab",
        "verb": "apply",
        "ttl_s": ttl,
        "watch": None,
        "take_over": False,
    } | fields


def claim(host: AgentHost, *who: str, **fields: Any) -> dict[str, Any]:
    return host.ask("lease", action="claim", lease=a_claim(*who, **fields), end_watch=False)


def signature(epoch: int, holder: str = "ana", session: str = "s1") -> dict[str, Any]:
    return {"holder": holder, "session": session, "epoch": epoch}


def start(host: AgentHost, signed: dict[str, Any] | None, *, generation: int = 1) -> dict[str, Any]:
    more: dict[str, Any] = {} if signed is None else {"lease": signed}
    spec = {
        "command": "exec sleep 600",
        "runtime": "process",
        "stop": {"signal": "TERM", "grace_s": 2.0, "preset": None},
        "restart": "never",
        "log": {"max_bytes": 100_000, "files": 2},
        "limits": {"cpu": None, "memory": None},
        "spec_hash": "h",
    }
    return host.ask("start", task="slam", instance=f"i{generation}", generation=generation, spec=spec, **more)


def test_one_manager_at_a_time_changes_the_host(host: AgentHost) -> None:
    assert claim(host) == {"state": "granted", "epoch": 1, "watch": None}
    told = claim(host, "ben", "s2")
    assert (told["state"], told["who"], told["verb"]) == ("held", "ana@lab", "apply")
    assert 0 < told["left_s"] <= 30
    for wrong in (None, signature(1, "ben", "s2"), signature(0), signature(1, "ana", "older")):
        with pytest.raises(RefusedError, match=r"fleet.*nothing was done"):
            start(host, wrong)
    assert host.entry("slam") is None
    assert start(host, signature(1))["state"] == "started"
    host.ask("lease", action="release", lease=signature(1), end_watch=False)
    assert claim(host, "ben", "s2")["epoch"] == 2
    with pytest.raises(RefusedError, match="ben@lab has taken the fleet"):
        host.stop("slam", lease=signature(1))
    assert host.stop("slam", lease=signature(2, "ben", "s2"))["state"] == "stopped"


def test_a_thawed_manager_whose_lease_ran_out_does_nothing_even_where_nobody_took_it(host: AgentHost) -> None:
    assert claim(host, ttl=0.2)["epoch"] == 1
    time.sleep(0.25)
    for _ in range(2):
        with pytest.raises(RefusedError, match="the lease of the fleet has run out"):
            start(host, signature(1))
        with pytest.raises(RefusedError, match="run out"):
            host.ask("lease", action="renew", lease=signature(1), end_watch=False)
    assert claim(host, "ben", "s2")["epoch"] == 2


def test_each_change_and_each_renewal_extends_the_lease(host: AgentHost) -> None:
    claim(host, ttl=1.5)
    until = time.monotonic() + 2.5
    while time.monotonic() < until:
        host.ask("lease", action="renew", lease=signature(1), end_watch=False)
        time.sleep(0.2)
    assert claim(host, "ben", "s2")["state"] == "held"


def test_the_next_hold_of_the_same_manager_replaces_its_dead_predecessor(host: AgentHost) -> None:
    claim(host)
    assert claim(host)["epoch"] == 1  # the same hold, once more
    assert claim(host, "ana", "s2")["epoch"] == 2
    with pytest.raises(RefusedError, match="has taken the fleet"):
        start(host, signature(1))


def test_a_probe_claims_before_it_measures(host: AgentHost) -> None:
    assert host.ask("probe", window_s=0.05, lease=a_claim())["lease"]["state"] == "granted"
    reply = host.ask("probe", window_s=0.05, lease=a_claim("ben", "s2"))
    assert (reply["lease"]["state"], reply["op"]) == ("held", "probe")
    assert "lease" not in host.ask("probe", window_s=0.05)


def test_a_second_watch_is_told_of_the_first_and_may_take_over(host: AgentHost) -> None:
    watch = {"every_s": 10.0, "digest": "abc"}
    claim(host, watch=watch)
    assert (
        claim(host, "ben", "s2", watch=watch)["state"] == "watched"
    )  # also while the first one holds the fleet
    host.ask("lease", action="release", lease=signature(1), end_watch=False)
    told = claim(host, "ben", "s2", watch=watch)
    assert (told["state"], told["who"], told["every_s"], told["digest"]) == (
        "watched",
        "ana@lab",
        10.0,
        "abc",
    )
    assert claim(host, "ben", "s2")["watch"]["who"] == "ana@lab"  # a person's command is told and goes on
    host.ask("lease", action="release", lease=signature(2, "ben", "s2"), end_watch=True)
    assert claim(host, "ben", "s3", watch=watch)["state"] == "watched"  # it was not ben's to remove
    assert claim(host, "ben", "s3", watch=watch, take_over=True)["state"] == "granted"
    host.ask("lease", action="release", lease=signature(3, "ben", "s3"), end_watch=True)
    assert claim(host, watch=watch)["watch"] is None


def test_after_a_boot_one_lease_passes_and_older_requests_are_void() -> None:
    record = lease_rules.build_grant({}, a_claim(), 1000.0, BOOT)
    assert (
        lease_rules.find_fault(record, signature(1), 1.0, LATER_BOOT) == "the lease of the fleet has run out"
    )
    ben = a_claim("ben", "s2")
    refused = lease_rules.find_refusal(record, {}, ben, 10.0, LATER_BOOT)
    assert refused is not None
    assert refused["left_s"] == 20.0
    assert lease_rules.find_refusal(record, {}, ben, 30.0, LATER_BOOT) is None
    assert lease_rules.find_refusal(record, {}, a_claim(session="s9"), 10.0, LATER_BOOT) is None
    assert lease_rules.find_refusal(dict(record, until=0.0), {}, ben, 10.0, LATER_BOOT) is None


@pytest.mark.parametrize(("every", "gone_after"), [(1.0, 31.0), (10.0, 40.0), (60.0, 180.0)])
def test_a_watch_is_gone_after_three_cycles(every: float, gone_after: float) -> None:
    note = lease_rules.build_note(a_claim(watch={"every_s": every}), 100.0, BOOT)
    assert lease_rules.is_fresh(note, 100.0 + gone_after - 0.1, BOOT)
    assert not lease_rules.is_fresh(note, 100.0 + gone_after, BOOT)
    assert not lease_rules.is_fresh(note, 100.0, LATER_BOOT)


def test_a_host_tells_whether_another_manager_was_granted_the_fleet_since(host: AgentHost) -> None:
    def grants() -> tuple[object, ...]:
        told = host.ask("probe", window_s=0.05)["grants"]
        return told["holder"], told["epoch"], told["other_epoch"]

    assert grants() == ("", 0, 0)
    for number, (holder, other) in enumerate([("ana", 0), ("ana", 0), ("ben", 2), ("ben", 2), ("ana", 4)], 1):
        claim(host, holder, f"s{number}")
        assert grants() == (holder, number, other)
        signed = signature(number, holder, f"s{number}")
        host.ask("lease", action="release", lease=signed, end_watch=False)
    assert lease_rules.find_other_epoch({"holder": "ana", "epoch": 5, "other_epoch": 4}, "ben") == 5


def test_a_host_tells_which_hosts_other_managers_have_and_its_names_there(host: AgentHost) -> None:
    def told_to(manager: str) -> tuple[object, object]:
        told = host.ask("probe", window_s=0.05, manager=manager)["grants"]
        return told["hosts"], told["names"]

    def claim_and_release(holder: str, name: str, *hosts: str) -> None:
        epoch = claim(host, holder, "s", name=name, hosts=list(hosts))["epoch"]
        host.ask("lease", action="release", lease=signature(epoch, holder, "s"), end_watch=False)

    claim_and_release("ana", "edge1", "edge1", "edge3")
    assert told_to("ana") == ([], [])
    assert told_to("ben") == (["edge1", "edge3"], ["edge1"])
    claim_and_release("ben", "jetson-a", "jetson-a")
    assert told_to("ana") == (["jetson-a"], ["jetson-a"])
    assert told_to("eva") == (["edge1", "edge3", "jetson-a"], ["edge1", "jetson-a"])
    claim_and_release("ana", "edge1", "edge1")  # she has removed edge3
    assert told_to("ben") == (["edge1"], ["edge1"])
    for number in range(10):  # the file of ana, who was here last, is among the eight that stay
        claim_and_release("ana" if number == 9 else f"m{number}", "edge1", "edge1", f"e{number}")
    assert len(told_to("ana")[0]) == 8  # type: ignore[arg-type]


def test_a_list_of_hosts_that_is_too_long_does_not_keep_a_manager_from_the_fleet(host: AgentHost) -> None:
    assert claim(host, name="e0", hosts=[f"edge{number}" for number in range(500)])["state"] == "granted"


def test_of_managers_that_share_an_etcd_the_later_revision_wins_at_once_and_for_ever(host: AgentHost) -> None:
    """Both are one holder; the first one is frozen, or on its way to this host for longer than its lease."""
    assert claim(host, "shared", "a1", manager="ana", revision=5)["epoch"] == 1
    assert claim(host, "shared", "b1", manager="ben", revision=9)["epoch"] == 2
    with pytest.raises(RefusedError, match="has taken the fleet"):
        start(host, signature(1, "shared", "a1"))
    told = claim(host, "shared", "a2", manager="ana", revision=8)
    assert (told["state"], told["who"], told["revision"]) == ("held", "shared@lab", 9)
    # One without etcd is another holder to them, and they to it.
    assert claim(host, "eva", "e1")["state"] == "held"
    host.ask("lease", action="release", lease=signature(2, "shared", "b1"), end_watch=False)
    assert claim(host, "eva", "e1")["epoch"] == 3
    assert claim(host, "shared", "b2", manager="ben", revision=12)["state"] == "held"
    host.ask("lease", action="release", lease=signature(3, "eva", "e1"), end_watch=False)
    # What was seen before it is not forgotten, and epochs go on; an etcd that was set up anew begins at 1.
    assert claim(host, "shared", "a3", manager="ana", revision=8)["revision"] == 9
    assert claim(host, "shared", "b2", manager="ben", revision=12)["epoch"] == 4
    host.ask("lease", action="release", lease=signature(4, "shared", "b2"), end_watch=False)
    assert claim(host, "new", "c1", manager="ana", revision=1)["epoch"] == 5


def test_two_watches_that_share_an_etcd_are_told_apart(host: AgentHost) -> None:
    watch = {"every_s": 10.0, "digest": "abc"}
    claim(host, "shared", "a1", manager="ana", revision=1, watch=watch)
    assert claim(host, "shared", "b1", manager="ben", revision=2, watch=watch)["state"] == "watched"
    assert claim(host, "shared", "a2", manager="ana", revision=3, watch=watch)["state"] == "granted"
    signed = {**signature(2, "shared", "a2"), "manager": "ana"}
    host.ask("lease", action="release", lease=signed, end_watch=True)
    assert claim(host, "shared", "b1", manager="ben", revision=4, watch=watch)["state"] == "granted"
