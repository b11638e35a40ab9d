# SPDX-License-Identifier: Apache-2.0
"""Replies of hosts as samples; an invalid reply costs its host the sample."""

import copy
import json
import math
import random
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any, cast

import pytest

from edgectl.errors import ReplyError
from edgectl.formats.kinds import SNAPSHOT_KIND
from edgectl.gateway.link_observations import JoinedLinks, LinkEnds, join_link_ends
from edgectl.gateway.probe_reply import (
    ASSUMED_BYTES_PER_S,
    ReplyContext,
    build_host_sample,
    decode_host_sample,
    decode_probe,
    list_done_tasks,
)
from edgectl.gateway.replies import ProbeReply
from edgectl.model.inventory import BaseLoad, Capacity, Host
from edgectl.model.resource import NETWORK
from edgectl.model.snapshot import CapacitySource, HostSample, HostStatus, TaskState, TrafficSource
from tests.builders import NOW, a_robot, a_snapshot, an_edge

Document = dict[str, object]
SLICE = an_edge("edge1", capacity=Capacity(cpu=2.0, memory=1e9), base=BaseLoad(cpu=0.25, memory=1e8))


def a_task(**fields: object) -> Document:
    return {
        "state": "ready",
        "pid": 71,
        "age_s": 60.0,
        "used_cores": 0.5,
        "used_bytes": 2e8,
        "rx_bytes_per_s": 1000.0,
        "tx_bytes_per_s": 500.0,
        "links": {"robot1": 1500.0},
        "instance": "i1",
        "spec_hash": "h1",
        "generation": 3,
        "managed": True,
        "restarts": 1,
        "exit_code": None,
        "detail": "",
        **fields,
    }


def a_document(**fields: object) -> Document:
    return {
        "v": 1,
        "op": "probe",
        "host": "edge1",
        "python": "3.6.15",
        "psutil": True,
        "boot_id": "boot-1",
        "wall": NOW + 100.0,
        "window_s": 0.5,
        "cpu": {"cores": 4, "used_cores": 1.5},
        "memory": {"total_bytes": 8e9, "used_bytes": 3e9},
        "load_1m": 0.7,
        "temperature_c": None,
        "gpu_share": None,
        "interfaces": {"eth0": {"rx_bytes_per_s": 1.0, "tx_bytes_per_s": 2.0, "speed_bytes_per_s": 125e6}},
        "links": {
            "robot1": {
                "rx_bytes_per_s": 2000.0,
                "tx_bytes_per_s": 600.0,
                "rtt_ms": 1.2,
                "interface": "eth0",
                "reachable": True,
            }
        },
        "tasks": {"slam": a_task()},
        "checks": {},
        **fields,
    }


def decode_document(document: Document, host: Host | None = None, **context: Any) -> HostSample:
    settings: dict[str, Any] = {"robots": ("robot1",), "answered_at": NOW, "checked": {"slam"}, **context}
    return decode_host_sample(document, ReplyContext(host=host or an_edge("edge1"), **settings))


def test_a_device_is_what_it_says() -> None:
    sample = decode_document(a_document())
    assert sample.status is HostStatus.OK
    assert sample.measured
    assert (sample.usage["cpu"].capacity, sample.usage["cpu"].used) == (4.0, 1.5)
    assert (sample.usage["memory"].capacity, sample.usage["memory"].used) == (8e9, 3e9)
    task = sample.tasks["slam"]
    assert (task.state, task.pid, task.started_at, task.used["network"]) == (
        TaskState.READY,
        71,
        NOW - 60.0,
        1500.0,
    )
    assert (task.instance, task.spec_hash, task.generation, task.restarts) == ("i1", "h1", 3, 1)


def test_an_inactive_copy_is_no_running_task() -> None:
    copy = a_task(role="standby", switching=False, instance="i2", generation=5)
    sample = decode_document(a_document(tasks={"slam": a_task(role="active"), "map": copy}))
    assert (list(sample.tasks), list(sample.standbys)) == (["slam"], ["map"])
    assert sample.standbys["map"].instance == "i2"
    assert sample.generations == {"map": 5}


@pytest.mark.parametrize(
    "fields",
    [{"role": "standby", "switching": True}, {"role": "active"}, {"role": 7}, {"role": "standby", "pid": "x", "switching": 1}],
)  # fmt: skip
def test_what_may_be_active_counts_as_active(fields: dict[str, object]) -> None:
    sample = decode_document(a_document(tasks={"slam": a_task(**fields)}))
    assert list(sample.tasks) == ["slam"]
    assert not sample.standbys
    assert sample.tasks["slam"].switching is (fields.get("switching") is True)


