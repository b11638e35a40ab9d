# SPDX-License-Identifier: Apache-2.0
"""Every verb in situations where part of the answer is missing: the words and the exit code of the page."""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from edgectl.model.snapshot import TaskState
from tests.cli.conftest import Run
from tests.executor.fake_fleet import FakeFleet
from tests.views.fixtures import ROOT

PAGE = ROOT / "docs" / "reference" / "answers.md"
_ROW = re.compile(r"^\| `edgectl (?P<words>[^`]+)` \| (?P<code>\d+) \| (?P<said>.*) \|$")


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """One row of the page: the words of a command in a situation, its exit code, and what it prints."""

    situation: str
    words: tuple[str, ...]
    code: int
    said: str


def read_answers() -> list[Answer]:
    """The rows of the page below their headings."""
    found, situation = [], ""
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            situation = line.removeprefix("## ")
        if match := _ROW.match(line):
            said = match["said"].strip("`") if match["said"] != "-" else ""
            found.append(
                Answer(
                    situation=situation,
                    words=tuple(match["words"].split()),
                    code=int(match["code"]),
                    said=said,
                )
            )
    return found


def lose_host(hosts: FakeFleet) -> None:
    """edge1, which runs t0, does not answer."""
    hosts.down.add("edge1")


def give_up(hosts: FakeFleet) -> None:
    """t0 failed on edge1 and is not started again by itself."""
    hosts["edge1"].tasks["t0"] |= {
        "state": TaskState.FAILED.value,
        "pid": 0,
        "given_up": True,
        "exit_code": 3,
        "ended_s": 60.0,
    }


def orphan(hosts: FakeFleet) -> None:
    """t0 runs on edge1, and its supervisor was killed."""
    detail = "orphaned: the supervisor is gone, its processes still run"
    hosts["edge1"].tasks["t0"] |= {"orphaned": True, "adoptable": True, "detail": detail}


def replace_by_foreign_task(hosts: FakeFleet) -> None:
    """t0 of the fleet arm runs on edge1, where t0 of this fleet has ended."""
    hosts["edge1"].tasks.clear()
    hosts["edge1"].others.append(
        {
            "fleet": "arm",
            "host": "edge1",
            "task": "t0",
            "started_by": "ana@desk",
            "state": "running",
            "age_s": 60.0,
            "instance": "f00",
            "spec_hash": "theirs",
            "generation": 4,
        }
    )


def remove_host(hosts: FakeFleet) -> None:
    """edge1, which runs t0, and the pin of t0 are removed from the files."""
    del hosts.hosts["edge1"]
    for name, text in (
        ("fleet.yaml", "  edge1: {host: edge1.lab}\n"),
        ("tasks.yaml", "hosts: {pin: edge1}, "),
    ):
        Path(name).write_text(Path(name).read_text().replace(text, ""))


def end_everything(hosts: FakeFleet) -> None:
    """No task runs, and every host answers."""
    for host in hosts.hosts.values():
        host.tasks.clear()


SITUATIONS: dict[str, Callable[[FakeFleet], None]] = {
    "A host does not answer": lose_host,
    "A task is given up": give_up,
    "A task is an orphan": orphan,
    "A host has left the inventory": remove_host,
    "A task of another fleet": replace_by_foreign_task,
    "Nothing matches": end_everything,
}


@pytest.fixture
def hosts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> FakeFleet:
    """Two edges that run t0 and t1, and the fleet's files as the working directory."""
    fleet = FakeFleet.of(["edge1", "edge2"])
    monkeypatch.setattr("edgectl.transport.fleet_transport.FleetTransport", lambda **_: fleet.transport)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fleet.yaml").write_text(
        "version: 1\nfleet: fleet\nedges:\n  edge1: {host: edge1.lab}\n  edge2: {host: edge2.lab}\n"
    )
    (tmp_path / "tasks.yaml").write_text(
        "version: 1\ntasks:\n"
        "  t0: {command: sleep 100, hosts: {pin: edge1}, demand: {cpu: 0.1, memory: 1Mi, throughput: 0}}\n"
        "  t1: {command: sleep 100, hosts: {pin: edge2}, demand: {cpu: 0.1, memory: 1Mi, throughput: 0},"
        " needs: [t0]}\n"
    )
    monkeypatch.setenv("EDGECTL_INVENTORY", "fleet.yaml")
    monkeypatch.setenv("EDGECTL_TASKS", "tasks.yaml")
    applied = run("apply", "--yes")
    assert (applied.code, fleet.placed) == (0, {"t0": "edge1", "t1": "edge2"}), applied
    return fleet


@pytest.mark.parametrize(
    "answer", read_answers(), ids=lambda answer: f"{answer.situation}: {' '.join(answer.words)}"
)
def test_what_is_said_is_so(answer: Answer, hosts: FakeFleet, run: Run) -> None:
    SITUATIONS[answer.situation](hosts)
    told = run(*answer.words)
    assert (told.code, answer.said in told.out + told.err) == (answer.code, True), told


def test_a_given_up_task_is_reported_once_a_day(hosts: FakeFleet, run: Run, tmp_path: Path) -> None:
    give_up(hosts)
    told = [run("apply", "--yes", "--quiet") for _ in range(2)]
    (record,) = (tmp_path / "state").rglob("reminders.json")
    text = record.read_text()
    record.write_text(re.sub(r'"at": "\d{4}', '"at": "2001', text))
    assert record.read_text() != text
    told.append(run("apply", "--yes", "--quiet"))
    assert [(each.code, each.out, "t0 is given up" in each.err) for each in told] == [
        (4, "", True),
        (4, "", False),
        (4, "", True),
    ]


@pytest.mark.parametrize("words", [("plan",), ("explain", "t1"), ("graph",)])
def test_a_what_if_is_no_event(words: tuple[str, ...], hosts: FakeFleet, run: Run) -> None:
    end_everything(hosts)
    before = run("events").out.count("planned")
    assert run(*words, "--without", "edge1").code == 0
    assert run("events").out.count("planned") == before
    assert run(*words).code == 0
    assert run("events").out.count("planned") == before + 1


@pytest.mark.parametrize(
    "words", ["stop t1", "start t1", "restart t1", "drain edge1", "fence edge1", "rollback 1"]
)
def test_without_a_terminal_the_dry_run_of_the_same_command_is_named(
    words: str, hosts: FakeFleet, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    told = run(*words.split())
    verb = words.split()[0]
    assert (told.code, f"pass --yes, or check first: edgectl {verb} --dry-run" in told.err) == (64, True), (
        told
    )
    assert run(*words.split(), "--dry-run").code == 0
    assert hosts.placed == {"t0": "edge1", "t1": "edge2"}


def test_the_result_of_a_start_names_the_fleet_as_that_of_a_stop(hosts: FakeFleet, run: Run) -> None:
    for verb in ("stop", "start"):
        assert re.search(r"Revision \d+ of fleet \S+\.", run(verb, "t1", "--yes").out)


def test_every_situation_is_on_the_page() -> None:
    assert {answer.situation for answer in read_answers()} == set(SITUATIONS)
