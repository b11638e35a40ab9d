# SPDX-License-Identifier: Apache-2.0
"""Tests of the oracle: each violation is produced with real processes and must be found."""

import fcntl
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.faults import oracle, scan
from tests.pace import patience

RECORDING_TASK = Path(oracle.__file__).with_name("recording_task.py")
Launch = Callable[..., "subprocess.Popen[bytes]"]


def wait_until(condition: Callable[[], object], seconds: float = 30) -> None:
    deadline = time.monotonic() + patience(seconds)
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


@pytest.fixture
def records(tmp_path: Path) -> dict[str, Path]:
    found = {name: tmp_path / name for name in ("edge1", "edge2")}
    for directory in found.values():
        directory.mkdir()
    return found


@pytest.fixture
def mark(tmp_path: Path) -> Iterator[str]:
    word = f"mark-{os.urandom(6).hex()}"
    yield word
    scan.kill_processes(scan.list_marked_processes(word))


def count_records(directory: Path) -> int:
    """Launches that have written their first record."""
    return sum(b"\n" in file.read_bytes() for file in directory.glob("*.jsonl"))


@pytest.fixture
def launch(records: dict[str, Path], mark: str) -> Iterator[Launch]:
    running: list[subprocess.Popen[bytes]] = []

    def start(task: str, host: str = "edge1", *options: str) -> "subprocess.Popen[bytes]":
        command = [
            sys.executable,
            str(RECORDING_TASK),
            "--dir",
            str(records[host]),
            "--task",
            task,
            "--mark",
            mark,
            *options,
        ]
        known = count_records(records[host])
        running.append(subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True))
        wait_until(lambda: count_records(records[host]) > known)
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.wait()


def test_one_launch_of_each_task_is_clean(records: dict[str, Path], launch: Launch) -> None:
    launch("slam")
    launch("nav", "edge2")
    assert oracle.judge_launches(records, {"slam": "edge1", "nav": None}, seconds=0.3).clean


def test_a_lost_task_is_found(records: dict[str, Path], launch: Launch) -> None:
    process = launch("slam")
    process.kill()
    process.wait()
    verdict = oracle.judge_launches(records, {"slam": None, "nav": None}, seconds=0.2, patience=0.3)
    assert verdict.lost == ("slam does not run", "nav does not run")


def test_a_task_on_the_wrong_host_is_found(records: dict[str, Path], launch: Launch) -> None:
    launch("slam", "edge2")
    assert oracle.judge_launches(records, {"slam": "edge1"}, seconds=0.2).lost == (
        "slam runs on edge2, not on edge1",
    )


def test_a_doubled_task_is_found(records: dict[str, Path], launch: Launch) -> None:
    launch("slam")
    launch("slam", "edge2")
    verdict = oracle.judge_launches(records, {"slam": None}, seconds=0.3)
    assert len(verdict.doubled) == 2
    assert "runs 2 times" in verdict.doubled[0]
    assert "overlapped" in verdict.doubled[1]
    assert oracle.count_most_alive(oracle.list_lifetimes(records)) == 2


def test_a_past_overlap_is_found_and_measured(records: dict[str, Path], launch: Launch) -> None:
    old = launch("slam")
    new = launch("slam", "edge2")
    time.sleep(0.3)
    old.send_signal(signal.SIGTERM)
    old.wait()
    verdict = oracle.judge_launches(records, {"slam": "edge2"}, seconds=0.2)
    assert len(verdict.doubled) == 1
    assert 0.2 < oracle.compute_longest_overlap(oracle.list_lifetimes(records)) < 15
    assert new.poll() is None
    assert oracle.judge_launches(records, {"slam": "edge2"}, seconds=0.2, overlap_allowed=["slam"]).clean


def test_a_task_that_should_not_run_is_found(records: dict[str, Path], launch: Launch) -> None:
    launch("slam")
    assert oracle.judge_launches(records, {}, seconds=1.0).doubled == ("slam runs on edge1 and should not",)


