# SPDX-License-Identifier: Apache-2.0
"""Lines of a log by their time and by their run: real tasks and files; only the clock of a writer is set."""

import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.agent.link.errors import RefusalError
from edgectl.agent.measure import proc
from edgectl.agent.supervise import log_times
from edgectl.agent.supervise.log_select import EARLY_NOTE, LATE_NOTE, read_selected
from edgectl.agent.supervise.logfile import LogWriter, read_log_tail
from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost, both_runtimes, eventually
from tests.agent.little_room import write_with_little_room
from tests.agent.test_takeover import take_over
from tests.pace import patience

HOUR_S = 3600.0
# Longer than the second in which the lines of a task share a record.
PAST_S = 1.3


class Clock:
    """Seconds since boot, as a test sets them."""

    def __init__(self, age_s: float) -> None:
        self.began = proc.read_uptime_s()
        self.now = self.began - age_s

    def __call__(self) -> float:
        return self.now


def change_records(folder: Path, change: Callable[[log_times.Span], None]) -> None:
    path = folder / log_times.TIMES_FILE
    spans = log_times.decode_spans(path.read_bytes())
    for span in spans:
        change(span)
    with path.open("r+b") as file:
        file.write(b"".join(span.encode() for span in spans))


def make_older(folder: Path, seconds: float = HOUR_S) -> None:
    """As if all that was written until now had been written ``seconds`` earlier."""

    def change(span: log_times.Span) -> None:
        span.first_ms -= int(seconds * 1000)
        span.last_ms -= int(seconds * 1000)

    change_records(folder, change)


def read_lines(folder: Path, since_s: float | None = None, *, previous: bool = False) -> list[str]:
    data, _ = read_selected(str(folder), since_s, previous=previous, lines=None)
    return data.decode().splitlines()


@both_runtimes
def test_lines_since_a_time_and_of_the_run_before(host: AgentHost, tmp_path: Path) -> None:
    host.start(
        "slam", f"echo one; while ! test -e {tmp_path}/go; do sleep 0.05; done; echo two; exec sleep 600"
    )
    eventually(lambda: host.ask("logs", task="slam", tail=9)["text"])
    with pytest.raises(RefusedError, match="no run before the present one is known: there was none"):
        host.ask("logs", task="slam", tail=9, previous=True)
    time.sleep(PAST_S)
    make_older(host.folder("slam"))
    (tmp_path / "go").touch()
    eventually(lambda: "two" in host.ask("logs", task="slam", tail=9)["text"])
    assert host.ask("logs", task="slam", tail=None, since_s=HOUR_S / 2)["text"] == "two\n"
    assert host.ask("logs", task="slam", tail=None, since_s=HOUR_S * 3)["text"] == "one\ntwo\n"
    assert host.ask("logs", task="slam", tail=1, since_s=HOUR_S * 3)["text"] == "two\n"
    host.stop("slam")
    host.start("slam", "echo three; exec sleep 600", instance="i2", generation=2)
    eventually(lambda: "three" in host.ask("logs", task="slam", tail=9)["text"])
    before = host.ask("logs", task="slam", tail=9, previous=True)
    assert (before["text"], before["note"]) == ("one\ntwo\n", "")
    assert host.ask("logs", task="slam", tail=1, previous=True, since_s=HOUR_S / 2)["text"] == "two\n"
    host.stop("slam")


def test_a_crash_begins_a_run_and_so_does_one_after_a_takeover(host: AgentHost) -> None:
    command = "echo run $EDGECTL_INSTANCE $$; exec sleep 600"
    host.start("slam", command, restart="always")
    eventually(lambda: host.ask("logs", task="slam", tail=9)["text"])
    pids = [host.until("slam", "running")["pid"]]
    os.kill(pids[0], signal.SIGKILL)
    eventually(lambda: e if (e := host.entry("slam")) and e["restarts"] == 1 and e["pid"] else None)
    eventually(lambda: host.ask("logs", task="slam", tail=9)["text"].count("\n") == 2)
    assert host.ask("logs", task="slam", tail=9, previous=True)["text"] == f"run i1 {pids[0]}\n"
    host.stop("slam")

    host.start("slam", command, restart="always")
    eventually(lambda: host.ask("logs", task="slam", tail=9)["text"].count("\n") == 3)
    first = host.ask("logs", task="slam", tail=1)["text"]
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    eventually(lambda: e if (e := host.entry("slam")) and e.get("orphaned") else None)
    take_over(host, command, restart="always")
    assert host.ask("logs", task="slam", tail=1, previous=True)["text"] != first, "the run goes on"
    os.kill((host.entry("slam") or {})["pid"], signal.SIGKILL)
    eventually(lambda: host.ask("logs", task="slam", tail=9)["text"].count("\n") == 4)
    assert host.ask("logs", task="slam", tail=9, previous=True)["text"] == first
    host.stop("slam")


