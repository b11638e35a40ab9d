# SPDX-License-Identifier: Apache-2.0
"""Requests over an agent that stays, on real hosts: the same replies, and a call of its own for all that fails."""

import itertools
import json
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from functools import partial
from pathlib import Path
from typing import Any, Self

import pytest

from edgectl.agent.link import frames, protocol
from edgectl.agent.measure import proc
from edgectl.errors import ConnectError, DeadlineError
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.inventory import Connection, Host, Role
from edgectl.transport import conversation, pulses
from edgectl.transport.agent_client import (
    build_agent_command,
    build_packet,
    call_agent,
    stream_agent_log,
)
from edgectl.transport.base import OpenExchange, Reply, Session
from edgectl.transport.connections import SessionPool
from edgectl.transport.conversation import ConversingSession
from edgectl.transport.fake import frame_reply, unpack_request
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.transport.local import LocalExchange
from edgectl.transport.readings import ReadingFeed
from edgectl.usecases import fleet as usecases
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.scrape import keep_sessions_open
from edgectl.usecases.status import probe_repeatedly
from edgectl.usecases.watch import WatchOptions, watch_fleet
from tests.agent.conftest import a_spec, is_running, shared_memory
from tests.builders import an_inventory, some_tasks
from tests.pace import patience
from tests.relay import Relay, RelayFault
from tests.sshd import Lab, running_lab

ANSWERS_S = patience(30.0)
ENDLESS: dict[str, Any] = {"task": "slam", "instance": "i1", "timeout_s": 600.0, "up_s": 1e6}


