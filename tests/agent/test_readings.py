# SPDX-License-Identifier: Apache-2.0
"""Readings that come by themselves: what is sent of a probe, and a real agent that sends them."""

import json
import os
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link import frames, heartbeat, protocol
from edgectl.agent.measure.probe import WindowMeter
from edgectl.agent.measure.readings import build_update, list_waiting, merge_update
from edgectl.agent.supervise import state_dir
from edgectl.transport.agent_client import split_frame
from tests.agent.conftest import AgentHost, Profiled, eventually, is_running
from tests.agent.test_converse import DEADLINE_S, MARKER, StayingAgent, open_agent
from tests.agent.test_probe import NET, connected

BEFORE: dict[str, Any] = {
    "wall": 1000.0,
    "window_s": 0.5,
    "cpu": {"cores": 4.0, "used_cores": 1.0},
    "links": {"robot1": {"rx_bytes_per_s": 1e6, "rtt_ms": 2.0, "interface": "wlan0", "reachable": True}},
    "other_tasks": [{"task": "nav", "age_s": 5.0}],
    "tasks": {
        "age_s": {
            "state": "ready", "pid": 7, "age_s": 60.0, "used_bytes": 100 << 20, "restarts": 0,
            "links": {"robot1": 5e5}, "metrics": {"rtt_ms": 5.0}, "exit_code": None,
        }
    },
}  # fmt: skip


def change(path: str, value: object) -> dict[str, Any]:
    """Return the probe one second later, with one other value."""
    later: dict[str, Any] = json.loads(json.dumps(BEFORE))
    later["wall"], later["other_tasks"][0]["age_s"], later["tasks"]["age_s"]["age_s"] = 1001.0, 6.0, 61.0
    *keys, last = path.split(".")
    inner: Any = later
    for key in keys:
        inner = inner[int(key) if isinstance(inner, list) else key]
    inner[last] = value
    return later


@pytest.mark.parametrize(
    ("path", "same", "other"),
    [
        ("cpu.used_cores", 1.04, 1.06),
        ("links.robot1.rx_bytes_per_s", 1.04e6, 0.94e6),
        ("links.robot1.rtt_ms", 3.9, 4.1),
        ("links.robot1.reachable", True, False),
        ("links.robot1.interface", "wlan0", "wlan1"),
        ("other_tasks.0.age_s", 6.3, 0.0),
        ("other_tasks.0.task", "nav", "slam"),
        ("tasks.age_s.used_bytes", (100 << 20) + 4096, 102 << 20),
        ("tasks.age_s.links.robot1", 5.2e5, 5.3e5),
        ("tasks.age_s.age_s", 61.2, 0.5),
        ("tasks.age_s.state", "ready", "failed"),
        ("tasks.age_s.pid", 7, 8),
        ("tasks.age_s.restarts", 0, 1),
        ("tasks.age_s.exit_code", None, 0),
        ("tasks.age_s.metrics", {"rtt_ms": 5.0}, {"rtt_ms": 5.01}),
        ("wall", 1001.2, 1060.0),
        ("window_s", 0.6, None),
        ("grants", None, {}),
    ],
)
def test_what_is_within_the_noise_is_not_sent(path: str, same: object, other: object) -> None:
    before = BEFORE if path != "grants" else {**BEFORE, "grants": None}
    assert build_update(before, change(path, same), 1.0) == {}
    if path != "window_s":
        update = build_update(before, change(path, other), 1.0)
        assert path.partition(".")[0] in {**update["changed"], **update["entries"]}
        assert merge_update(before, update) == change(path, other)


@pytest.mark.parametrize(
    ("path", "other", "sent"),
    [
        ("cpu.used_cores", 3.0, False),
        ("links.robot1.rx_bytes_per_s", 9e6, False),
        ("tasks.age_s.links.robot1", 9e5, False),
        ("tasks.age_s.state", "failed", True),
        ("tasks.age_s.restarts", 1, True),
        ("tasks.age_s.metrics", {"rtt_ms": 5.01}, True),
        ("links.robot1.reachable", False, True),
        ("wall", 1060.0, True),
    ],
)
def test_without_a_new_sample_of_the_profiler_states_alone_are_sent(
    path: str, other: object, sent: bool
) -> None:
    now = change(path, other)
    now["cpu"]["used_cores"] += 1.0
    update = build_update(BEFORE, now, 1.0, list_waiting(BEFORE, now, is_new=False, is_due=True))
    assert bool(update) == sent
    assert not sent or merge_update(BEFORE, update) == now, "then with all that is known now"