def test_a_crash_loop_shows_the_run_before_the_last(host: AgentHost) -> None:
    host.start("slam", "echo run $$; exit 3", restart="never")
    host.until("slam", "failed")
    host.start("slam", "echo again; exit 3", restart="never", instance="i2", generation=2)
    host.until("slam", "failed")
    assert host.ask("logs", task="slam", tail=9, previous=True)["text"].startswith("run ")


def test_follow_begins_at_a_time(host: AgentHost, tmp_path: Path) -> None:
    from edgectl.transport.agent_client import stream_agent_log

    host.start("slam", f"echo one; while ! test -e {tmp_path}/go; do sleep 0.05; done; echo two")
    eventually(lambda: host.ask("logs", task="slam", tail=9)["text"])
    time.sleep(PAST_S)
    make_older(host.folder("slam"))
    (tmp_path / "go").touch()
    eventually(lambda: "two" in host.ask("logs", task="slam", tail=9)["text"])
    request = {
        "op": "follow",
        "fleet": "lab",
        "host": "edge1",
        "task": "slam",
        "tail": None,
        "since_s": 600.0,
    }
    assert b"".join(stream_agent_log(host.session, request, idle_timeout=patience(20))) == b"two\n"


@pytest.mark.parametrize(("max_bytes", "files"), [(20_000, 3), (1 << 20, 2), (30_000, 1)])
def test_no_line_of_the_time_is_missing_and_few_older_ones_are_there(
    tmp_path: Path, max_bytes: int, files: int
) -> None:
    """Six hours of a talkative task, over rotations and far more records than there is room for."""
    draw = random.Random(7)
    clock = Clock(age_s=6 * HOUR_S)
    log = LogWriter(str(tmp_path), max_bytes, files, clock)
    log.begin_run()
    written: list[tuple[float, str]] = []
    while clock.now < clock.began - 5:
        line = f"line {len(written)} " + "x" * draw.randrange(40)
        written.append((clock.now, line))
        log.write(line.encode() + b"\n")
        clock.now += draw.choice([0.01, 0.2, 1.0, 3.0, 15.0])
    assert len(written) > 3 * log_times.MAX_TIMES
    assert (tmp_path / log_times.TIMES_FILE).stat().st_size == log_times.TIME_BYTES * log_times.MAX_TIMES
    kept = read_log_tail(str(tmp_path), 10**6, 10**9).decode().splitlines()[1:]
    lines = written[-len(kept) :]
    assert [line for _, line in lines] == kept
    for since_s in (60.0, 300.0, 3000.0, 3 * HOUR_S, 9 * HOUR_S):
        found = read_lines(tmp_path, since_s)
        spent = proc.read_uptime_s() - clock.began
        wanted = [line for at, line in lines if clock.began - at + spent <= since_s]
        assert found[len(found) - len(wanted) :] == wanted
        ages = [clock.began - at for at, line in written if line in found[:1]]
        assert all(age <= since_s * (1 + 1.5 / 32) + 2 for age in ages), since_s


def test_rotated_runs_are_not_taken_for_others(tmp_path: Path) -> None:
    clock = Clock(age_s=1000)
    log = LogWriter(str(tmp_path), 4096, 2, clock)
    for run in ("first", "second"):
        log.begin_run()
        log.write(f"{run}\n".encode())
        clock.now += 2
    assert read_lines(tmp_path, previous=True) == ["first"]
    log.write(b"y" * 99 + b"\n" + b"".join(b"second %d\n" % n for n in range(500)))
    assert read_lines(tmp_path, previous=True) == ["first"]
    log.write(b"".join(b"second %d\n" % n for n in range(500)))
    with pytest.raises(RefusalError, match="rotated away"):
        read_lines(tmp_path, previous=True)
    clock.now += 2
    log.begin_run()
    log.write(b"third\n")
    assert read_lines(tmp_path, previous=True)[-1] == "second 499"


