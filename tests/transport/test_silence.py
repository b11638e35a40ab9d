# SPDX-License-Identifier: Apache-2.0
"""A host that lets a deadline pass costs a run that deadline once, whatever else is to be done there."""

import pytest

from edgectl.errors import ConnectError, DeadlineError
from edgectl.transport.silence import SilenceTransport, SilentHosts
from tests.builders import an_edge
from tests.transport.test_pool import CountingTransport


def send(transport: SilenceTransport, name: str = "edge1") -> bytes:
    with transport.connect(an_edge(name), timeout=15.0) as session:
        return session.run("c", b"in", timeout=1.0).stdout


def test_a_silent_host_is_not_asked_again_and_others_are() -> None:
    inner = CountingTransport()
    run = SilenceTransport(inner, SilentHosts())
    with run.connect(an_edge("edge1"), timeout=15.0) as open_before:
        inner.fault = DeadlineError("no answer within 40 s")
        with pytest.raises(DeadlineError, match="no answer within 40 s"):
            send(run)
        inner.fault = None
        for ask in (lambda: send(run), lambda: open_before.run("c", b"in", timeout=1.0)):
            with pytest.raises(DeadlineError, match="no answer within 40 s; not asked again in this run"):
                ask()
    assert inner.opened == ["edge1", "edge1"]
    assert send(run, "edge2") == b"in"


@pytest.mark.parametrize(("seconds", "again"), [(15.0, False), (0.1, True)])
def test_a_login_that_is_not_answered_is_silence_and_a_refused_one_is_not(
    seconds: float, again: bool
) -> None:
    inner, now = CountingTransport(), iter([0.0, seconds, 20.0, 20.1])
    run = SilenceTransport(inner, SilentHosts(), clock=lambda: next(now))
    inner.refusal = ConnectError("no connection")
    with pytest.raises(ConnectError):
        send(run)
    inner.refusal = None
    if again:
        assert send(run) == b"in"
        return
    with pytest.raises(DeadlineError, match="no connection; not asked again"):
        send(run)


def test_what_recovers_asks_a_silent_host_until_it_is_silent_once_more() -> None:
    inner, silent = CountingTransport(), SilentHosts()
    run, recovery = (SilenceTransport(inner, silent, recovers=recovers) for recovers in (False, True))
    inner.fault = DeadlineError("no answer within 40 s")
    with pytest.raises(DeadlineError):
        send(run)
    inner.fault = None
    assert send(recovery) == send(recovery) == b"in"
    with pytest.raises(DeadlineError, match="not asked again in this run"):
        send(run)
    inner.fault = DeadlineError("no answer within 15 s")
    with pytest.raises(DeadlineError, match=r"15 s$"):
        send(recovery)
    for transport in (run, recovery):
        with pytest.raises(DeadlineError, match="not asked again in this run"):
            send(transport)
    assert inner.opened == ["edge1"] * 4
