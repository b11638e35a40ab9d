# SPDX-License-Identifier: Apache-2.0
"""Log files: bounded, clipped, lost bytes counted, read back and followed."""

import os
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from edgectl.agent.supervise import liveness
from edgectl.agent.supervise.logfile import MAX_LINE_BYTES, LogWriter, read_log_tail
from edgectl.transport.agent_client import stream_agent_log
from tests.agent.conftest import AgentHost, both_runtimes, eventually
from tests.agent.little_room import write_with_little_room
from tests.pace import patience


def sizes(folder: Path) -> dict[str, int]:
    found = {}
    for path in sorted(folder.glob("log.*")):
        with suppress(FileNotFoundError):  # while the log rotates
            found[path.name] = path.stat().st_size
    return found


def test_files_rotate_within_their_bound(tmp_path: Path) -> None:
    log = LogWriter(str(tmp_path), 10_000, 3)
    lines = [b"line %05d\n" % number for number in range(5000)]
    for at in range(0, 5000, 7):
        log.write(b"".join(lines[at : at + 7]))
    assert sizes(tmp_path) == {"log.0": 5000 * 11 % 10_000, "log.1": 10_000, "log.2": 10_000}
    assert read_log_tail(str(tmp_path), 3) == b"".join(lines[-3:])
    assert read_log_tail(str(tmp_path), 10**6).endswith(b"".join(lines[-2200:]))
    assert log.dropped == 0


def test_long_lines_are_clipped_and_marked(tmp_path: Path) -> None:
    log = LogWriter(str(tmp_path), 1 << 20, 2)
    log.write(b"a" * 10_000)
    log.write(b"a" * 10_000)
    log.write(b"a" * 10_000 + b"\nshort\n" + b"b" * 20_000 + b"\n")
    assert (tmp_path / "log.0").read_bytes() == (
        b"a" * MAX_LINE_BYTES + b" [clipped]\nshort\n" + b"b" * MAX_LINE_BYTES + b" [clipped]\n"
    )


def test_disk_trouble_is_counted_and_does_not_raise(tmp_path: Path) -> None:
    assert write_with_little_room(tmp_path, [b"x" * 999 + b"\n"] * 10, max_bytes=100_000) == 5000
    assert sizes(tmp_path) == {"log.0": 5000}


@both_runtimes
def test_spam_of_a_task_stays_within_the_bound(host: AgentHost) -> None:
    host.start(
        "spam",
        "head -c 3000000 /dev/zero | tr '\\0' 'x'; echo; seq 100000; echo last",
        log={"max_bytes": 50_000, "files": 3},
    )
    host.until("spam", "failed")
    assert sum(sizes(host.folder("spam")).values()) <= 150_000
    assert host.ask("logs", task="spam", tail=2)["text"] == "100000\nlast\n"


SPAM = """
import os, sys, time
block, began = {block}, time.monotonic()
for number in range(35):
    os.write(1, block)
    time.sleep(max(0.0, began + (number + 1) * 0.1 - time.monotonic()))
os.write(1, b"\\nlast after %.1f s\\n" % (time.monotonic() - began))
"""


@pytest.mark.parametrize(
    "block",
    ["b'0123456789abcde\\n' * 62500", "b'x' * 1000000", "bytes(1000000)", "(bytes(99) + b'\\n') * 10000"],
)
def test_ten_megabytes_a_second_stay_within_three_files_of_ten(
    host: AgentHost, tmp_path: Path, block: str
) -> None:
    """35 MB as lines, without a newline, as zeros, and as lines of zeros; the task is never blocked."""
    (tmp_path / "spam.py").write_text(SPAM.format(block=block))
    limit = 10 * 2**20
    host.start("spam", f"exec {sys.executable} -S {tmp_path}/spam.py", log={"max_bytes": limit, "files": 3})
    while not (entry := host.entry("spam")) or entry["state"] == "running":
        found = sizes(host.folder("spam"))
        assert len(found) <= 3
        assert all(size <= limit for size in found.values())
        time.sleep(0.1)
    (last,) = host.ask("logs", task="spam", tail=1)["text"].splitlines()
    assert last.startswith("last after ")
    assert float(last.split()[2]) < 15.0, "3.5 s of work; a pump that blocks holds it up for good"
    trace = liveness.read_instance(str(host.folder("spam")))
    assert (trace.status["exit_code"], trace.status["dropped"]) == (0, 0)