def test_a_copy_whose_entry_cannot_be_read_stays_a_copy() -> None:
    sample = decode_document(a_document(tasks={"slam": a_task(role="standby", pid="x")}))
    assert not sample.tasks
    assert sample.standbys["slam"].detail.startswith("its entry cannot be read")


def test_the_load_of_a_slice_includes_its_copies() -> None:
    copy = a_task(role="standby", used_cores=0.5, used_bytes=2e8)
    sample = decode_document(a_document(tasks={"map": copy}), SLICE)
    assert sample.usage["cpu"].used == 0.75
    assert sample.usage["memory"].used == 3e8


def test_a_check_for_the_end_of_a_task_is_not_about_its_copy() -> None:
    document = a_document(tasks={"slam": a_task(role="standby")}, checks={"slam": {"exit": 0, "detail": ""}})
    sample = decode_document(document)
    assert sample.standbys["slam"].state is TaskState.READY
    assert sample.usage["cpu"].used == 1.5


def test_a_clock_is_shown_and_not_trusted() -> None:
    for wall in (NOW + 86400.0, 0.0, NOW - 10 * 365 * 86400.0):
        sample = decode_document(a_document(wall=wall))
        assert sample.device.clock_skew_s == wall - NOW
        assert sample.tasks["slam"].started_at == NOW - 60.0


def test_a_slice_is_its_base_and_its_own_tasks() -> None:
    """cpu: .25 + .5 = .75 of 2; memory: 1e8 + 2e8 = 3e8 of 1e9; link: the task's 1500, not the machine's
    2600.
    """
    sample = decode_document(a_document(), SLICE)
    assert sample.measured
    assert (sample.usage["cpu"].capacity, sample.usage["cpu"].used) == (2.0, 0.75)
    assert (sample.usage["memory"].capacity, sample.usage["memory"].used) == (1e9, 3e8)
    assert sample.links["robot1"].used_bytes_per_s == 1500.0


def test_a_task_that_is_done_keeps_its_pid_and_frees_its_load() -> None:
    """gamma 1.5 - .5 = 1.0 cores; 3e9 - 2e8 = 2.8e9 bytes; link 2600 - 1500 = 1100."""
    sample = decode_document(a_document(checks={"slam": {"exit": 0, "timed_out": False, "output": ""}}))
    assert (sample.tasks["slam"].state, sample.tasks["slam"].pid) == (TaskState.COMPLETED, 71)
    assert sample.measured
    assert sample.usage["cpu"].used == 1.0
    assert sample.usage["memory"].used == 2.8e9
    assert sample.links["robot1"].used_bytes_per_s == 1100.0


@pytest.mark.parametrize("check", [{"exit": 1}, {"exit": None, "timed_out": True}, {}])
def test_a_check_that_does_not_say_yes_changes_nothing(check: Document) -> None:
    assert decode_document(a_document(checks={"slam": check})).tasks["slam"].state is TaskState.READY


@pytest.mark.parametrize(
    ("context", "speed", "expected"),
    [
        ({"declared": {"robot1": 5e6}, "measured": {"robot1": 4e6}}, 125e6, (5e6, CapacitySource.DECLARED)),
        ({"measured": {"robot1": 4e6}}, 125e6, (4e6, CapacitySource.MEASURED)),
        ({}, 125e6, (125e6, CapacitySource.NIC)),
        ({}, None, (ASSUMED_BYTES_PER_S, CapacitySource.ASSUMED)),
        ({}, 0.0, (ASSUMED_BYTES_PER_S, CapacitySource.ASSUMED)),
    ],
)
def test_a_links_capacity_is_declared_measured_nominal_or_assumed(
    context: dict[str, Any], speed: float | None, expected: tuple[float, CapacitySource]
) -> None:
    interfaces = {"eth0": {"rx_bytes_per_s": 0.0, "tx_bytes_per_s": 0.0, "speed_bytes_per_s": speed}}
    link = decode_document(a_document(interfaces=interfaces), **context).links["robot1"]
    assert (link.capacity_bytes_per_s, link.capacity_source) == expected


