# SPDX-License-Identifier: Apache-2.0
"""logs -f of several tasks: real tasks on this machine, and streams that are cut anywhere."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.errors import EdgectlError, UnansweredError
from edgectl.usecases.logs import merge_streams
from tests.cli.conftest import Run
from tests.cli.fleet_dir import enter_fleet
from tests.forkserver import ForkedProcess
from tests.pace import patience

INVENTORY = """version: 1
fleet: lab
edges:
  edge2: {host: 127.0.0.1, connection: local, capacity: {cpu: 1, memory: 1Gi}}
  edge1: {host: 127.0.0.1, connection: local, capacity: {cpu: 1, memory: 1Gi}}
"""
LOUD = "demand: {cpu: 0.1, memory: 10Mi}, up: 100ms, stop: {grace: 2s}"
TASKS = f"""version: 1
tasks:
  zeta: {{command: "while echo zeta says so; do sleep 0.3; done", hosts: {{pin: edge1}}, {LOUD}}}
  yak: {{command: "while echo yak too; do sleep 0.2; done", hosts: {{pin: edge2}}, {LOUD}}}
  never: {{command: "exec sleep 600", managed: true, hosts: {{only: [edge1]}}, demand: {{cpu: 8, memory: 1Mi}}}}
"""


def test_several_tasks_are_followed_line_by_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    with enter_fleet(tmp_path, INVENTORY, TASKS, monkeypatch):
        run("apply", "--yes")
        words = ["logs", "-f", "zeta", "yak", "never", "--tail", "1"]
        said = (tmp_path / "said").open("w+b")
        with (tmp_path / "told").open("w+b") as told, said:
            following = ForkedProcess(words, cwd=tmp_path, env=dict(os.environ), stdout=said, stderr=told)
            ended = threading.Event()
            watchdog = threading.Timer(patience(60), ended.set)
            watchdog.start()
            lines: list[str] = []
            while not ended.is_set():
                lines = (tmp_path / "said").read_text().splitlines()
                if min(sum(name in line for line in lines) for name in ("zeta", "yak")) >= 3:
                    break
                ended.wait(0.1)
            watchdog.cancel()
            following.send_signal(signal.SIGINT)
            assert following.wait(patience(30)) == 130
        text = (tmp_path / "said").read_text()
        assert set(text.splitlines()) == {"[task/zeta] zeta says so", "[task/yak] yak too"}, text
        assert "task/never: never is on no host" in (tmp_path / "told").read_text()


def test_lines_stay_whole_and_an_error_ends_its_own_stream() -> None:
    def cut() -> Iterator[str]:
        yield from ("a", "b\nc", "", "d\n", "e")

    def fail() -> Iterator[str]:
        yield "x\n"
        raise UnansweredError("gone")

    found: dict[str, list[str | EdgectlError]] = {"cut": [], "fail": []}
    for name, part in merge_streams({"cut": cut, "fail": fail}):
        found[name].append(part)
    assert found["cut"] == ["ab\n", "cd\n", "e\n"]
    assert [str(part) for part in found["fail"]] == ["x\n", "gone"]


def test_an_endless_line_is_passed_on_in_parts() -> None:
    def flood() -> Iterator[str]:
        for _ in range(5):
            yield "y" * 50_000

    parts = [part for _, part in merge_streams({"flood": flood}) if isinstance(part, str)]
    assert "".join(parts) == "y" * 250_000 + "\n" * parts[-1].endswith("\n")
    assert max(map(len, parts)) <= 120_000
    assert sys.getsizeof(parts[0]) < 200_000