def count_ticks(draw: random.Random, cores: float, used_cores: float) -> dict[str, Any]:
    """Return the probe of a host without tasks whose kernel has looked 250 times a second, for one second."""
    busy = sum(draw.random() < used_cores / cores for _ in range(round(250 * cores)))
    return {
        **BEFORE,
        "tasks": {},
        "window_s": 1.0,
        "load_1m": 0.0,
        "cpu": {"cores": cores, "used_cores": busy / 250},
    }


@pytest.mark.parametrize(("cores", "used_cores"), [(2.0, 0.3), (2.0, 1.0), (4.0, 3.5), (8.0, 4.0)])
def test_cpu_whose_change_the_ticks_of_the_kernel_explain_waits_until_something_is_due(
    cores: float, used_cores: float
) -> None:
    draw = random.Random(1)
    sent, sent_when_due = 0, 0
    for _ in range(400):
        before, now = count_ticks(draw, cores, used_cores), count_ticks(draw, cores, used_cores)
        now["load_1m"] = draw.uniform(0.0, 64.0)
        for is_due in (False, True):
            update = build_update(before, now, 0.0, list_waiting(before, now, is_new=True, is_due=is_due))
            sent, sent_when_due = (
                sent + (bool(update) and not is_due),
                sent_when_due + (bool(update) and is_due),
            )
    assert sent <= 0.1 * 400
    assert sent_when_due >= 0.9 * 400, "with the load average"
    before, now = count_ticks(draw, cores, used_cores), count_ticks(draw, cores, used_cores / 2)
    now["load_1m"] = 64.0
    update = build_update(before, now, 0.0, list_waiting(before, now, is_new=True, is_due=False))
    assert update["changed"] == {"cpu": now["cpu"], "load_1m": 64.0}


def test_cpu_does_not_wait_where_tasks_are_nor_where_it_is_a_mean_of_a_profiler() -> None:
    """How much it varies decides when a task leaves a host; a profiler has smoothed it."""
    now = {**BEFORE, "cpu": {"cores": 4.0, "used_cores": 1.1}}
    for other, waits in (
        ({"tasks": {}}, True),
        ({}, False),
        ({"tasks": {}, "window_s": 0.0}, False),
        ({"tasks": {}, "window_s": 60.0}, False),
        ({"tasks": {}, "cpu": {"cores": 0.0, "used_cores": 1.1}}, False),
    ):
        waiting = list_waiting(BEFORE, {**now, **other}, is_new=True, is_due=False)
        assert ("used_cores" in waiting) == waits, other


def test_entries_and_keys_that_come_and_go_are_sent() -> None:
    gone = change("tasks", {})
    assert build_update(BEFORE, gone, 1.0)["changed"]["tasks"] == {}
    resident = change("resident", True)
    assert build_update(BEFORE, resident, 1.0)["changed"]["resident"] is True
    assert build_update(resident, change("wall", 1001.0), 0.0)["gone"] == ["resident"]


def test_an_update_has_what_changed_and_what_has_an_age_alone() -> None:
    """Links and loads that stay within their noise are what was said of them before."""
    later = change("cpu.used_cores", 3.0)
    later["links"]["robot1"]["rtt_ms"], later["window_s"] = 2.1, 1.0
    later["tasks"] = {}
    assert build_update({**BEFORE, "tasks": {}}, later, 1.0)["changed"].keys() == {
        "cpu",
        "wall",
        "other_tasks",
    }