def test_a_robot_that_cannot_be_reached_is_a_dead_link_unless_it_is_never_asked() -> None:
    document = a_document(
        links={"robot1": {"rx_bytes_per_s": 0.0, "tx_bytes_per_s": 0.0, "reachable": False}}
    )
    assert decode_document(document, declared={"robot1": 5e6}).links["robot1"].capacity_bytes_per_s == 0.0
    assert (
        decode_document(document, blind=frozenset({"robot1"})).links["robot1"].capacity_bytes_per_s
        == ASSUMED_BYTES_PER_S
    )


def test_a_link_that_was_not_asked_for_is_left_out_and_a_missing_one_stays_missing() -> None:
    links = {"robot9": {"rx_bytes_per_s": 0.0, "tx_bytes_per_s": 0.0}}
    assert decode_document(a_document(links=links)).links == {}


def test_a_link_is_partly_seen_where_the_host_says_so_or_a_living_task_of_the_robot_is() -> None:
    def find_gap(robots: tuple[str, ...] = ("robot1",), state: str = "ready", link: str = "") -> str:
        document = a_document(
            links={"robot1": {"partial": link}}, tasks={"slam": a_task(partial="udp unseen", state=state)}
        )
        sample = decode_document(document, robots=("robot1",), robots_of={"slam": robots})
        assert sample.tasks["slam"].partial == "udp unseen"
        return sample.links["robot1"].partial

    assert find_gap() == find_gap((), link="udp unseen") == "udp unseen"
    assert find_gap(("robot2",)) == find_gap((), "ready") == find_gap(state="failed") == ""


def test_what_counters_of_a_link_see_of_nobody_is_of_the_tasks_that_they_see_by_link_only() -> None:
    """3 MB/s of UDP, 0.5 of them of camera, which has a control group; the rest is of slam and lidar."""
    counted = {"rx_bytes_per_s": 1e6, "tx_bytes_per_s": 2.2e6, "other_bytes_per_s": 3e6, "source": "counters"}
    by_link = a_task(
        partial="udp counted by link only", links={"robot1": 1e5}, rx_bytes_per_s=1e5, tx_bytes_per_s=0.0
    )
    tasks = {
        "camera": a_task(links={"robot1": 5e5}, rx_bytes_per_s=5e5),
        "slam": by_link,
        "lidar": {**by_link, "links": {}, "rx_bytes_per_s": 0.0},
        "other": by_link,
    }
    robots_of = dict.fromkeys(("camera", "slam", "lidar"), ("robot1",))

    def decode(**changed: object) -> HostSample:
        document = a_document(links={"robot1": {**counted, **changed}}, tasks=tasks, counters="installed")
        return decode_document(document, robots=("robot1",), robots_of=robots_of)

    sample = decode()
    assert (sample.counters, sample.links["robot1"].used_source) == ("installed", TrafficSource.COUNTERS)
    assert (sample.links["robot1"].used_bytes_per_s, sample.links["robot1"].partial) == (3.2e6, "")
    found = {name: (task.links or {}).get("robot1") for name, task in sample.tasks.items()}
    # 3.2 MB/s - 0.7 that is known of tasks, half each.
    assert found == {"camera": 5e5, "slam": 1e5 + 1.25e6, "lidar": 1.25e6, "other": 1e5}
    assert sample.tasks["slam"].used[NETWORK.name] == 1e5 + 1.25e6
    # Besides TCP there was less.
    assert (decode(other_bytes_per_s=1e6).tasks["lidar"].links or {})["robot1"] == 5e5
    assert not decode(source="tcp").tasks["lidar"].links


def test_traffic_that_is_partly_seen_does_not_tell_what_a_link_carries() -> None:
    link = {"rx_bytes_per_s": 1e6, "carries_bytes_per_s": 1e6}
    reply = decode_probe(a_document(links={"robot1": link, "robot2": link}), an_edge("edge1"))
    ends = {"edge1": LinkEnds(links=reply.links, peers=reply.peers)}
    found = join_link_ends(ends, {("edge1", "robot1")})
    assert [each.carries_bytes_per_s for each in found.values()] == [None, 1e6]