def test_lines_of_an_earlier_release_have_no_times(tmp_path: Path) -> None:
    (tmp_path / "log.0").write_bytes(b"old\n")
    with pytest.raises(RefusalError, match="an earlier release of edgectl wrote it") as caught:
        read_lines(tmp_path, 60.0)
    assert "edgectl restart" in caught.value.hint
    log = LogWriter(str(tmp_path), 1 << 20, 2)
    log.begin_run()
    log.write(b"new\n")
    assert read_selected(str(tmp_path), 9e9, previous=False, lines=None) == (b"new\n", EARLY_NOTE)
    with pytest.raises(RefusalError, match="no run before"):
        read_lines(tmp_path, previous=True)


def test_bytes_without_a_record_are_printed_with_a_note(tmp_path: Path) -> None:
    """As an earlier release leaves them that goes on with the log."""
    log = LogWriter(str(tmp_path), 1 << 20, 2)
    log.begin_run()
    log.write(b"noted\n")
    change_records(tmp_path, lambda span: setattr(span, "wall_s", span.wall_s - 3600))
    make_older(tmp_path)
    with (tmp_path / "log.0").open("ab") as file:
        file.write(b"not noted\n")
    assert read_selected(str(tmp_path), 60.0, previous=False, lines=None) == (
        b"noted\nnot noted\n",
        LATE_NOTE,
    )


def test_after_a_reboot_the_wall_clock_counts(tmp_path: Path) -> None:
    log = LogWriter(str(tmp_path), 1 << 20, 2)
    log.begin_run()
    log.write(b"before\n")

    def reboot(span: log_times.Span) -> None:
        span.boot, span.wall_s = "00000000", span.wall_s - 3600
        span.first_ms, span.last_ms = span.first_ms + 10**9, span.last_ms + 10**9

    change_records(tmp_path, reboot)
    log = LogWriter(str(tmp_path), 1 << 20, 2)
    log.begin_run()
    log.write(b"after\n")
    assert read_lines(tmp_path, 1800.0) == ["after"]
    assert read_lines(tmp_path, 7200.0) == ["before", "after"]
    assert read_lines(tmp_path, previous=True) == ["before"]


def test_a_step_of_the_wall_clock_does_not_matter(tmp_path: Path) -> None:
    log = LogWriter(str(tmp_path), 1 << 20, 2)
    log.begin_run()
    log.write(b"line\n")
    change_records(tmp_path, lambda span: setattr(span, "wall_s", span.wall_s + 86400))
    assert read_lines(tmp_path, 600.0) == ["line"]
    make_older(tmp_path)
    assert read_lines(tmp_path, 600.0) == []


def test_without_room_for_times_the_log_goes_on(tmp_path: Path) -> None:
    lines = [b"line %d\n" % number for number in range(500)]
    assert write_with_little_room(tmp_path, lines, max_bytes=4096) == 0
    with pytest.raises(RefusalError, match="the disk had no room"):
        read_lines(tmp_path, 60.0)
    # With room again, what follows has times.
    log = LogWriter(str(tmp_path), 4096, 2)
    log.begin_run()
    log.write(b"with times\n")
    assert read_lines(tmp_path, 60.0) == ["with times"]


@pytest.mark.parametrize("damage", [b"\0" * 200, b"\xff" * 160, b"1 2 3\n", os.urandom(5000)])
def test_damaged_records_are_left_out(tmp_path: Path, damage: bytes) -> None:
    (tmp_path / log_times.TIMES_FILE).write_bytes(damage)
    log = LogWriter(str(tmp_path), 1 << 20, 2)
    log.begin_run()
    log.write(b"line\n")
    assert read_lines(tmp_path, 600.0) == ["line"]


def test_a_line_begun_before_the_time_is_whole(tmp_path: Path) -> None:
    clock = Clock(age_s=1000)
    log = LogWriter(str(tmp_path), 1 << 20, 2, clock)
    log.begin_run()
    log.write(b"old\nhalf ")
    clock.now += 900
    log.write(b"a line\n")
    assert read_lines(tmp_path, 300.0) == ["half a line"]
    assert read_selected(str(tmp_path), 3000.0, previous=False, lines=0) == (b"", "")