def test_the_gap_of_a_move_is_measured(records: dict[str, Path], launch: Launch) -> None:
    old = launch("slam")
    old.terminate()
    old.wait()
    time.sleep(0.5)
    launch("slam", "edge2")
    verdict = oracle.judge_launches(records, {"slam": "edge2"}, seconds=0.2)
    assert verdict.clean, verdict
    assert 0.5 <= oracle.compute_longest_gap(oracle.list_lifetimes(records)) < 15


@pytest.mark.parametrize("shape", ["child", "daemon", "session"])
@pytest.mark.parametrize("more", [(), ("--bare", "--closed")], ids=["plain", "bare"])
def test_a_survivor_of_a_naive_stop_is_found(
    records: dict[str, Path], launch: Launch, mark: str, shape: str, more: tuple[str, ...]
) -> None:
    process = launch("slam", "edge1", "--with", shape, *more)
    wait_until(lambda: len(list(records["edge1"].glob(f"*.{shape}.*"))) == 1)
    process.kill()
    process.wait()
    assert len(scan.list_marked_processes(mark)) == 1
    assert oracle.judge_launches(records, {}, seconds=0.3).doubled == ("slam runs on edge1 and should not",)
    launch("slam", "edge2")
    assert oracle.judge_launches(records, {"slam": "edge2"}, seconds=0.3).doubled


def test_an_emptied_environment_is_empty(
    records: dict[str, Path], launch: Launch, mark: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EDGECTL_INSTANCE", "cookie-1")
    launch("slam", "edge1", "--with", "daemon", "--bare")
    wait_until(lambda: len(scan.list_marked_processes(mark)) == 2)
    wait_until(lambda: len(list(records["edge1"].glob("*.daemon.*"))) == 1)
    assert len(scan.list_processes_with_env("EDGECTL_INSTANCE", "cookie-1")) == 1
    (life,) = oracle.list_lifetimes(records)
    assert life.cookie == "cookie-1"
    assert len(life.pids) == 2


def test_a_deaf_task_notes_the_signal_and_lives(records: dict[str, Path], launch: Launch) -> None:
    process = launch("slam", "edge1", "--deaf")
    wait_until(
        lambda: any(
            event["event"] == "tick"
            for path in records["edge1"].iterdir()
            for event in oracle.read_events(path)
        )
    )
    process.terminate()
    wait_until(lambda: oracle.list_lifetimes(records)[0].signals == ("SIGTERM",))
    assert oracle.judge_launches(records, {"slam": None}, seconds=0.2).clean


def test_a_torn_last_line_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "x.jsonl"
    path.write_bytes(b'{"ns": 5, "launch": "a"}\n{"ns": 6, "lau')
    assert oracle.read_events(path) == [{"ns": 5, "launch": "a"}]


@pytest.mark.parametrize(
    ("number", "harm"),
    [(signal.SIGTERM, "got SIGTERM from"), (signal.SIGKILL, "is dead"), (signal.SIGSTOP, "is stopped")],
)
def test_harm_to_a_foreign_process_is_found(tmp_path: Path, number: signal.Signals, harm: str) -> None:
    bystander, running = scan.start_bystander(tmp_path, "bystander", "looks-like-slam")
    try:
        assert bystander.list_harm() == []
        running.send_signal(number)
        wait_until(lambda: harm in "".join(bystander.list_harm()))
    finally:
        running.kill()
        running.wait()


def test_a_held_lock_and_an_open_file_mode_are_found(tmp_path: Path) -> None:
    path = tmp_path / "state" / "lock"
    path.parent.mkdir(mode=0o700)
    with path.open("w") as file:
        path.chmod(0o600)
        assert scan.list_held_locks(tmp_path / "state") == []
        fcntl.flock(file, fcntl.LOCK_EX)
        assert scan.list_held_locks(tmp_path / "state") == [f"{path} held by {os.getpid()}"]
    assert scan.list_held_locks(tmp_path / "state") == []
    assert scan.list_exposed_paths(tmp_path / "state") == []
    path.chmod(0o644)
    assert scan.list_exposed_paths(tmp_path / "state") == [f"{path} 644"]