def test_links_whose_ends_say_the_same_are_joined_once() -> None:
    def read(host: Host, **fields: object) -> LinkEnds:
        reply = decode_probe(a_document(host=host.name, **fields), host)
        return LinkEnds(links=reply.links, peers=reply.peers)

    robot, pair, joined = a_robot("robot1"), ("edge1", "robot1"), JoinedLinks()
    ends = {
        "edge2": read(an_edge("edge2"), links={"robot1": {"carries_bytes_per_s": 1e6}}),
        "edge1": read(an_edge("edge1"), links={"robot1": {"rtt_ms": 1.0}}),
        "robot1": read(robot, links={}, peers={"edge1": {"radio_bytes_per_s": 5e6}}),
    }
    first = join_link_ends(ends, joined=joined)
    edges = dict(joined.edges)
    assert all(join_link_ends(ends, joined=joined)[each] is first[each] for each in first)
    assert all(joined.edges[name] is edges[name] for name in ("edge1", "edge2"))
    ends["edge2"] = read(an_edge("edge2"), links={"robot1": {"carries_bytes_per_s": 2e6}})
    assert join_link_ends(ends, joined=joined) == join_link_ends(ends)
    assert [joined.edges[name] is edges[name] for name in ("edge1", "edge2")] == [True, False]
    ends["edge2"] = read(an_edge("edge2"), links={"robot1": {"carries_bytes_per_s": 1e6}})
    first = join_link_ends(ends, joined=joined)
    # What is partly seen in one cycle is whole in the next one.
    assert join_link_ends(ends, {("edge2", "robot1")}, joined)["edge2", "robot1"].carries_bytes_per_s is None
    ends["robot1"] = read(robot, links={}, peers={"edge1": {"radio_bytes_per_s": 2e6}})
    assert join_link_ends(ends, joined=joined) == join_link_ends(ends)
    assert join_link_ends(ends, joined=joined)[pair].radio_bytes_per_s == 2e6
    del ends["robot1"]
    assert join_link_ends(ends, joined=joined) == join_link_ends(ends)
    assert join_link_ends(ends, joined=joined)["edge2", "robot1"] is first["edge2", "robot1"]


def test_a_robot_has_no_links() -> None:
    assert decode_document(a_document(), a_robot("edge1")).links == {}


def test_a_bare_entry_is_enough_for_a_task_found_by_its_pattern() -> None:
    document = a_document(tasks={"roscore": {"state": "running", "pid": 5, "managed": False}})
    sample = decode_document(document, detected=frozenset({"roscore"}))
    task = sample.tasks["roscore"]
    assert (task.managed, task.used["cpu"], task.links, task.instance) == (False, 0.0, None, "")


def test_control_characters_never_reach_a_terminal() -> None:
    nasty = "\x1b]0;owned\x07 \u202egnp.\u2028 \x00 ok \u00e9"
    tasks = {"sl\x1bam": a_task(), "::error::x": a_task(), "slam": a_task(detail=nasty + "\ud800")}
    sample = decode_document(a_document(tasks=tasks, boot_id=nasty))
    assert list(sample.tasks) == ["slam"]  # no agent sends a name that is none
    assert sample.tasks["slam"].detail == sample.device.boot_id + "\\ud800"
    assert sample.device.boot_id == "\\x1b]0;owned\\x07 \\u202egnp.\\u2028 \\x00 ok \u00e9"


BAD: list[tuple[str, Callable[[Document], object]]] = [
    ("another host", lambda d: d.update(host="edge2")),
    ("another operation", lambda d: d.update(op="status")),
    ("a newer version", lambda d: d.update(v=2)),
    ("no version", lambda d: d.pop("v")),
    ("no cpu", lambda d: d.pop("cpu")),
    ("no memory", lambda d: d.pop("memory")),
    ("zero cores", lambda d: d.update(cpu={"cores": 0, "used_cores": 0})),
    ("zero bytes", lambda d: d.update(memory={"total_bytes": 0, "used_bytes": 0})),
    ("5e-324 cores", lambda d: d.update(cpu={"cores": 5e-324, "used_cores": 0})),
    ("an old sample", lambda d: d.update(sample_age_s=1e12)),
    ("negative cores", lambda d: d.update(cpu={"cores": -4, "used_cores": 0})),
    ("negative use", lambda d: d.update(cpu={"cores": 4, "used_cores": -0.1})),
    ("NaN", lambda d: d.update(cpu={"cores": math.nan, "used_cores": 0})),
    ("infinity", lambda d: d.update(cpu={"cores": 4, "used_cores": math.inf})),
    ("true as a number", lambda d: d.update(cpu={"cores": True, "used_cores": 0})),
    ("text as a number", lambda d: d.update(cpu={"cores": "4", "used_cores": 0})),
    ("cpu as a list", lambda d: d.update(cpu=[4, 0])),
    ("tasks as a list", lambda d: d.update(tasks=[])),
    ("links as a list", lambda d: d.update(links=[])),
    ("other tasks as an object", lambda d: d.update(other_tasks={})),
    ("a clock of NaN", lambda d: d.update(wall=math.nan)),
    ("5,000 digits", lambda d: d.update(cpu={"cores": 10**400, "used_cores": 0})),
]