class CountingTransport:
    """Real sessions; ``calls``: (host, operation) of each request that had a call of its own; ``logins``, ``agents``: host
    of each session, and of each agent that was to stay.
    """

    def __init__(self) -> None:
        self.calls: list[tuple[str, str]] = []
        self.logins: list[str] = []
        self.agents: list[str] = []
        self._within = FleetTransport()

    def connect(self, host: Host, *, timeout: float) -> Session:
        session = self._within.connect(host, timeout=timeout)
        run, converse = session.run, session.converse  # type: ignore[attr-defined]
        self.logins.append(host.name)

        def run_counted(command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
            self.calls.append((host.name, str(unpack_request(stdin)[1]["op"])))
            return run(command, stdin, timeout=timeout, limit=limit)

        def converse_counted(*given: Any, **options: Any) -> OpenExchange:
            self.agents.append(host.name)
            exchange: OpenExchange = converse(*given, **options)
            return exchange

        session.run = run_counted  # type: ignore[method-assign]
        session.converse = converse_counted  # type: ignore[attr-defined]
        return session

    def address(self, host: Host) -> str:
        return self._within.address(host)


class Fleet:
    """Hosts, and a pool whose requests may share an agent."""

    def __init__(self, *hosts: Host) -> None:
        self.hosts, self.transport = hosts, CountingTransport()
        self.pool = SessionPool(self.transport, converse=True)

    def ask(self, op: str, host: Host | None = None, *, timeout: float = ANSWERS_S, **fields: Any) -> Any:
        asked = host or self.hosts[0]
        with self.pool.connect(asked, timeout=ANSWERS_S) as session:
            named = {"op": op, "fleet": "lab", "host": asked.name, **fields}
            return call_agent(session, named, timeout=timeout)

    def is_conversed(self, host: Host | None = None) -> bool:
        """Whether a request needs no call of its own; its reply is right in either case."""
        before = len(self.transport.calls)
        assert self.ask("status", host, task=None)["host"] == (host or self.hosts[0]).name
        return len(self.transport.calls) == before

    def describe(self) -> object:
        """What became of the conversation with the first host."""
        with self.pool.connect(self.hosts[0], timeout=ANSWERS_S) as session:
            found = session._session._conversation  # type: ignore[attr-defined]
        seen = found and {
            name: getattr(found, name) for name in ("is_over", "is_useless", "is_fruitless", "_refused")
        }
        return self.transport.agents, self.transport.calls[:40], seen

    def start(self, task: str = "slam") -> None:
        self.ask(
            "start",
            task=task,
            instance="i1",
            generation=1,
            spec=a_spec("echo up; exec sleep 600", runtime="process"),
        )
        self.ask("wait", task=task, instance="i1", timeout_s=ANSWERS_S)

    def stop(self, task: str = "slam") -> None:
        self.ask("stop", task=task, instance=None, generation=None, stop=None)


def list_threads() -> list[threading.Thread]:
    return [each for each in threading.enumerate() if each.name == "edgectl-converse"]


def until(
    found: Callable[[], object], *, every: float = 0.05, describe: Callable[[], object] = lambda: ""
) -> None:
    deadline = time.monotonic() + ANSWERS_S
    while not found():
        assert time.monotonic() < deadline, f"did not happen in time {describe()}"
        time.sleep(every)


def list_agents(mark: Path) -> list[int]:
    """The agents on a host of the lab, or of a state directory, whose input is open; no supervisors."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            environ, command = (folder / "environ").read_bytes(), (folder / "cmdline").read_bytes()
            has_input = str((folder / "fd" / "0").readlink()) != os.devnull
        except OSError:
            continue
        if has_input and str(mark).encode() in environ and b"\0-I\0-S\0-c\0" in command:
            found.append(int(folder.name))
    return [pid for pid in found if is_running(pid)]


def list_children(pid: int) -> list[int]:
    return [child for child, each in proc.read_process_table().items() if each.ppid == pid]


def begin_early(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a conversation begin with the second request: calls take most of the time of these tests."""
    monkeypatch.setattr(conversation, "MIN_IN_ROW", 2)


@pytest.fixture(params=[Connection.SSH, Connection.OPENSSH, Connection.LOCAL])
def fleet(
    request: pytest.FixtureRequest, lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Fleet]:
    """Three hosts in reverse order of their names; local ones share a directory."""
    begin_early(monkeypatch)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    hosts = [
        Host(name=name, role=Role.EDGE, host="localhost", connection=Connection.LOCAL)
        if request.param is Connection.LOCAL
        else lab.host(name, connection=request.param)
        for name in sorted(lab.servers, reverse=True)[:3]
    ]
    made = Fleet(*hosts)
    with made.pool:
        yield made
        made.stop()


@pytest.fixture
def local(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    begin_early(monkeypatch)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    made = Fleet(Host(name="edge1", role=Role.EDGE, host="localhost", connection=Connection.LOCAL))
    with made.pool:
        yield made
        made.stop()


def test_requests_that_follow_each_other_need_no_calls(fleet: Fleet) -> None:
    fleet.start()
    for host in fleet.hosts:
        until(partial(fleet.is_conversed, host))
    for host in fleet.hosts:
        assert fleet.ask("probe", host, window_s=0.0)["host"] == host.name
    assert fleet.ask("status", task=None)["tasks"].keys() == {"slam"}
    fleet.stop()
    assert (fleet.hosts[0].name, "stop") in fleet.transport.calls
    assert fleet.ask("status", task=None)["tasks"] == {}


@pytest.mark.parametrize("fleet", [Connection.SSH, Connection.LOCAL], indirect=True)
def test_one_that_hangs_costs_the_others_nothing_and_meets_its_deadline(fleet: Fleet) -> None:
    fleet.start()
    until(fleet.is_conversed)
    failures: list[BaseException] = []

    def wait() -> None:
        try:
            fleet.ask("wait", timeout=3.0, **ENDLESS)
        except DeadlineError as error:
            failures.append(error)

    waiting = threading.Thread(target=wait)
    waiting.start()
    del fleet.transport.calls[:]
    for _ in range(5):
        assert fleet.ask("status", task=None)["tasks"].keys() == {"slam"}
    assert len(fleet.transport.calls) < 5
    waiting.join(ANSWERS_S)
    assert len(failures) == 1
    # The pool opens the connection anew after a deadline, and its agent after that.
    until(fleet.is_conversed)


def test_the_death_of_the_agent_costs_a_request_its_time_alone(local: Fleet, tmp_path: Path) -> None:
    local.start()
    until(local.is_conversed)
    replies: list[dict[str, Any]] = []
    waiting = threading.Thread(
        target=lambda: replies.append(local.ask("wait", **{**ENDLESS, "timeout_s": 2.0}))
    )
    waiting.start()
    (agent,) = list_agents(tmp_path)
    until(lambda: list_children(agent))
    os.kill(agent, signal.SIGKILL)
    waiting.join(ANSWERS_S)
    assert [reply["state"] for reply in replies] == ["running"]
    assert local.transport.calls[-1] == ("edge1", "wait")
    assert not local.is_conversed(), "the next agent is not begun at once"


def test_an_agent_that_was_removed_and_sent_to_another_place_is_conversed_with_there(
    local: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in shared memory, where a host finds it whose home could not be written for a time."""
    monkeypatch.setattr(conversation, "REST_S", 0.0)
    until(local.is_conversed)
    (kept,) = (tmp_path / "state" / "agent").glob("*.pyz")
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "other"))
    kept.unlink()
    assert not local.is_conversed()
    until(local.is_conversed)
    assert (tmp_path / "other" / "agent" / kept.name).exists()
    assert len(local.transport.agents) >= 2


def test_agents_that_are_killed_again_and_again_cost_no_request(
    local: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conversation, "REST_S", 0.0)
    local.start()
    over = threading.Event()
    killed: list[int] = []
    with local.pool.connect(local.hosts[0], timeout=ANSWERS_S) as session:
        conversing = session._session
    assert isinstance(conversing, ConversingSession)

    def kill() -> None:
        # Agents of calls are left alone: their death is an error, as ever.
        while not over.wait(0.02):
            exchange = conversing._conversation and conversing._conversation._exchange
            if isinstance(exchange, LocalExchange):
                killed.append(exchange._process.pid)
                exchange._process.kill()

    killing = threading.Thread(target=kill)
    killing.start()
    try:
        until(lambda: local.ask("status", task=None)["tasks"].keys() == {"slam"} and len(set(killed)) >= 4)
        for _ in range(10):
            assert local.ask("status", task=None)["tasks"].keys() == {"slam"}
    finally:
        over.set()
        killing.join()


def test_nothing_is_left_on_the_host_or_here(fleet: Fleet, lab: Lab, tmp_path: Path) -> None:
    folders = [tmp_path, *(server.directory for server in lab.servers.values())]
    for host in fleet.hosts[:2]:
        until(partial(fleet.is_conversed, host))
    assert any(list_agents(folder) for folder in folders)
    fleet.pool.close()
    until(lambda: not list_threads())
    until(lambda: not any(list_agents(folder) for folder in folders))


def test_a_line_that_falls_silent_ends_the_agent_and_not_the_task(lab: Lab) -> None:
    server = lab["edge1"]
    relay = Relay((server.address, server.port), RelayFault.SILENCE, 1 << 40)
    lab.known_hosts.write_text(f"[127.0.0.1]:{relay.port} {server.key}\n")
    fleet = Fleet(lab.host("edge1", host="127.0.0.1", port=relay.port))
    try:
        with fleet.pool:
            fleet.start()
            until(fleet.is_conversed)
            (agent,) = list_agents(server.directory)
            relay._left = 0
            began = time.monotonic()
            until(lambda: not is_running(agent))
            assert time.monotonic() - began < patience(3.0)
            with pytest.raises(DeadlineError):
                fleet.ask("status", task=None, timeout=1.0)
    finally:
        relay.close()
    after = Fleet(lab.host("edge1", host=server.address, port=server.port))
    lab.write_files()
    with after.pool:
        assert after.ask("status", task=None)["tasks"]["slam"]["state"] == "running"
        after.stop()


def test_a_host_with_room_for_one_channel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The conversation gives way to the calls that it cannot carry, for good."""
    with running_lab(tmp_path / "lab", ["edge1"], extra=["MaxSessions 1"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        fleet = Fleet(lab.host("edge1"))
        with fleet.pool:
            for _ in range(3):
                fleet.start()
                assert fleet.ask("status", task=None)["tasks"].keys() == {"slam"}
                with fleet.pool.connect(fleet.hosts[0], timeout=ANSWERS_S) as session:
                    asked = {"op": "follow", "fleet": "lab", "host": "edge1", "task": "slam"}
                    pieces = stream_agent_log(
                        session, {**asked, "tail": 1, "since_s": None}, idle_timeout=ANSWERS_S
                    )
                    assert b"up" in next(pieces)
                    pieces.close()  # type: ignore[attr-defined]
                fleet.stop()


FORBIDDING = "ForceCommand sh -c 'f=$(mktemp) && cat >$f && sh -c \"$SSH_ORIGINAL_COMMAND\" <$f; rm -f $f'"


def test_a_wrapper_that_reads_all_input_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """There is no first word, so nothing is asked that could be carried out later, and nothing is delayed."""
    with running_lab(tmp_path / "lab", ["edge1"], extra=[FORBIDDING]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        fleet = Fleet(lab.host("edge1"))
        with fleet.pool:
            for number in range(8):
                assert fleet.ask("status", task=None)["tasks"] == {}
                assert len(fleet.transport.calls) == number + 1
        until(lambda: not list_agents(lab["edge1"].directory))


OPTIONS = ProbeOptions(window=0.05, timeout=ANSWERS_S)


def run_watch(site: usecases.Fleet) -> Generator[object, None, None]:
    yield from watch_fleet(site, WatchOptions(every=0.1, probe=OPTIONS))


def run_top(site: usecases.Fleet) -> Generator[object, None, None]:
    yield from probe_repeatedly(site, lambda: False, OPTIONS)


def run_serve(site: usecases.Fleet) -> Generator[object, None, None]:
    with keep_sessions_open(site) as kept:
        while True:
            yield probe_fleet(kept, OPTIONS)


@pytest.mark.parametrize("run", [run_watch, run_top, run_serve])
def test_what_asks_again_and_again_converses(
    run: Callable[[usecases.Fleet], Generator[object, None, None]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begin_early(monkeypatch)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    hosts = [
        Host(name=f"edge{n}", role=Role.EDGE, host=f"127.0.1.{n}", connection=Connection.LOCAL)
        for n in (3, 2, 1)
    ]
    transport = CountingTransport()
    site = usecases.Fleet(
        inventory=an_inventory(*hosts), tasks=some_tasks(), transport=transport, state=tmp_path / "manager"
    )
    with closing(run(site)) as rounds:
        for _ in range(100):
            before = len(transport.calls)
            next(rounds)
            if len(transport.calls) == before:
                break
        assert len(transport.calls) == before, "each round has calls"
        for _ in range(20):
            next(rounds)
        # One agent for as long as the connection lives: no other login, agent or call.
        assert len(transport.calls) == before
        assert sorted(transport.agents) == sorted(transport.logins) == ["edge1", "edge2", "edge3"]
    until(lambda: not list_agents(tmp_path))


class ScriptedExchange:
    """An agent that says what ``answer`` makes of each frame of the manager; None: its end."""

    def __init__(
        self, answer: Callable[[str, int, bytes], bytes | None], marker: str, is_free: Callable[[], bool]
    ) -> None:
        self.can_write = is_free
        self._answer, self._reader = answer, frames.FrameReader(frames.MANAGER_WORDS)
        self._said: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._said.put(b"Welcome\n" + frame_reply(marker, {"op": protocol.OP_CONVERSE}))

    def read(self, *, timeout: float) -> bytes:
        try:
            return self._said.get(timeout=timeout)
        except queue.Empty:
            raise DeadlineError("nothing came") from None

    def write(self, data: bytes, *, timeout: float) -> None:
        for each in self._reader.feed(data):
            answer = self._answer(*each)
            if answer != b"":
                self._said.put(answer or b"")

    def expect_more(self, size: int) -> None:
        """Have no limit."""

    def finish(self, data: bytes, *, timeout: float) -> None:
        self._said.put(b"")

    def expect_reply(self, *, timeout: float, limit: int) -> AbstractContextManager[None]:
        return nullcontext()

    def build_reply(self) -> Reply:
        return Reply(stdout=b"", stderr=b"", status=0)

    def close(self) -> None: ...


class RestingScript(ScriptedExchange):
    """The same on a line whose reader may rest; ``rested``: what it was told; ``awoke``: how often its reader
    did. It repeats what it loses after ``repeat_s``.
    """

    arrived_at = 0.0
    repeat_s: float | None = None

    def __init__(
        self, answer: Callable[[str, int, bytes], bytes | None], marker: str, is_free: Callable[[], bool]
    ) -> None:
        super().__init__(answer, marker, is_free)
        self.rested, self.awoke = [False], 0
        self._woken = threading.Event()

    def rest(self, *, resting: bool) -> None:
        self.rested.append(resting)

    def await_arrival(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not self._woken.wait(0.01):
            if not self.rested[-1] and not self._said.empty():
                break
        self._woken.clear()
        self.awoke += 1

    def wake(self) -> None:
        self._woken.set()

    def finish(self, data: bytes, *, timeout: float) -> None:
        super().finish(data, timeout=timeout)
        self.wake()

    def hold_writes(self) -> Callable[[], None]:
        return lambda: None

    def find_repeat_s(self) -> float | None:
        return self.repeat_s

    def has_arrived(self) -> bool:
        return not self._said.empty()


# (word, number, body) of a frame that came -> what the agent says to it
Answer = Callable[[str, int, bytes], bytes | None]


class ScriptedSession:
    """A host whose calls say ``by a call``, and whose agent is scripted; ``free``: it takes what is written."""

    python = "python3"
    free = True

    def __init__(self, answer: Answer, kind: type[ScriptedExchange] = ScriptedExchange) -> None:
        self.answer, self.begun, self.kind = answer, 0, kind
        self.opened: list[ScriptedExchange] = []

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        return Reply(stdout=b"by a call", stderr=b"", status=0)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        raise NotImplementedError

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> OpenExchange:
        raise NotImplementedError

    def converse(
        self, command: str, stdin: bytes, *, timeout: float, give_way: Callable[[], None]
    ) -> OpenExchange:
        self.begun += 1
        self.opened.append(self.kind(self.answer, unpack_request(stdin)[0], lambda: self.free))
        return self.opened[-1]

    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None: ...


STATUS = build_packet({"op": "status", "fleet": "lab", "host": "edge1", "task": None}, "0" * 32, 5.0)


def run_scripted(session: ConversingSession, *, timeout: float = ANSWERS_S, limit: int = 1000) -> bytes:
    return session.run(build_agent_command("python3"), STATUS, timeout=timeout, limit=limit).stdout


def answer_well(word: str, number: int, _body: bytes) -> bytes:
    if word != frames.ASK:
        return b""
    return frames.build_frame(frames.OUTPUT, number, b"shared") + frames.build_frame(frames.END, number, b"0")


def until_shared(session: ConversingSession) -> None:
    until(lambda: run_scripted(session) == b"shared")


HOSTILE: dict[str, Answer] = {
    "no frame": lambda *_: b"HTTP/1.1 400 Bad Request\n",
    "a frame without end": lambda *_: b"x" * 100,
    "a word of the manager": lambda _, number, __: frames.build_frame(frames.ASK, number, b"x"),
    "a huge frame": lambda *_: b"output 1 65537\n",
    "a negative length": lambda *_: b"output 1 -1\n",
    "its end": lambda *_: None,
    "a child that died": lambda _, number, __: frames.build_frame(frames.END, number, b"-9"),
    "a part and its end": lambda _, number, __: frames.build_frame(frames.OUTPUT, number, b"sha"),
    "a refusal": lambda _, number, __: frames.build_frame(frames.REFUSED, number),
    "too much": lambda _, number, __: frames.build_frame(frames.OUTPUT, number, b"x" * 1001),
    "another number": lambda _, number, __: (
        frames.build_frame(frames.OUTPUT, number + 1, b"shared")
        + frames.build_frame(frames.END, number + 1, b"0")
        + b"no frame\n"
    ),
}


def answer_until(hostile: threading.Event, attack: str) -> Answer:
    """Answers that are right until ``hostile`` is set; then requests are answered by the attack."""

    def answer(word: str, number: int, body: bytes) -> bytes | None:
        if not hostile.is_set() or word != frames.ASK:
            return answer_well(word, number, body)
        said = HOSTILE[attack](word, number, body)
        return said + b"no frame\n" if said is not None and attack == "a part and its end" else said

    return answer


@pytest.mark.parametrize("attack", HOSTILE)
def test_what_a_host_says_wrongly_costs_a_call_and_changes_nothing(attack: str) -> None:
    hostile = threading.Event()
    with ConversingSession(ScriptedSession(answer_until(hostile, attack))) as session:
        until_shared(session)
        hostile.set()
        assert run_scripted(session) == b"by a call"


def test_an_agent_that_ends_again_and_again_is_not_begun_again_and_again() -> None:
    within = ScriptedSession(lambda word, *_: None if word == frames.ASK else b"")
    with ConversingSession(within) as session:
        until(lambda: run_scripted(session) and within.begun and not list_threads())
        for _ in range(20):
            assert run_scripted(session) == b"by a call"
        assert within.begun == 1


class SilentExchange(ScriptedExchange):
    """An agent whose first word does not come, as on a host that is too busy."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._said.get()


def test_an_agent_that_says_nothing_is_begun_again_but_not_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(conversation, "REST_S", 0.0)
    monkeypatch.setattr(conversation, "HELLO_S", 0.05)
    within = ScriptedSession(answer_well, SilentExchange)
    with ConversingSession(within) as session:
        until(lambda: run_scripted(session) and within.begun == 3 and not list_threads(), every=0.01)
        for _ in range(20):
            assert run_scripted(session) == b"by a call"
        assert within.begun == 3


@pytest.mark.parametrize("silences", [1, 2])
def test_an_agent_whose_first_word_came_too_late_is_conversed_with_later(
    silences: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conversation, "REST_S", 0.0)
    monkeypatch.setattr(conversation, "HELLO_S", 0.05)
    within = ScriptedSession(answer_well, SilentExchange)
    with ConversingSession(within) as session:
        until(lambda: run_scripted(session) and within.begun == silences, every=0.01)
        until(lambda: not list_threads())
        monkeypatch.setattr(conversation, "HELLO_S", ANSWERS_S)
        within.kind = ScriptedExchange
        until_shared(session)


def test_three_refusals_in_a_row_end_it_and_three_such_agents_for_good(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(conversation, "REST_S", 0.0)
    asked: list[int] = []

    def refuse(word: str, number: int, _body: bytes) -> bytes:
        if word != frames.ASK:
            return b""
        asked.append(number)
        return frames.build_frame(frames.REFUSED, number)

    within = ScriptedSession(refuse)
    with ConversingSession(within) as session:
        until(lambda: run_scripted(session) and len(asked) == 9, every=0.01)
        for _ in range(5):
            assert run_scripted(session) == b"by a call"
    assert (len(asked), within.begun) == (9, 3)


def test_a_host_without_compiled_code_is_not_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As each is after an upgrade: the first requests of each operation are refused, also many beside each other."""
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.setattr(conversation, "PATIENCE_S", ANSWERS_S)
    monkeypatch.setattr(conversation, "HELLO_S", ANSWERS_S)
    fleet = Fleet(Host(name="edge1", role=Role.EDGE, host="localhost", connection=Connection.LOCAL))
    # Nor does the memory that tests share have the agent, or some of them removes it from there.
    with shared_memory(), fleet.pool, ThreadPoolExecutor(4) as pool:
        # Keeps the agent, and the code of a probe alone.
        fleet.ask("probe", window_s=0.0)
        fleet.pool.expect_requests(fleet.hosts)
        fleet.ask("status", task=None)
        list(pool.map(fleet.start, [f"task{n}" for n in range(4)]))
        assert {operation for _, operation in fleet.transport.calls} == {"probe", "status", "start", "wait"}
        assert fleet.transport.agents == ["edge1"]
        # On a busy machine it may have ended for silence, and begins again after a rest; one that is given up never does.
        until(fleet.is_conversed, describe=fleet.describe)
        began = list(fleet.transport.agents)
        del fleet.transport.calls[:]
        for n in range(4):
            fleet.start(f"later{n}")
        fleet.ask("probe", window_s=0.0)
        # Of code that grew one call may be needed.
        assert len(fleet.transport.calls) <= 2
        assert fleet.transport.agents == began
        for task in [f"{name}{n}" for name in ("task", "later") for n in range(4)]:
            fleet.stop(task)


def test_the_fourth_request_in_a_row_begins_a_conversation_and_does_not_wait_for_it() -> None:
    within = ScriptedSession(answer_well)
    with ConversingSession(within) as session:
        for _ in range(conversation.MIN_IN_ROW - 1):
            assert run_scripted(session) == b"by a call"
        assert within.begun == 0
        assert run_scripted(session) == b"by a call"
        until(lambda: within.begun == 1)


START = build_packet({"op": "start", "fleet": "lab", "host": "edge1", "task": "slam"}, "0" * 32, 5.0)
EXPECTED = Host(name="edge1", role=Role.EDGE, host="edge1")


def test_a_line_is_watched_closely_only_while_somebody_waits_for_it() -> None:
    scripted = ScriptedSession(answer_well, RestingScript)
    with closing(ConversingSession(scripted)) as session:
        until_shared(session)
        run_scripted(session)
        (exchange,) = scripted.opened
        assert isinstance(exchange, RestingScript)
        assert exchange.rested[-4:] == [False, True, False, True]


READINGS = build_packet({"op": "readings", "fleet": "lab", "host": "edge1"}, "0" * 32, 5.0)


def answer_with_readings(word: str, number: int, _body: bytes) -> bytes:
    if word != frames.ASK:
        return b""
    return frames.build_frame(frames.OUTPUT, number, frame_reply("0" * 32, {"v": 1}))


def test_a_reader_sleeps_on_while_its_readings_are_taken_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """And wakes up for what nobody takes up."""
    feeds: list[ReadingFeed] = []
    scripted = ScriptedSession(answer_well, RestingScript)
    with closing(ConversingSession(scripted, feeds.append)) as session:
        until_shared(session)
        scripted.opened[0]._answer = answer_with_readings
        session.run(build_agent_command("python3"), READINGS, timeout=ANSWERS_S, limit=1000)
        monkeypatch.setattr(conversation, "KEEP_S", 1.0)
        (exchange,), (feed,) = scripted.opened, feeds
        assert isinstance(exchange, RestingScript)
        assert feed.reading is not None
        assert exchange.rested[-1]
        awoke, pulses, deadline = exchange.awoke, 0, time.monotonic() + 3 * frames.PULSE_S
        while time.monotonic() < deadline:
            pulses += feed.find_reading() is not None
            time.sleep(0.02)
        assert exchange.awoke <= awoke + 1
        said = feed.reading.said_at
        monkeypatch.setattr(RestingScript, "arrived_at", said + 1.0)
        exchange._said.put(frames.build_frame(frames.OUTPUT, 2, frame_reply("0" * 32, {})))
        until(lambda: exchange.awoke > awoke + 1)


def begin_readings(session: ConversingSession, scripted: ScriptedSession) -> RestingScript:
    """Ask for readings over a conversation, whose line it returns."""
    until_shared(session)
    scripted.opened[0]._answer = answer_with_readings
    session.run(build_agent_command("python3"), READINGS, timeout=ANSWERS_S, limit=1000)
    (exchange,) = scripted.opened
    assert isinstance(exchange, RestingScript)
    return exchange


def test_a_heartbeat_goes_over_the_conversation_and_nobody_waits_for_it() -> None:
    feeds: list[ReadingFeed] = []
    asked: list[bytes] = []
    scripted = ScriptedSession(answer_well, RestingScript)
    with closing(ConversingSession(scripted, feeds.append)) as session:
        exchange = begin_readings(session, scripted)
        (feed,) = feeds

        def listen(word: str, _number: int, body: bytes) -> bytes:
            asked.extend([body] if word == frames.ASK else [])
            return b""

        exchange._answer = listen
        assert feed.take_up is not None
        assert feed.send_heartbeat is not None
        first = feed.send_heartbeat()
        assert first is not None
        assert exchange.rested[-1]
        head, _, request = asked[0].partition(b"\n")
        assert head.split()[0] == first.marker.encode() != b"0" * 32
        assert int(head.split()[2]) == len(request)
        assert json.loads(request) == {"op": "readings", "fleet": "lab", "host": "edge1", "rounds": 0}
        exchange._said.put(frames.build_frame(frames.OUTPUT, 3, frame_reply(first.marker, {})))
        until(lambda: feed.take_up() or first.whole)  # type: ignore[misc]
        exchange._said.put(frames.build_frame(frames.END, 3, b"0"))
        until(lambda: feed.take_up() or first.is_over)  # type: ignore[misc]
        assert first.whole
        second = feed.send_heartbeat()
        assert second is not None
        exchange._said.put(frames.build_frame(frames.REFUSED, 4))
        until(lambda: feed.take_up() or second.is_over)  # type: ignore[misc]
        assert not second.whole
        scripted.free = False
        assert feed.send_heartbeat() is None
        scripted.free = True
        third = feed.send_heartbeat()
        assert third is not None
    assert third.is_over
    assert not third.whole
    assert feed.send_heartbeat() is None


def test_a_near_host_gets_its_pulses_at_a_slower_pace() -> None:
    """As often as the kernel can lose a pulse twice and the agent still hears it in time."""
    assert pulses.compute_pulse_s(None) == pulses.compute_pulse_s(0.31) == frames.PULSE_S
    assert pulses.compute_pulse_s(0.2) == pulses.compute_pulse_s(0.3) == pulses.NEAR_PULSE_S
    # Lost, and its repetition too: 0.2 s, then 0.4 s later.
    assert pulses.NEAR_PULSE_S + 0.2 + 0.4 < frames.SILENCE_S
    times: dict[float | None, list[float]] = {0.2: [], 1.0: [], None: []}
    with ExitStack() as stack:
        for repeat_s, sent in times.items():

            def send(
                repeat_s: float | None = repeat_s, sent: list[float] = sent
            ) -> tuple[float, Callable[[], None]]:
                sent.append(time.monotonic())
                return pulses.compute_pulse_s(repeat_s), lambda: None

            stack.enter_context(pulses.keep_pulsing(send))
        until(lambda: len(times[0.2]) >= 7)
        near, far = (len(times[each]) for each in (0.2, 1.0))
    assert len(times[None]) - far in (-1, 0, 1)
    assert near < far
    pauses = [after - before for before, after in itertools.pairwise(times[0.2][1:])]
    assert all(pause >= pulses.NEAR_PULSE_S - 0.3 for pause in pauses)


def run_start(session: ConversingSession) -> bytes:
    return session.run(build_agent_command("python3"), START, timeout=ANSWERS_S).stdout


def test_expected_requests_wait_for_the_conversation_and_change_by_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(conversation, "PATIENCE_S", ANSWERS_S)
    within = ScriptedSession(answer_well)
    with ConversingSession(within) as session:
        session.expect_requests(EXPECTED)
        assert [run_scripted(session), run_start(session)] == [b"shared", b"shared"]
        session.expect_requests(EXPECTED)
        assert within.begun == 1


def test_what_changes_something_has_a_call_where_it_is_not_expected() -> None:
    with ConversingSession(ScriptedSession(answer_well)) as session:
        until_shared(session)
        assert run_start(session) == b"by a call"
        session.expect_requests(EXPECTED)
        assert run_start(session) == b"shared"


@pytest.mark.parametrize("attack", HOSTILE)
def test_a_change_is_never_begun_twice_unseen(attack: str) -> None:
    """Where nobody knows whether it was carried out, its asker hears so, and asks over a new connection."""
    hostile = threading.Event()
    with ConversingSession(ScriptedSession(answer_until(hostile, attack))) as session:
        until_shared(session)
        session.expect_requests(EXPECTED)
        hostile.set()
        ask = partial(session.run, build_agent_command("python3"), START, timeout=ANSWERS_S, limit=1000)
        if attack == "a refusal":
            assert ask().stdout == b"by a call"
        else:
            with pytest.raises(ConnectError, match="ended before it had replied"):
                ask()


def test_a_host_that_keeps_no_agent_costs_expected_requests_little(monkeypatch: pytest.MonkeyPatch) -> None:
    class Refusing(ScriptedSession):
        def converse(self, *_given: object, **_options: object) -> OpenExchange:
            self.begun += 1
            raise ConnectError("no room")

    monkeypatch.setattr(conversation, "PATIENCE_S", 1e6)
    within = Refusing(answer_well)
    with ConversingSession(within) as session:
        for _ in range(3):
            session.expect_requests(EXPECTED)
            assert [run_scripted(session), run_start(session)] == [b"by a call", b"by a call"]
    assert within.begun == 1


def test_requests_far_apart_have_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    within = ScriptedSession(answer_well)
    monkeypatch.setattr(conversation, "KEEP_S", 0.09)
    with ConversingSession(within) as session:
        for _ in range(8):
            for _ in range(conversation.MIN_IN_ROW - 1):
                assert run_scripted(session) == b"by a call"
            time.sleep(0.1)
        assert within.begun == 0


def test_one_thread_sends_all_pulses_and_waits_for_no_host() -> None:
    """A host that takes nothing, whether it says so or not, has a thread of its own, and one at a time."""
    pulses: list[tuple[int, threading.Thread]] = []
    stuck, over = threading.Event(), threading.Event()

    def answer(index: int) -> Answer:
        def say(word: str, number: int, body: bytes) -> bytes:
            if word == frames.PULSE:
                pulses.append((index, threading.current_thread()))
                if index == 0 and stuck.is_set():
                    over.wait(ANSWERS_S)
            return answer_well(word, number, body)

        return say

    with ExitStack() as stack:
        stack.callback(over.set)
        sessions = [ScriptedSession(answer(index)) for index in range(8)]
        for each in sessions:
            until_shared(stack.enter_context(ConversingSession(each)))
        until(lambda: {index for index, _ in pulses} == set(range(8)))
        assert len({thread.ident for _, thread in pulses}) == 1
        # Still open, so their agents live.
        sessions[0].free = False
        stuck.set()
        del pulses[:]
        until(lambda: all(sum(index == each for each, _ in pulses) >= 3 for index in range(1, 8)))
        own = [thread for index, thread in pulses if index == 0]
        assert len(own) == 1
        assert {thread.name for index, thread in pulses if index} == {"edgectl-pulse"} != {own[0].name}
    until(lambda: not any(each.name == "edgectl-pulse" for each in threading.enumerate()))


def test_a_conversation_that_nobody_uses_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conversation, "REST_S", 0.0)
    within = ScriptedSession(answer_well)
    with ConversingSession(within) as session:
        until_shared(session)
        monkeypatch.setattr(conversation, "KEEP_S", 0.0)
        until(lambda: not list_threads())
        monkeypatch.undo()
        assert run_scripted(session) == b"by a call"


def test_a_deadline_and_an_interruption_reach_the_asker() -> None:
    silent = threading.Event()
    with ConversingSession(
        ScriptedSession(lambda *given: b"" if silent.is_set() else answer_well(*given))
    ) as session:
        until_shared(session)
        silent.set()
        with pytest.raises(DeadlineError, match=r"no answer within 0.1 s$"):
            run_scripted(session, timeout=0.1)


class OverdueSession(ScriptedSession):
    """A host that nobody hears any more."""

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        raise DeadlineError(f"no answer within {timeout:.3g} s", host="edge1")


def test_a_deadline_states_the_time_that_was_asked_for_and_not_what_was_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(conversation, "PATIENCE_S", 0.5)
    with ConversingSession(OverdueSession(answer_well, SilentExchange)) as session:
        session.expect_requests(EXPECTED)
        with pytest.raises(DeadlineError, match=r"^no answer within 30 s$") as raised:
            run_scripted(session, timeout=30.0)
    assert raised.value.host == "edge1"


def test_a_request_that_is_longer_than_a_frame_has_a_call() -> None:
    links = [{"robot": f"robot{n}", "address": f"10.0.{n // 250}.{n % 250}"} for n in range(2000)]
    request = {"op": "probe", "fleet": "lab", "host": "edge1", "links": links}
    packet = build_packet(request, "0" * 32, 5.0)
    with ConversingSession(ScriptedSession(answer_well)) as session:
        until_shared(session)
        assert session.run(build_agent_command("python3"), packet, timeout=ANSWERS_S).stdout == b"by a call"
        assert run_scripted(session) == b"shared"


def test_slices_of_one_machine_share_few_agents() -> None:
    staying: dict[str, set[str]] = {}

    def count_shared(hosts: list[Host]) -> int:
        sessions = [
            conversation.share_agent(ScriptedSession(answer_well), host, lambda each: each.host, staying)
            for host in hosts
        ]
        return sum(isinstance(each, ConversingSession) for each in sessions)

    slices = [Host(name=f"slice{n}", role=Role.EDGE, host="10.0.0.1") for n in range(20)]
    assert [count_shared(slices), count_shared(slices[:3]), count_shared(slices[12:])] == [8, 3, 0]
    assert count_shared([Host(name="other", role=Role.EDGE, host="10.0.0.2")]) == 1
    here = [
        Host(name=f"here{n}", role=Role.EDGE, host=f"127.0.0.{n}", connection=Connection.LOCAL)
        for n in range(20)
    ]
    assert count_shared(here) == 8
    programs = [
        Host(name=f"far{n}", role=Role.EDGE, host=f"10.1.0.{n}", connection=Connection.OPENSSH)
        for n in range(80)
    ]
    assert count_shared(programs) == 64


def test_a_plain_session_stays_plain() -> None:
    class Plain(ScriptedSession):
        converse = None  # type: ignore[assignment]

    class Only:
        def connect(self, host: Host, *, timeout: float) -> Session:
            return Plain(answer_well)

        def address(self, host: Host) -> str:
            raise ConnectError("nowhere")

    host = Host(name="edge1", role=Role.EDGE, host="localhost")
    with SessionPool(Only(), converse=True) as pool, pool.connect(host, timeout=1.0) as session:
        for _ in range(3):
            assert session.run(build_agent_command("python3"), STATUS, timeout=5.0).stdout == b"by a call"