def test_of_links_and_tasks_those_that_changed_are_sent_alone() -> None:
    """An edge has a link to each robot. Names that come or go, and what has no object for each name, are sent whole."""
    before = {
        "links": {f"robot{n}": {"rtt_ms": 1.0} for n in (3, 2, 1)},
        "tasks": {"nav": {"pid": 1}},
        "checks": {},
    }
    now: dict[str, Any] = json.loads(json.dumps(before))
    now["links"]["robot2"], now["tasks"]["nav"] = {"rtt_ms": 9.0}, {"pid": 2}
    update = build_update(before, now, 1.0)
    assert update == {
        "changed": {},
        "entries": {"links": {"robot2": {"rtt_ms": 9.0}}, "tasks": {"nav": {"pid": 2}}},
        "gone": [],
    }
    assert merge_update(before, update) == now
    del now["links"]["robot3"]
    now["checks"] = {"nav": None}
    update = build_update(before, now, 1.0)
    assert (update["changed"].keys(), update["entries"].keys()) == ({"links", "checks"}, {"tasks"})
    assert merge_update(before, update) == now


@pytest.mark.parametrize("seed", range(5))
def test_what_the_manager_knows_is_never_wrong_by_more_than_the_noise(seed: int) -> None:
    draw = random.Random(seed)
    link = {"rx_bytes_per_s": 1e6, "rtt_ms": 30.0}
    known, said_at, sent = BEFORE | {"links": {"robot2": link, "robot1": link}}, 0.0, 0
    now: dict[str, Any] = json.loads(json.dumps(known))
    for second in range(1, 200):
        now = json.loads(json.dumps(now))
        now["wall"], now["other_tasks"][0]["age_s"] = 1000.0 + second, 5.0 + second
        now["tasks"]["age_s"]["age_s"] += 1.0
        now["cpu"]["used_cores"] = max(0.0, now["cpu"]["used_cores"] + draw.uniform(-0.04, 0.04))
        for link in now["links"].values():
            link["rtt_ms"] *= draw.uniform(0.9, 1.1)
        now["tasks"]["age_s"]["links"]["robot1"] *= draw.uniform(0.98, 1.02)
        if draw.random() < 0.05:
            now["tasks"]["age_s"] |= {"age_s": 0.1, "pid": second, "restarts": second}
        update = build_update(known, now, second - said_at)
        if update:
            known, said_at, sent = merge_update(known, update), float(second), sent + 1
        assert build_update(known, now, second - said_at) == {}
    assert 10 < sent < 150


def read_replies(staying: StayingAgent, number: int) -> list[dict[str, Any]]:
    """Return the replies to one request so far."""
    found, rest = [], staying.said.get(number, b"")
    while (frame := split_frame(rest, MARKER)) is not None:
        found.append(json.loads(frame[0]))
        rest = frame[1]
    return found


def wait_for_replies(staying: StayingAgent, number: int, count: int) -> list[dict[str, Any]]:
    """Return the replies to one request once there are so many."""
    while len(found := read_replies(staying, number)) < count:
        assert number not in staying.ended, staying.ended
        staying.take(staying.read())
    return found


@pytest.fixture
def staying(host: AgentHost) -> Iterator[StayingAgent]:
    """An agent that stays, on a host that keeps the code for readings."""
    assert host.ask("readings", window_s=0.0, every_s=0.1, rounds=50)["op"] == "probe"
    host.ask("status", task=None)
    with open_agent(host) as found:
        yield found


def test_a_call_has_one_reply_like_that_to_a_probe(host: AgentHost) -> None:
    found = host.ask("readings", window_s=0.0, every_s=0.1, rounds=50)
    assert found.keys() == host.ask("probe", window_s=0.0).keys()


def test_what_changes_comes_by_itself_and_an_end_is_an_end(staying: StayingAgent) -> None:
    staying.ask(1, "readings", window_s=0.0, every_s=0.1, rounds=10000)
    assert wait_for_replies(staying, 1, 1)[0]["tasks"] == {}
    staying.host.start("slam", "exec sleep 600")
    document: dict[str, Any] = {}
    while "slam" not in document.get("tasks", {}):
        replies = wait_for_replies(staying, 1, len(read_replies(staying, 1)) + 1)
        document = replies[0]
        for update in replies[1:]:
            document = {**document, **update.get("changed", {})}
    assert document["tasks"]["slam"]["pid"] > 0
    (child,) = staying.children()
    staying.send(frames.build_frame(frames.DROP, 1))
    assert staying.wait(1) == str(-signal.SIGTERM)
    eventually(lambda: not is_running(child))
    staying.ask(2, "status", task=None)
    assert staying.reply(2)["tasks"].keys() == {"slam"}