def test_output_that_is_not_utf8_is_replaced(host: AgentHost) -> None:
    host.start("work", "printf 'caf\\351 \\000\\n'")
    host.until("work", "failed")
    assert host.ask("logs", task="work", tail=1)["text"] == "caf\ufffd \0\n"


def test_huge_reply_is_cut_to_fit_the_frame(host: AgentHost) -> None:
    host.start("work", "head -c 900000 /dev/urandom", log={"max_bytes": 1_000_000, "files": 2})
    host.until("work", "failed")
    assert host.ask("logs", task="work", tail=10**6)["text"]


def test_follow_gives_the_tail_then_what_comes_then_ends(host: AgentHost, tmp_path: Path) -> None:
    host.start("work", f"seq 5; while ! test -e {tmp_path}/go; do sleep 0.05; done; seq 100 105")
    eventually(lambda: host.ask("logs", task="work", tail=9)["text"].count("\n") == 5)
    follower = stream_agent_log(
        host.session,
        {"op": "follow", "fleet": "lab", "host": "edge1", "task": "work", "tail": 2},
        idle_timeout=patience(20),
    )
    assert next(follower) == b"4\n5\n"
    (tmp_path / "go").touch()
    assert b"".join(follower) == b"100\n101\n102\n103\n104\n105\n"


def test_follow_goes_on_over_rotations(host: AgentHost) -> None:
    host.start(
        "work",
        "sleep 0.7; for i in $(seq 300); do echo line $i; sleep 0.003; done; sleep 0.5",
        log={"max_bytes": 4096, "files": 3},
    )
    follower = stream_agent_log(
        host.session,
        {"op": "follow", "fleet": "lab", "host": "edge1", "task": "work", "tail": 300},
        idle_timeout=patience(20),
    )
    assert b"".join(follower).decode().splitlines() == [f"line {number}" for number in range(1, 301)]


def test_closed_follower_leaves_no_process(host: AgentHost) -> None:
    host.start("work", "echo up; exec sleep 600")
    follower = stream_agent_log(
        host.session,
        {"op": "follow", "fleet": "lab", "host": "edge1", "task": "work", "tail": 5},
        idle_timeout=patience(20),
    )
    assert next(follower) == b"up\n"
    mine = {
        path.name
        for path in Path("/proc").iterdir()
        if path.name.isdigit() and _environ(path.name, str(host.state))
    }
    follower.close()  # type: ignore[attr-defined]
    theirs = {
        str(liveness.read_instance(str(host.folder("work"))).status["pid"]),
        str(host.supervisor("work")),
        str(os.getpid()),
    }
    eventually(lambda: {pid for pid in mine if _environ(pid, str(host.state))} <= theirs)
    host.stop("work")


def _environ(pid: str, text: str) -> bool:
    try:
        return text.encode() in Path(f"/proc/{pid}/environ").read_bytes()
    except OSError:
        return False


def test_log_of_an_unknown_task_is_empty(host: AgentHost) -> None:
    assert host.ask("logs", task="nothing", tail=5)["text"] == ""


@pytest.mark.parametrize("lines", [0, 1, 5])
def test_tail_takes_whole_lines(tmp_path: Path, lines: int) -> None:
    (tmp_path / "log.1").write_bytes(b"1\n2\n3")
    (tmp_path / "log.0").write_bytes(b"3\n4\n5")
    assert read_log_tail(str(tmp_path), lines) == b"".join(
        [b"1\n", b"2\n", b"33\n", b"4\n", b"5"][5 - lines :]
    )
