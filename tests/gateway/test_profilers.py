# SPDX-License-Identifier: Apache-2.0
"""Replies about profilers as values; a missing or invalid reply affects no other host."""

import pytest

from edgectl.errors import ConnectError, ReplyError
from edgectl.gateway import profilers
from edgectl.model.profiler import ProfilerState
from edgectl.transport.fake import FakeTransport
from tests.builders import a_robot, an_edge, an_inventory, some_tasks

Document = dict[str, object]


def a_reply(**fields: object) -> Document:
    return {
        "state": "running", "pid": 71, "age_s": 60.5, "every_s": 1.0, "period_s": 2.0, "samples": 30, "sample_age_s": 0.4,
        "used_cores": 0.002, "used_bytes": 11_000_000, "ttl_s": 3600.0, "ttl_left_s": 3599.0, "current": False, **fields,
    }  # fmt: skip


def test_every_field_is_taken_over() -> None:
    found = profilers.decode_profiler("edge1", a_reply())
    assert (found.host, found.state, found.pid, found.age) == ("edge1", ProfilerState.RUNNING, 71, 60.5)
    assert (found.every, found.period, found.samples, found.sample_age) == (1.0, 2.0, 30, 0.4)
    assert (found.used["cpu"], found.used["memory"], found.ttl, found.ttl_left, found.current) == (
        0.002,
        11e6,
        3600.0,
        3599.0,
        False,
    )
    assert profilers.decode_profiler("edge1", a_reply(sample_age_s=None, ttl_left_s=-0.5)).ttl_left == 0.0


def test_one_that_is_gone_says_why_and_nothing_else() -> None:
    found = profilers.decode_profiler(
        "edge1", {"state": "not-running", "pid": 0, "detail": "it was\x1b[2J killed"}
    )
    assert (found.state.alive, found.detail) == (False, "it was\\x1b[2J killed")


@pytest.mark.parametrize(
    "wrong",
    [
        {"state": "dancing"},
        {"state": "unreachable"},
        {"state": None},
        {"pid": -1},
        {"samples": 1.5},
        {"age_s": "x"},
    ],
)
def test_nonsense_is_refused(wrong: Document) -> None:
    with pytest.raises(ReplyError):
        profilers.decode_profiler("edge1", a_reply(**wrong))


def test_hosts_are_asked_for_their_own_links_and_answer_in_order() -> None:
    requests: list[Document] = []

    def edge(request: Document) -> Document:
        requests.append(request)
        return a_reply(state="started")

    def gone(_request: Document) -> Document:
        raise ConnectError("no route", hint="look at the cable")

    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"))
    transport = FakeTransport({"edge1": edge, "edge2": gone, "robot1": lambda _: a_reply(state="dancing")})
    found = profilers.start_profilers(
        list(inventory.hosts.values()), inventory, some_tasks(), transport, every=2.0, ttl=60.0, timeout=5.0
    )
    assert [(each.host, each.state.value) for each in found] == [
        ("edge1", "started"),
        ("edge2", "unreachable"),
        ("robot1", "unreachable"),
    ]
    assert (found[1].error, found[1].hint) == ("no route", "look at the cable")
    assert "dancing" in found[2].error
    (sent,) = requests
    assert (sent["op"], sent["every_s"], sent["ttl_s"]) == ("profiler-start", 2.0, 60.0)
    assert isinstance(sent["links"], list)
    assert len(sent["links"]) == 1