def test_windows_have_no_gaps_and_a_round_reads_half_of_what_a_probe_reads(host: AgentHost) -> None:
    """Bytes that were sent between two windows count, and nothing is read once to begin and once to end a window."""
    # A separate address: the kernel reports connections that other tests have closed with a delay.
    robot = f"{NET}.43"
    request = {"host": host.name, "window_s": 0.05, "links": [{"robot": "robot1", "address": robot}]}
    host.start("slam", "exec sleep 600")
    host.until("slam", "running")
    state_dir.use_fleet([str(host.state)], host.fleet)
    with connected(robot) as (near, far):
        meter = WindowMeter(request)
        first, once = count_reads(meter)
        near.sendall(b"x" * 100_000)
        assert len(far.recv(100_000, socket.MSG_WAITALL)) == 100_000
        time.sleep(0.1)
        later, again = count_reads(meter)
        assert meter._links is not None
        # Of its two listings of connections; on a busy machine another one than that of the rest.
        seconds = meter._links._traffic.seconds
        meter.close()
    assert first["links"]["robot1"]["tx_bytes_per_s"] == 0.0
    assert min(seconds, later["window_s"]) >= 0.15
    assert later["links"]["robot1"]["tx_bytes_per_s"] * seconds == pytest.approx(100_000, rel=0.01)
    assert first["tasks"].keys() == later["tasks"].keys() == {"slam"}
    # File by file: of a busy machine other processes are there each time, each with a file of its own.
    assert {path: count for path, count in again.items() if count > max(1, once[path] // 2)} == {}
    assert once["/proc/stat"] == 2 * again["/proc/stat"] == 2


OPENED: list[str] | None = None


def note_open(event: str, args: tuple[Any, ...]) -> None:
    if event == "open" and OPENED is not None:
        OPENED.append(str(args[0]))


sys.addaudithook(note_open)


def count_reads(meter: WindowMeter) -> tuple[dict[str, Any], Counter[str]]:
    """What is measured next, and how often each file is opened for it."""
    global OPENED  # noqa: PLW0603 - a hook of the interpreter stays
    opened = OPENED = list[str]()
    try:
        found, _ = meter.measure()
    finally:
        OPENED = None
    return found, Counter(opened)


@contextmanager
def changing_memory() -> Iterator[None]:
    """Use 40 MiB more each 50 ms, and begin anew beyond 400 MiB: more than the noise of any host of 4 GiB."""
    over = threading.Event()

    def change() -> None:
        held: list[bytes] = []
        while not over.wait(0.05):
            held = [*held, b"x" * (40 << 20)] if len(held) < 10 else []

    changing = threading.Thread(target=change)
    changing.start()
    try:
        yield
    finally:
        over.set()
        changing.join()


@pytest.mark.parametrize(("profiler_s", "every_s"), [(1.0, 0.05), (0.1, 1.0)])
def test_numbers_come_at_most_at_the_rate_of_the_profiler(
    profiler_s: float, every_s: float, staying: StayingAgent, profiled: Profiled
) -> None:
    """And at most at that of the watch. The memory of the host changes in each round."""
    profiled.start(every=profiler_s)
    profiled.probe()
    staying.ask(1, "readings", window_s=0.0, every_s=every_s, rounds=10000)
    assert wait_for_replies(staying, 1, 1)[0]["resident"] is True
    before, began = profiled.status()["samples"], time.monotonic()
    with changing_memory():
        while time.monotonic() < began + 4.0 or profiled.status()["samples"] < before + 3:
            if select.select([staying.output], [], [], 0.1)[0]:
                staying.take(staying.read())
    most = min(profiled.status()["samples"] - before, (time.monotonic() - began) / every_s)
    updates = [each for each in read_replies(staying, 1)[1:] if each]
    assert any("memory" in each["changed"] for each in updates)
    assert len(updates) <= most + 1


def test_a_request_for_no_rounds_is_a_heartbeat_alone(staying: StayingAgent) -> None:
    host = staying.host
    host.start("slam", "exec sleep 600")
    state_dir.use_fleet([str(host.state)], host.fleet)
    before = heartbeat.read_last_heartbeat(host.name)
    staying.ask(1, "readings", rounds=0)
    assert staying.wait(1) == "0"
    assert read_replies(staying, 1) == [{}]
    assert heartbeat.read_last_heartbeat(host.name) > before > 0.0


_LOOKING_UP = """
import sys
from edgectl.agent.link.boot import Channel
from edgectl.agent.measure import readings

class Counted(readings.LinkMeter):
    def __init__(self, request):
        print("looked up", file=sys.stderr)
        super().__init__(request)

readings.LinkMeter, readings._LOOK_UP_EACH_S = Counted, 0.5
request = {"host": "edge1", "window_s": 0.1, "every_s": 0.2, "rounds": 12, "links": [{"robot": "robot1", "address": "localhost"}]}
readings.send_readings(request, Channel("MARKER"))
"""


def test_names_and_limits_are_looked_up_anew_now_and_then() -> None:
    """Readings go on for minutes, in which a name may come to stand for another address."""
    found = subprocess.run(
        [sys.executable, "-c", _LOOKING_UP], check=True, capture_output=True, text=True, timeout=DEADLINE_S
    )
    assert 2 <= found.stderr.count("looked up") <= 6
    assert '"robot1"' in found.stdout


_LOADED = """
import itertools, sys, time
from edgectl.agent.link.boot import Channel
from edgectl.agent.measure import device, readings

class Timed(Channel):
    def reply(self, payload):
        print(time.monotonic(), payload.decode(), file=sys.stderr)

loads = itertools.count(1)
device.read_load_1m = lambda: 2.0 ** next(loads)
request = {"host": "edge1", "window_s": 0.1, "every_s": 0.1, "rounds": 100}
readings.send_readings(request, Timed("MARKER"))
"""


def test_a_load_average_alone_is_no_reason_to_send_before_something_is_due() -> None:
    """Of a busy machine other values may change in each round."""
    found = subprocess.run(
        [sys.executable, "-c", _LOADED], check=True, capture_output=True, text=True, timeout=DEADLINE_S
    )
    words = [line.split(" ", 1) for line in found.stderr.splitlines()]
    first, *updates = [(float(at), json.loads(said)) for at, said in words]
    assert first[1]["load_1m"] == 2.0
    assert [said["changed"]["load_1m"] for _, said in updates if said], "with all that is sent"
    for (before, _), (at, said) in pairwise([first, *updates]):
        others = said["changed"].keys() - {"load_1m", "wall"}
        assert others or said["entries"] or at - before >= protocol.READING_SAID_S - 0.1


def test_it_ends_after_its_rounds(staying: StayingAgent) -> None:
    staying.ask(1, "readings", window_s=0.0, every_s=0.05, rounds=3)
    assert staying.wait(1) == "0"
    assert read_replies(staying, 1)[0]["op"] == "probe"


def test_a_host_on_which_nothing_changes_says_so_now_and_then(staying: StayingAgent) -> None:
    """Of a busy machine some value may always change; an age never lasts longer than that."""
    staying.ask(1, "readings", window_s=0.0, every_s=0.1, rounds=10000)
    began = time.monotonic()
    wait_for_replies(staying, 1, 1)
    while time.monotonic() - began < 2 * protocol.READING_SAID_S:
        before = time.monotonic()
        wait_for_replies(staying, 1, len(read_replies(staying, 1)) + 1)
        assert time.monotonic() - before < DEADLINE_S


def test_it_outlives_neither_its_deadline_nor_its_agent(staying: StayingAgent) -> None:
    staying.ask(1, "readings", timeout=DEADLINE_S, window_s=0.0, every_s=0.1, rounds=10000)
    wait_for_replies(staying, 1, 1)
    (child,) = staying.children()
    os.kill(staying.process.pid, signal.SIGKILL)
    staying.process.wait()
    eventually(lambda: not is_running(child))


def test_the_one_that_measures_again_and_again_is_small(staying: StayingAgent) -> None:
    staying.ask(1, "readings", window_s=0.0, every_s=0.01, rounds=100)
    wait_for_replies(staying, 1, 1)
    (child,) = staying.children()
    sizes = []
    while 1 not in staying.ended:
        try:
            status = Path(f"/proc/{child}/status").read_text()
            files = len(list(Path(f"/proc/{child}/fd").iterdir()))
        except OSError:
            break
        sizes += [int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")]
        assert files <= 12
        staying.take(staying.read())
    assert sizes
    assert max(sizes) <= 15 * 1024
