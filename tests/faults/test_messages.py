# SPDX-License-Identifier: Apache-2.0
"""Messages that say who sent them: two senders at once are found, one after the other are not."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults import oracle, standby_task
from tests.faults.hosts import wait_for
from tests.faults.messages import Subscriber, subscribe

PROGRAM = Path(standby_task.__file__)


@pytest.fixture
def subscriber() -> Iterator[Subscriber]:
    with subscribe("127.0.0.1", None) as found:
        yield found


class Run:
    """One standby task with pipes of its own."""

    def __init__(self, folder: Path, name: str, subscriber: Subscriber) -> None:
        self.pipes, self.records = folder / name, folder / f"records-{name}"
        self.records.mkdir()
        words = [str(self.records), "slam", str(self.pipes), subscriber.address, str(subscriber.port)]
        self.process = subprocess.Popen([sys.executable, PROGRAM, *words])
        wait_for((self.pipes / "out").exists, "the pipes of the task")

    def say(self, word: str) -> str:
        (self.pipes / "in").write_text(word + "\n")
        with (self.pipes / "out").open() as answers:
            return answers.readline().strip()

    def end(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(30)


@pytest.fixture
def runs(tmp_path: Path, subscriber: Subscriber) -> Iterator[tuple[Run, Run]]:
    found = Run(tmp_path, "one", subscriber), Run(tmp_path, "other", subscriber)
    yield found
    for run in found:
        run.end()


def test_one_after_the_other_is_no_overlap(subscriber: Subscriber, runs: tuple[Run, Run]) -> None:
    for run in runs:
        assert run.say("wake") == "wake"
        time.sleep(0.1)
        assert run.say("sleep") == "sleep"
    wait_for(lambda: len(subscriber.spans) == 2, "messages of both")
    assert subscriber.find_overlaps() == []


def test_two_at_once_are_found(subscriber: Subscriber, runs: tuple[Run, Run]) -> None:
    for run in runs:
        run.say("wake")
    time.sleep(0.1)
    for run in runs:
        run.say("sleep")
    wait_for(subscriber.find_overlaps, "an overlap")
    (said,) = subscriber.find_overlaps()
    assert all(sender in said for sender in subscriber.spans)


def test_the_memory_goes_along(runs: tuple[Run, Run]) -> None:
    one, other = runs
    one.say("wake")
    time.sleep(0.2)
    one.say("sleep")
    count = int(one.say("tell"))
    assert count > 1
    assert other.say(f"take {count}") == "take"
    other.say("wake")
    other.say("sleep")
    (path,) = other.records.glob("*.jsonl")
    launch = str(json.loads(path.read_text().splitlines()[0])["launch"])
    assert oracle.read_counts(other.records, launch)[0] == count