@pytest.mark.parametrize("spoil", [spoil for _, spoil in BAD], ids=[name for name, _ in BAD])
def test_odd_documents_are_refused(spoil: Callable[[Document], object]) -> None:
    document = a_document()
    spoil(document)
    with pytest.raises(ReplyError):
        decode_document(document)


GOOD_OTHER = {"fleet": "f", "host": "h", "task": "t", "state": "running"}
COLLECTIONS: dict[str, tuple[str, object]] = {
    "an interface without rates": ("interfaces", {"eth9": {}}),
    "an interface of 1e300": ("interfaces", {"eth9": {"rx_bytes_per_s": 1e300, "tx_bytes_per_s": 0}}),
    "null as an interface": ("interfaces", {"eth9": None}),
    "a negative rtt": ("links", {"robot9": {"rtt_ms": -1.0}}),
    "a link as a number": ("links", {"robot9": 3}),
    "null as a link": ("links", {"robot9": None}),
    "reachable as text": ("links", {"robot9": {"reachable": "yes"}}),
    "a check as text": ("checks", {"nav": "0"}),
    "null as a check": ("checks", {"nav": None}),
    "null as a generation": ("generations", {"nav": None}),
    "another task as text": ("other_tasks", ["x"]),
    "null as another task": ("other_tasks", [None]),
    "another task of an unknown state": ("other_tasks", [{**GOOD_OTHER, "state": "happy"}]),
    "a task without an owner as a list": ("unowned", [[]]),
    "null as a task without an owner": ("unowned", [None]),
}


@pytest.mark.parametrize(("key", "bad"), COLLECTIONS.values(), ids=list(COLLECTIONS))
def test_an_odd_entry_of_a_collection_is_left_out(key: str, bad: Any) -> None:
    """The sample is the one of the reply without it, and what stands beside it counts."""
    good: dict[str, Any] = {
        "interfaces": {"eth0": {"rx_bytes_per_s": 1.0, "tx_bytes_per_s": 2.0}},
        "links": {"robot1": {"rtt_ms": 1.2}},
        "checks": {"slam": {"exit": 0}},
        "generations": {"job": 3},
        "other_tasks": [GOOD_OTHER],
        "unowned": ["job"],
    }
    spoilt = good[key] + bad if isinstance(bad, list) else {**bad, **good[key]}
    document, clean = a_document(**{key: spoilt}), a_document(**{key: good[key]})
    context: dict[str, Any] = {"robots": ("robot1", "robot9"), "checked": frozenset({"slam", "nav"})}
    assert decode_document(document, **context) == decode_document(clean, **context)
    found, expected = (decode_probe(each, an_edge("edge1")) for each in (document, clean))
    assert found.unowned == expected.unowned
    assert list_done_tasks(found) == list_done_tasks(expected)


def test_an_interface_without_a_speed_says_nothing_about_the_link() -> None:
    interfaces = {"eth0": {"rx_bytes_per_s": 1.0, "tx_bytes_per_s": 2.0, "speed_bytes_per_s": 5e-324}}
    link = decode_document(a_document(interfaces=interfaces)).links["robot1"]
    assert (link.capacity_bytes_per_s, link.capacity_source) == (ASSUMED_BYTES_PER_S, CapacitySource.ASSUMED)


BAD_ENTRIES: dict[str, object] = {
    "null": None,
    "a list": [],
    "a task as text": "ready",
    "an unknown state": a_task(state="happy"),
    "a negative pid": a_task(pid=-1),
    "a fractional pid": a_task(pid=1.5),
    "a negative age": a_task(age_s=-5.0),
    "an age of 1e999": a_task(age_s=float("1e999")),
    "a text link rate": a_task(links={"robot1": "fast"}),
    "managed as text": a_task(managed="no"),
    "instance as a number": a_task(instance=7),
    "an exit code as text": a_task(exit_code="0"),
    "an age before the first year": a_task(age_s=1e12),
    "an end before the first year": a_task(ended_s=1e12),
    "a generation beyond all": a_task(generation=2**63),
    "a pid that no file takes": a_task(pid=2**60),
}


