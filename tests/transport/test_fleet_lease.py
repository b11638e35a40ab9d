# SPDX-License-Identifier: Apache-2.0
"""The lease of a manager that stands still: over before the host's own, whatever the host was slow with."""

import pytest

from edgectl.agent.supervise import lease_rules
from edgectl.transport.fleet_lease import LEASE_S, FleetLease, LeaseLostError

BOOT = "boot-1"


class Clock:
    """Seconds of the manager; those of a host began elsewhere."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now

    @property
    def of_host(self) -> float:
        return self.now + 5e4


def claim_late(
    lease: FleetLease, host: str, clock: Clock, delay_s: float, record: dict[str, object]
) -> dict[str, object]:
    """The record of a host that takes the claim ``delay_s`` after it was sent; the clock does not move on."""
    claim, at = lease.build_claim(host), clock.of_host + delay_s
    refusal = lease_rules.find_refusal(record, {}, claim, at, BOOT)
    granted = record if refusal else lease_rules.build_grant(record, claim, at, BOOT)
    lease.take_reply(host, refusal or {"state": "granted", "epoch": granted["epoch"], "watch": None})
    return granted


def a_lease(name: str, clock: Clock) -> FleetLease:
    return FleetLease(holder=name, session=f"{name}-1", who=f"{name}@lab", verb="apply", clock=clock)


@pytest.mark.parametrize("delay_s", [0.0, 8.0, 29.0])
def test_a_starved_host_refuses_others_for_as_long_as_it_was_late(delay_s: float) -> None:
    """Its refusal is right: it cannot know that the manager stopped counting before."""
    clock = Clock()
    ana, ben = a_lease("ana", clock), a_lease("ben", clock)
    record = claim_late(ana, "edge1", clock, delay_s, {})
    signature = ana.sign("edge1")
    clock.now += LEASE_S
    with pytest.raises(LeaseLostError, match="the lease of the fleet on edge1 has run out: nothing was sent"):
        ana.sign("edge1")
    if delay_s:
        claim_late(ben, "edge1", clock, 0.0, record)
        assert ben.refusals["edge1"].left_s == delay_s
        assert (
            lease_rules.find_fault(record, signature, clock.of_host, BOOT) == ""
        )  # of a request sent before
    clock.now += delay_s
    record = claim_late(ben, "edge1", clock, 0.0, record)
    assert (ben.refusals, ben.list_granted()) == ({}, ("edge1",))
    # What ana had signed before it froze arrives now.
    assert lease_rules.find_fault(record, signature, clock.of_host, BOOT) == "ben@lab has taken the fleet"


def test_a_renewal_counts_from_when_it_was_sent_and_its_late_reply_mends_nothing() -> None:
    clock = Clock()
    ana = a_lease("ana", clock)
    record = claim_late(ana, "edge1", clock, 0.0, {})
    clock.now += 10.0
    sent = ana.now()
    assert lease_rules.find_fault(record, ana.sign("edge1"), clock.of_host + 15.0, BOOT) == ""
    record = lease_rules.extend_record(record, clock.of_host + 15.0)
    clock.now += 31.0  # frozen; the reply is read after the thaw
    ana.extend("edge1", sent)
    with pytest.raises(LeaseLostError):
        ana.sign("edge1")
    assert lease_rules.compute_left_s(record, clock.of_host, BOOT) == 14.0


def test_a_lapse_on_any_host_that_answers_stops_everything_and_on_a_silent_one_only_itself() -> None:
    clock = Clock()
    ana = a_lease("ana", clock)
    for host in ("edge1", "edge2"):
        claim_late(ana, host, clock, 0.0, {})
    clock.now += 20.0
    ana.extend("edge1", ana.now())
    clock.now += 15.0
    with pytest.raises(LeaseLostError, match="on edge2 has run out"):
        ana.sign("edge1")
    ana.note_silent("edge2")
    assert ana.sign("edge1")["epoch"] == 1
    with pytest.raises(LeaseLostError, match="on edge2 has run out"):
        ana.sign("edge2")
