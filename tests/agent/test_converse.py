# SPDX-License-Identifier: Apache-2.0
"""The agent that stays, as a real process over pipes: requests beside each other, and every way to end."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link import frames, protocol
from edgectl.agent.measure import proc
from edgectl.errors import RefusedError
from edgectl.transport.agent_archive import build_agent_zipapp
from edgectl.transport.agent_client import build_agent_command, build_packet, find_payload, split_frame
from tests.agent.conftest import AgentHost, a_spec, eventually, is_running
from tests.pace import patience

MARKER = "ab" * 16
DEADLINE_S = patience(30.0)
# A request that nothing ends.
ENDLESS: dict[str, Any] = {"task": "slam", "instance": "i1", "timeout_s": 600.0, "up_s": 1e6}


def strip_programs(packet: bytes) -> bytes:
    for _ in range(2):
        size, _, rest = packet.partition(b"\n")
        packet = rest[int(size) :]
    return packet


class StayingAgent:
    """The manager's end of one agent that stays; pulses as long as ``pulsing``."""

    def __init__(self, host: AgentHost) -> None:
        self.host, self.pulsing, self.closed = host, True, False
        self.process = subprocess.Popen(
            ["/bin/sh", "-c", build_agent_command(sys.executable)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
            # As sshd starts it, also where this suite was started by nohup.
            preexec_fn=partial(signal.signal, signal.SIGHUP, signal.SIG_DFL),
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.input, self.output = self.process.stdin, self.process.stdout.fileno()
        self.reader, self.lock = frames.FrameReader(frames.HOST_WORDS), threading.Lock()
        self.said: dict[int, bytes] = {}
        self.ended: dict[int, str] = {}
        self.send(build_packet(self.document("converse"), MARKER, DEADLINE_S))
        greeting = b""
        while (found := split_frame(greeting, MARKER)) is None:
            greeting += self.read()
        assert json.loads(found[0]) == {"op": "converse"}
        self.take(found[1])
        self.thread = threading.Thread(target=self.pulse)
        self.thread.start()

    def document(self, op: str, **fields: object) -> dict[str, object]:
        return {"op": op, "fleet": self.host.fleet, "host": self.host.name, **fields}

    def send(self, data: bytes) -> None:
        with self.lock, contextlib.suppress(BrokenPipeError):
            self.input.write(data)

    def pulse(self) -> None:
        while not self.closed:
            if self.pulsing:
                self.send(frames.build_frame(frames.PULSE))
            time.sleep(0.2)

    def ask(self, number: int, op: str, *, timeout: float = DEADLINE_S, **fields: object) -> None:
        packet = build_packet(self.document(op, **fields), MARKER, timeout)
        self.send(frames.build_frame(frames.ASK, number, strip_programs(packet)))

    def read(self) -> bytes:
        assert select.select([self.output], [], [], DEADLINE_S)[0], "it says nothing"
        data = os.read(self.output, 65536)
        assert data, "it has ended"
        return data

    def take(self, data: bytes) -> None:
        for word, number, body in self.reader.feed(data):
            if word == frames.OUTPUT:
                self.said[number] = self.said.get(number, b"") + body
            else:
                self.ended[number] = body.decode() if word == frames.END else word

    def wait(self, number: int) -> str:
        """The exit status of a request, or ``refused``."""
        while number not in self.ended:
            self.take(self.read())
        return self.ended[number]

    def reply(self, number: int) -> dict[str, Any]:
        assert self.wait(number) == "0"
        payload = find_payload(self.said[number], MARKER)
        assert payload is not None
        return dict(json.loads(payload))

    def children(self) -> set[int]:
        return {pid for pid, each in proc.read_process_table().items() if each.ppid == self.process.pid}

    def close(self) -> None:
        self.closed = True
        self.thread.join()
        self.process.kill()
        self.process.wait()
        self.input.close()
        assert self.process.stdout is not None
        self.process.stdout.close()


@contextmanager
def open_agent(host: AgentHost) -> Iterator[StayingAgent]:
    staying = StayingAgent(host)
    try:
        yield staying
    finally:
        staying.close()


@pytest.fixture
def staying(host: AgentHost) -> Iterator[StayingAgent]:
    """An agent that stays, on a host that keeps the code of what is asked."""
    host.ask("status", task=None)
    host.ask("wait", task="slam", instance="i1", timeout_s=0.0)
    host.ask("logs", task="slam", tail=1)
    with open_agent(host) as found:
        yield found


def test_requests_beside_each_other_do_not_wait_for_the_one_that_hangs(staying: StayingAgent) -> None:
    staying.host.start("slam", "exec sleep 600")
    staying.host.ask("wait", task="slam", instance="i1", timeout_s=0.0)
    staying.ask(3, "wait", **ENDLESS)
    staying.ask(2, "status", task=None)
    staying.ask(1, "probe", window_s=0.3)
    assert staying.reply(2)["tasks"].keys() == {"slam"}
    assert staying.reply(1)["tasks"]["slam"]["used_bytes"] > 0
    assert 3 not in staying.ended
    staying.host.stop("slam")
    assert staying.reply(3)["state"] == "failed"


def test_a_deadline_ends_the_request_on_the_host_alone(staying: StayingAgent) -> None:
    staying.host.start("slam", "exec sleep 600")
    staying.host.ask("wait", task="slam", instance="i1", timeout_s=0.0)
    staying.ask(1, "wait", timeout=0.5, **ENDLESS)
    assert staying.wait(1) == str(-signal.SIGALRM)
    staying.ask(2, "status", task=None)
    assert staying.reply(2)["tasks"]["slam"]["state"] in ("starting", "running")


def test_a_killed_child_is_reported_and_costs_the_others_nothing(staying: StayingAgent) -> None:
    staying.host.start("slam", "exec sleep 600")
    staying.host.ask("wait", task="slam", instance="i1", timeout_s=0.0)
    staying.ask(1, "wait", **ENDLESS)
    (child,) = eventually(staying.children)
    staying.ask(2, "wait", **ENDLESS)
    eventually(lambda: len(staying.children()) == 2)
    os.kill(child, signal.SIGKILL)
    assert staying.wait(1) == str(-signal.SIGKILL)
    assert 2 not in staying.ended


def end_by_silence(staying: StayingAgent) -> None:
    staying.pulsing = False


def end_by_input(staying: StayingAgent) -> None:
    staying.pulsing = False
    with staying.lock:
        staying.input.close()


def end_by_noise(staying: StayingAgent) -> None:
    staying.send(b"GET / HTTP/1.1\n")


def end_by_a_huge_frame(staying: StayingAgent) -> None:
    staying.send(b"ask 7 99999999\n")


def end_by_sigterm(staying: StayingAgent) -> None:
    staying.process.terminate()


def end_by_sigkill(staying: StayingAgent) -> None:
    staying.process.kill()


def end_by_hangup_of_all(staying: StayingAgent) -> None:
    """As sshd ends a session: a hangup of the whole group of processes of the login."""
    os.killpg(staying.process.pid, signal.SIGHUP)


ENDS = [end_by_silence, end_by_input, end_by_noise, end_by_a_huge_frame]


@pytest.mark.parametrize("end", ENDS)
def test_it_ends_with_its_manager_and_with_the_requests_that_only_read(
    staying: StayingAgent, end: Callable[[StayingAgent], None]
) -> None:
    staying.host.start("slam", "exec sleep 600")
    staying.host.ask("wait", task="slam", instance="i1", timeout_s=0.0)
    staying.ask(1, "wait", **ENDLESS)
    children = eventually(staying.children)
    began = time.monotonic()
    end(staying)
    staying.process.wait(DEADLINE_S)
    assert time.monotonic() - began < patience(2.0)
    assert staying.process.returncode == 0
    eventually(lambda: not any(is_running(pid) for pid in children))


@pytest.mark.parametrize("end", [*ENDS, end_by_sigterm, end_by_sigkill, end_by_hangup_of_all])
def test_what_it_has_started_lives_on(host: AgentHost, end: Callable[[StayingAgent], None]) -> None:
    """Task and supervisor, which go on writing the log; also while it was ended with all of its login."""
    keep_code_of_changes(host)
    spec = a_spec("while :; do echo up; sleep 0.1; done", runtime="process", restart="always")
    with open_agent(host) as staying:
        staying.ask(1, "start", task="slam", instance="i1", generation=1, spec=spec)
        assert staying.reply(1)["state"] == "started"
        host.until("slam", "running")
        members, supervisor = host.members("slam"), host.supervisor("slam")
        end(staying)
        staying.process.wait(DEADLINE_S)
    log = host.folder("slam")
    written = sum(each.stat().st_size for each in log.rglob("*") if each.is_file())
    eventually(lambda: sum(each.stat().st_size for each in log.rglob("*") if each.is_file()) != written)
    assert host.supervisor("slam") == supervisor
    assert is_running(supervisor)
    # The loop's shell; each of its sleeps is a process of its own, which ends by itself.
    assert any(is_running(pid) for pid in host.members("slam") & members)
    entry = host.entry("slam")
    assert entry is not None
    assert (entry["state"], entry["restarts"]) == ("running", 0)


def test_what_came_while_it_was_frozen_is_not_begun(staying: StayingAgent) -> None:
    """Its manager has given up, and may count on the time of the last contact."""
    staying.process.send_signal(signal.SIGSTOP)
    staying.ask(1, "status", task=None)
    time.sleep(frames.SILENCE_S + 0.2)
    staying.process.send_signal(signal.SIGCONT)
    assert staying.process.wait(DEADLINE_S) == 0
    assert os.read(staying.output, 1) == b""


# Stops once, where an agent is between its look at the line and its read.
FREEZING = """
import os, signal, types
from edgectl.agent.link import converse
agent = converse._StayingAgent(types.SimpleNamespace(folder="", sha=""), types.SimpleNamespace(fd=1), [], None)
agent._begin = lambda number, packet: print("begun", flush=True)
read = os.read
def freeze_and_read(fd, size):
    os.read = read
    os.kill(os.getpid(), signal.SIGSTOP)
    return read(fd, size)
os.read = freeze_and_read
agent.serve()
"""


def test_what_came_while_it_was_frozen_before_a_read_is_not_begun() -> None:
    command = [sys.executable, "-c", FREEZING]
    with subprocess.Popen(command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        process.stdin.write(frames.build_frame(frames.PULSE) + frames.build_frame(frames.ASK, 1, b"words\n"))
        os.waitpid(process.pid, os.WUNTRACED)
        time.sleep(frames.SILENCE_S + 0.2)
        process.send_signal(signal.SIGCONT)
        said, _ = process.communicate(timeout=DEADLINE_S)
    assert (said, process.returncode) == (b"", 0)


def test_pulses_keep_it(staying: StayingAgent) -> None:
    time.sleep(frames.SILENCE_S + 0.5)
    staying.ask(1, "status", task=None)
    assert staying.reply(1)["tasks"] == {}


def test_a_manager_that_reads_nothing_does_not_hold_it(staying: StayingAgent) -> None:
    """It never waits for the line: silence ends it although a reply cannot be sent."""
    staying.host.start("chat", "for i in $(seq 20000); do echo line $i of a log; done; exec sleep 600")
    eventually(lambda: "line 20000" in staying.host.ask("logs", task="chat", tail=1)["text"])
    for number in range(1, 5):
        staying.ask(number, "logs", task="chat", tail=15000)
    eventually(lambda: len(staying.children()) >= 1)
    staying.pulsing = False
    assert staying.process.wait(DEADLINE_S) == 0


def test_its_end_by_a_signal_ends_neither_tasks_nor_what_is_asked_next(staying: StayingAgent) -> None:
    staying.host.start("slam", "exec sleep 600")
    members = staying.host.members("slam")
    staying.process.kill()
    staying.process.wait()
    with open_agent(staying.host) as another:
        another.ask(1, "status", task=None)
        assert another.reply(1)["tasks"].keys() == {"slam"}
    assert all(is_running(pid) for pid in members)


def test_what_it_may_not_carry_is_refused_and_not_begun(staying: StayingAgent) -> None:
    host = staying.host
    host.start("slam", "exec sleep 600")
    staying.ask(1, "forget", task="slam", master="", nodes={})
    status = strip_programs(build_packet(staying.document("status", task=None), MARKER, DEADLINE_S))
    head, _, body = status.partition(b"\n")
    words = head.split()
    changed = {
        2: [words[0], b"0" * 64, *words[2:]],
        3: [*words[:5], b"other-key", words[6]],
        4: [*words[:6], b"takeover"],
        5: [*words[:2], b"9999", *words[3:]],
        6: words[:6],
    }
    for number, each in changed.items():
        staying.send(frames.build_frame(frames.ASK, number, b" ".join(each) + b"\n" + body))
    packet = build_packet(staying.document("status", task=None), MARKER, DEADLINE_S, b"an agent")
    staying.send(frames.build_frame(frames.ASK, 8, strip_programs(packet)))
    for number in (1, *changed, 8):
        assert staying.wait(number) == frames.REFUSED, number
    assert staying.said == {}
    assert host.entry("slam") is not None
    staying.ask(9, "status", task=None)
    assert staying.reply(9)["tasks"].keys() == {"slam"}


def keep_code_of_changes(host: AgentHost) -> None:
    host.start("before", "exec sleep 600")
    host.stop("before")


def test_it_starts_tasks_as_a_call_does(staying: StayingAgent) -> None:
    """Twice the same start is one; what is started needs neither the agent nor more memory than by a call."""
    host = staying.host
    keep_code_of_changes(host)
    spec = a_spec("trap '' HUP TERM; echo up; while :; do sleep 600; done", runtime="process")
    # The first one on a host has compiled its own code, which takes memory.
    with open_agent(host) as another:
        for number in (1, 2):
            another.ask(number, "start", task="slam", instance="i1", generation=1, spec=spec)
        states = {another.reply(number)["state"] for number in (1, 2)}
        pid = another.process.pid
    assert states == {"started", "already-running"}
    host.start("called", "exec sleep 600")
    host.until("slam", "running")
    by_agent, by_call = (host.supervisor(task) for task in ("slam", "called"))
    assert os.getsid(by_agent) not in (pid, os.getsid(0))
    assert read_rss_kib(by_agent) < read_rss_kib(by_call) + 1024
    assert sorted(read_open_files(by_agent)) == sorted(read_open_files(by_call))


def read_rss_kib(pid: int) -> int:
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(status.partition("VmRSS:")[2].split()[0])


def read_open_files(pid: int) -> list[str]:
    """What a supervisor has open; the numbers of pipes, and the paths within the directory of its task, left out."""
    links = [os.readlink(each) for each in Path(f"/proc/{pid}/fd").iterdir()]  # noqa: PTH115 - of links that lead nowhere
    return [each.partition(":")[0] if ":[" in each else Path(each).name for each in links]


@pytest.mark.parametrize("end", [end_by_silence, end_by_input])
def test_a_change_under_way_outlives_it(staying: StayingAgent, end: Callable[[StayingAgent], None]) -> None:
    host = staying.host
    keep_code_of_changes(host)
    host.start("slam", "trap '' TERM; echo up; while :; do sleep 1; done")
    eventually(lambda: "up" in host.ask("logs", task="slam", tail=1)["text"])
    grace = {"signal": "TERM", "grace_s": 2.0 * frames.SILENCE_S, "preset": None}
    staying.ask(1, "stop", task="slam", instance=None, generation=None, stop=grace)
    children = eventually(staying.children)
    end(staying)
    staying.process.wait(DEADLINE_S)
    assert all(is_running(pid) for pid in children)
    eventually(lambda: not any(is_running(pid) for pid in children))
    assert host.entry("slam") is None


def test_code_that_is_not_kept_yet_is_left_to_a_call_of_its_own(staying: StayingAgent) -> None:
    for code in (staying.host.state / "agent").rglob("logs.*.code"):
        code.unlink()
    asked: dict[str, Any] = {"task": "slam", "tail": 1, "since_s": None, "previous": False}
    staying.ask(1, "logs", **asked)
    assert staying.wait(1) == frames.REFUSED
    staying.host.start("slam", "echo up; exec sleep 600")
    eventually(lambda: "up" in staying.host.ask("logs", **asked)["text"])
    staying.ask(2, "logs", **asked)
    assert "up" in staying.reply(2)["text"]


def test_an_agent_that_was_removed_from_the_host_is_sent_again_by_a_call(staying: StayingAgent) -> None:
    """Streams and held requests rely on it, and cannot send it."""
    host = staying.host
    (kept,) = (host.state / "agent").glob("*.pyz")
    kept.unlink()
    staying.ask(1, "status", task=None)
    assert staying.wait(1) == frames.REFUSED
    host.ask("status", task=None)
    assert kept.exists()
    staying.ask(2, "status", task=None)
    assert staying.reply(2)["tasks"] == {}


def test_code_that_grew_is_kept_by_a_call_of_its_own_and_loaded_again(staying: StayingAgent) -> None:
    """A module that a child had to compile is not compiled by every child from then on."""
    host = staying.host
    host.ask("probe", window_s=0.0)
    staying.ask(1, "probe", window_s=0.0)
    staying.reply(1)
    staying.ask(2, "probe", window_s=0.0, totals=True)
    assert "totals" in staying.reply(2)
    staying.ask(3, "probe", window_s=0.0, totals=True)
    assert staying.wait(3) == frames.REFUSED
    host.ask("probe", window_s=0.0, totals=True)
    for number in (4, 5):
        staying.ask(number, "probe", window_s=0.0, totals=True)
        assert "totals" in staying.reply(number)


def test_a_refusal_of_the_agent_is_a_reply(staying: StayingAgent) -> None:
    signature = {"holder": "ana", "session": "s1", "epoch": 1}
    with pytest.raises(RefusedError):
        staying.host.ask("lease", action="renew", lease=signature)
    staying.ask(1, "lease", action="renew", lease=signature)
    assert staying.reply(1)["error"]["kind"] == "not-holder"


# One request of each operation that an agent which stays carries, in an order in which all are carried out.
EACH_REQUEST: list[tuple[str, dict[str, Any]]] = [
    ("start", {"task": "slam", "instance": "i1", "generation": 1, "spec": a_spec("exec sleep 600", runtime="process")}),
    ("mark", {"task": "slam", "instance": "i1", "ready": True, "leaving_s": None}),
    ("status", {"task": None}),
    ("wait", {"task": "slam", "instance": "i1", "timeout_s": 0.0}),
    ("logs", {"task": "slam", "tail": 1}),
    ("probe", {"window_s": 0.0, "links": [{"robot": "robot1", "address": "127.0.0.1"}]}),
    ("readings", {"window_s": 0.0, "every_s": 0.05, "rounds": 2}),
    ("lease", {"action": "release", "lease": {"holder": "ana", "session": "s1", "epoch": 1}}),
    ("stop", {"task": "slam", "instance": None, "generation": None, "stop": None}),
]  # fmt: skip
MOST_BYTES = 13_000_000


def test_it_is_small_after_all_that_it_carries_does_not_grow_and_leaves_no_zombie(host: AgentHost) -> None:
    for op, fields in EACH_REQUEST:
        # Of a lease that is not there.
        with contextlib.suppress(RefusedError):
            host.ask(op, **fields)
    assert {op for op, _ in EACH_REQUEST} == {*protocol.CONVERSED_OPS, *protocol.CONVERSED_CHANGES}
    with open_agent(host) as staying:
        for number, (op, fields) in enumerate(EACH_REQUEST, start=1):
            staying.ask(number, op, **fields)
            assert staying.wait(number) == "0", op
        pid, sizes = staying.process.pid, []
        for number in range(100, 300):
            staying.ask(number, ("probe", "status")[number % 2], task=None, window_s=0.0)
            assert staying.wait(number) == "0"
            sizes.append(1024 * read_rss_kib(pid))
        assert max(sizes) <= MOST_BYTES
        assert sizes[-1] <= sizes[9] + 65536
        assert Path(f"/proc/{pid}/task/{pid}/children").read_text() == ""
        assert len(list(Path(f"/proc/{pid}/fd").iterdir())) <= 5


def test_the_first_one_on_a_host_is_as_small_as_later_ones(host: AgentHost) -> None:
    """To compile leaves 5 MB in the memory of the process that does it: a child."""
    sizes = []
    for _ in range(2):
        with open_agent(host) as staying:
            sizes.append(read_rss_kib(staying.process.pid))
    assert sizes[0] < sizes[1] + 1024


def test_where_no_agent_can_be_kept_there_is_no_conversation(host: AgentHost) -> None:
    """Without a cache a child could not load its code; the reply says so, and calls go on."""
    program = (
        f"import sys; sys.path.insert(0, {str(Path(frames.__file__).parent)!r})\nimport boot\n"
        "words = sys.stdin.buffer.readline().split()\n"
        "boot.boot_agent(sys.stdin.buffer, words, [b'/proc/nowhere', b'/proc/nowhere-else'], b'')\n"
    )
    packet = build_packet(
        {"op": "converse", "fleet": host.fleet, "host": host.name}, MARKER, DEADLINE_S, build_agent_zipapp()
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", program],
        input=strip_programs(packet),
        capture_output=True,
        check=False,
        timeout=DEADLINE_S,
    )
    payload = find_payload(done.stdout, MARKER)
    assert payload is not None, done.stderr
    assert json.loads(payload)["error"]["kind"] == "no-cache"