@pytest.mark.parametrize("entry", BAD_ENTRIES.values(), ids=list(BAD_ENTRIES))
def test_a_bad_entry_costs_that_entry_and_may_still_run(entry: object) -> None:
    """What may run there must not be started elsewhere; nothing else of it is believed."""
    sample = decode_document(a_document(tasks={"slam": entry, "nav": a_task()}))
    assert sample.tasks["slam"].state.alive
    assert sample.tasks["slam"].detail.startswith("its entry cannot be read: tasks.slam")
    assert (sample.tasks["slam"].generation, sample.tasks["slam"].spec_hash) == (0, "")
    assert sample.tasks["nav"].instance == "i1"
    SNAPSHOT_KIND.encode(a_snapshot(edge1=sample))


def test_an_end_that_cannot_be_read_is_no_end() -> None:
    bad = a_task(state="completed", age_s=1e12)
    assert decode_document(a_document(tasks={"slam": bad})).tasks["slam"].state is TaskState.FAILED


@pytest.mark.parametrize("generation", [2**63, 2**33 + 1, -1, True, "9", 1.5, {}])
def test_a_generation_beyond_all_bounds_is_dropped(generation: object) -> None:
    sample = decode_document(a_document(generations={"nav": generation, "job": 3}))
    assert sample.generations == {"job": 3}


def test_a_host_has_no_thousands_of_tasks() -> None:
    with pytest.raises(ReplyError, match="more than 2000 tasks"):
        decode_document(a_document(tasks={f"ghost-{number}": a_task() for number in range(2001)}))


def test_only_what_was_asked_for_counts() -> None:
    asked = a_document(checks={"slam": {"exit": 0}})
    assert decode_document(asked, checked=frozenset()).tasks["slam"].state is TaskState.READY
    found = a_document(tasks={"roscore": {"state": "running", "managed": False}})
    assert decode_document(found).tasks == {}


VALUES: list[object] = [
    None,
    True,
    -1,
    0,
    2**70,
    0.5,
    -0.5,
    math.nan,
    math.inf,
    "",
    "x" * 9999,
    "\x1b[2J",
    [],
    [1],
    {},
    {"a": 1},
    {"": None},
]


def _list_paths(value: object, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    if not isinstance(value, dict):
        return [path]
    return [path, *(deeper for key, inner in value.items() for deeper in _list_paths(inner, (*path, key)))]


def test_whatever_stands_in_a_document_it_is_a_sound_sample_or_a_reply_error() -> None:
    """20,000 documents with one to three values exchanged; a valid sample has only finite numbers and
    survives JSON.
    """
    chance = random.Random(20261121)
    original = a_document(checks={"slam": {"exit": 1}})
    paths = [path for path in _list_paths(original) if path]
    refused = 0
    for _ in range(20_000):
        document = copy.deepcopy(original)
        for path in chance.sample(paths, chance.randint(1, 3)):
            inner: object = document
            for key in path[:-1]:
                inner = inner.get(key) if isinstance(inner, dict) else None
            if isinstance(inner, dict):
                inner[path[-1]] = chance.choice(VALUES)
        try:
            sample = decode_document(document)
        except ReplyError:
            refused += 1
            continue
        assert sample.measured
        assert all(
            math.isfinite(x)
            for x in (
                sample.usage["cpu"].capacity,
                sample.usage["cpu"].used,
                sample.usage["memory"].capacity,
                sample.usage["memory"].used,
            )
        )
        assert sample.usage["cpu"].capacity > 0
        json.dumps(sample.device.boot_id, allow_nan=False)
    assert 5_000 < refused < 20_000


def test_what_a_reply_repeats_is_not_decoded_again_and_reads_as_if_it_were() -> None:
    before, host = a_document(checks={"slam": {"exit": 1}}, former=["edge0"]), an_edge("edge1")
    known = (before, decode_probe(before, host))
    update = {
        "cpu": {"cores": 4, "used_cores": 2.5},
        "interfaces": {"eth1": {"rx_bytes_per_s": 1, "tx_bytes_per_s": 2}},
    }
    again = decode_probe({**before, **update}, host, known)
    assert again == decode_probe({**before, **update}, host) != known[1]
    assert (again.links, again.tasks, again.checks) == (known[1].links, known[1].tasks, known[1].checks)
    assert again.links is known[1].links
    assert again.tasks is known[1].tasks
    assert again.interfaces is not known[1].interfaces
    odd: list[object] = [None, 0, "x", {}, [], {"slam": {"exit": 0}}, ["edge9"], True, 1e300]
    for key in before:
        for value in (*odd, *([...] if key != "v" else [])):
            later = {name: each for name, each in before.items() if name != key}
            later |= {} if value is ... else {key: value}
            assert decode_or_refuse(later, host, known) == decode_or_refuse(later, host, None), (key, value)


def test_an_entry_that_is_repeated_is_not_decoded_again() -> None:
    """Entries whose name or value does not fit make no difference, whether they come, stay or go."""
    host = an_edge("edge1")
    links: dict[str, object] = {f"robot{n}": {"rx_bytes_per_s": n, "rtt_ms": 1.0} for n in (3, 2, 1)}
    odd: list[dict[str, object]] = [
        {}, {"robot2": {"rtt_ms": 5.0}}, {"robot2": None}, {"robot2": {"rtt_ms": "x"}}, {"robot4": {}},
        {"robot\n4": {}, "robot?4": {"rtt_ms": 2.0}},
    ]  # fmt: skip
    for first in odd:
        before = a_document(links={**links, **first})
        known = (before, decode_probe(before, host))
        for second in odd:
            for gone in (None, "robot3", "robot4"):
                later = {**cast("dict[str, object]", before["links"]), **second}
                later.pop(gone or "", None)
                document = {**before, "links": later}
                again, whole = (decode_or_refuse(document, host, each) for each in (known, None))
                assert again == whole, (first, second, gone)
                if isinstance(again, ProbeReply) and isinstance(whole, ProbeReply):
                    assert list(again.links) == list(whole.links)
    before = a_document(links=links)
    known = (before, decode_probe(before, host))
    found = decode_probe({**before, "links": {**links, "robot2": {"rtt_ms": 5.0}}}, host, known)
    assert [found.links[name] is known[1].links[name] for name in links] == [True, False, True]


@pytest.mark.parametrize("host", [an_edge("edge1"), SLICE], ids=["machine", "slice"])
def test_a_sample_made_of_the_one_before_is_as_if_it_were_made_anew(host: Host) -> None:
    """Whatever of links, interfaces, tasks and checks has changed meanwhile, in which order ever."""
    draw, kept, usages, links, nics = random.Random(7), 0, 0, 0, 0
    robots = {name: {"rx_bytes_per_s": 1e3, "interface": "eth0"} for name in ("robot3", "robot2", "robot1")}
    context = ReplyContext(
        host=host, answered_at=NOW, robots=("robot1", "robot2", "robot3"), declared={"robot2": 5e6},
        robots_of={"slam": ("robot1",)}, checked=frozenset({"slam"}),
    )  # fmt: skip
    tasks: list[dict[str, object]] = [{}, {}, {"slam": a_task()}, {"slam": a_task(partial="udp unseen")}]
    document = a_document(links=robots, tasks={})
    known: tuple[Document, ProbeReply, HostSample] | None = None
    for _ in range(300):
        document = dict(document)
        name = draw.choice(list(robots))
        if draw.random() < 0.5:
            changed = {"rx_bytes_per_s": draw.random(), "interface": draw.choice(["eth0", "eth1"])}
            document["links"] = {**cast("dict[str, object]", document["links"]), name: changed}
        if draw.random() < 0.3:
            nic = {
                "rx_bytes_per_s": 1,
                "tx_bytes_per_s": 1,
                "speed_bytes_per_s": draw.choice([None, 1e8, 2e8]),
            }
            document["interfaces"] = {draw.choice(["eth0", "eth1"]): nic}
        if draw.random() < 0.3:
            document["tasks"] = draw.choice(tasks)
        if draw.random() < 0.5:
            document["cpu"] = {"cores": 4, "used_cores": draw.random()}
        if draw.random() < 0.2:
            document["checks"] = draw.choice([{}, {"slam": {"exit": 0}}])
        before = None if known is None else (known[0], known[1])
        reply = decode_probe(document, host, before)
        sample = build_host_sample(reply, document, context, known)
        assert sample == build_host_sample(reply, document, context)
        if known is not None:
            kept += any(known[2].links[name] is link for name, link in sample.links.items())
            usages += any(known[2].usage[name] is usage for name, usage in sample.usage.items())
            links += known[2].links is sample.links
            nics += known[2].device.interfaces is sample.device.interfaces
        known = (document, reply, sample)
    assert min(kept, usages, links, nics) > 20


def count_calls_of_an_update(links: int) -> int:
    """Calls in Python that decode the word of an edge with so many links that its CPU is used otherwise."""
    robots = tuple(f"robot{number}" for number in range(links))
    found: dict[str, object] = {name: {"rx_bytes_per_s": 1e3, "interface": "eth0"} for name in robots}
    host, calls = an_edge("edge1"), 0
    context = ReplyContext(host=host, answered_at=NOW, robots=robots)
    before = a_document(links=found)
    reply = decode_probe(before, host)
    known = before, reply, build_host_sample(reply, before, context)
    document = {**before, "cpu": {"cores": 4, "used_cores": 1.5}}

    def note(_frame: FrameType, event: str, _what: object) -> None:
        nonlocal calls
        calls += event == "call"

    profile = sys.getprofile()
    sys.setprofile(note)
    try:
        sample = build_host_sample(decode_probe(document, host, known[:2]), document, context, known)
    finally:
        sys.setprofile(profile)
    assert sample.usage["cpu"].used == 1.5
    return calls


def test_an_update_that_says_nothing_of_links_looks_at_none() -> None:
    count_calls_of_an_update(1)  # the first compiles what it needs
    assert count_calls_of_an_update(1) == count_calls_of_an_update(30)
    assert count_calls_of_an_update(30) <= 300


def decode_or_refuse(document: Document, host: Host, known: tuple[Document, ProbeReply] | None) -> object:
    try:
        return decode_probe(document, host, known)
    except ReplyError as error:
        return str(error)


def test_a_profiler_s_readings_say_how_old_they_are() -> None:
    sample = decode_document(a_document(resident=True, sample_age_s=0.75))
    assert (sample.resident, sample.sample_age_s) == (True, 0.75)
    assert (decode_document(a_document()).resident, decode_document(a_document()).sample_age_s) == (
        False,
        0.0,
    )
    for wrong in ({"resident": "yes"}, {"sample_age_s": -1.0}, {"sample_age_s": "old"}):
        with pytest.raises(ReplyError):
            decode_document(a_document(**wrong))


def test_a_run_that_no_longer_counts_has_used_its_generation_up() -> None:
    document = a_document(
        tasks={"job": a_task(state="completed", generation=9)}, generations={"nav": 4, "job": 3}
    )
    sample = decode_document(document, reopened=frozenset({"i1"}))
    assert (sample.tasks, sample.generations) == ({}, {"nav": 4, "job": 9})
    assert decode_document(document).generations == {"nav": 4, "job": 3}


def test_when_a_task_ended_is_told_in_the_manager_s_time() -> None:
    tasks = decode_document(
        a_document(tasks={"job": a_task(state="completed", pid=0, ended_s=1.5), "nav": a_task()})
    ).tasks
    assert (tasks["job"].ended_at, tasks["nav"].ended_at) == (NOW - 1.5, None)
    assert tasks["job"].started_at == 0.0, "a run that has ended has no age"


def test_metrics_of_the_application_pass_as_they_are() -> None:
    values = {"fps": 29.5, "map/loss.total": -1e99, "_n:x-y": 0}
    task = decode_document(a_document(tasks={"slam": a_task(metrics=values), "nav": a_task()}))
    assert task.tasks["slam"].metrics == values
    assert task.tasks["nav"].metrics == {}


@pytest.mark.parametrize(
    "values",
    [
        {"a b": 1.0}, {"": 1.0}, {"9": 1.0}, {"a\x1b[31m": 1.0}, {"a\n": 1.0}, {"é": 1.0}, {"a" * 64: 1.0},
        {"fps": True}, {"fps": "1"}, {"fps": None}, {"fps": math.nan}, {"fps": math.inf}, {"fps": 10**400}, {"fps": {}},
        {f"m{number}": 1.0 for number in range(33)}, [1.0], "fps", 5,
    ],
)  # fmt: skip
def test_metrics_that_no_agent_sends_are_left_out(values: object) -> None:
    task = decode_document(a_document(tasks={"slam": a_task(metrics=values)})).tasks["slam"]
    assert len(task.metrics) == (32 if isinstance(values, dict) and len(values) > 32 else 0)
