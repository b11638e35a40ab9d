# SPDX-License-Identifier: Apache-2.0
"""Delivery of events to the programs of ``on_event``: real programs, real files, a real courier process."""

import dataclasses
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edgectl.model.event import Event, EventHook, EventKind
from edgectl.model.secret import Secret
from edgectl.state.event_cursor import hold_hook_lock, load_cursors, name_hook
from edgectl.state.store import Store
from edgectl.transport.fake import FakeTransport
from edgectl.usecases.event_courier import CourierJob, deliver_events, read_job
from edgectl.usecases.event_delivery import deliver_recorded_events, list_file_secrets, run_hook_trials
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.hook_run import MAX_EVENTS, build_hook_document, run_hook
from tests.builders import NOW, an_edge, an_inventory, some_tasks
from tests.leftovers import end_started_in
from tests.pace import patience

APPEND = "import sys; open(sys.argv[1], 'a').write(sys.stdin.read() + chr(10))"
EVENTS = (
    Event(at=NOW, kind=EventKind.HOST_LOST, host="zeta", message="no route"),
    Event(at=NOW + 1, kind=EventKind.TASK_READY, host="yak", task="slam"),
    Event(
        at=NOW + 2, kind=EventKind.TASK_FAILED, host="axe", task="slam", message="exit code 1; token hunter2"
    ),
)


def append_hook(path: Path, **more: Any) -> EventHook:
    return EventHook(command=(sys.executable, "-c", APPEND, str(path)), every=0.0, **more)


def make_fleet(state: Path, *hooks: EventHook, said: list[str] | None = None) -> Fleet:
    state.mkdir(mode=0o700, exist_ok=True)
    hosts = an_inventory(an_edge("zeta"), an_edge("yak", env={"TOKEN": Secret("hunter2")}), an_edge("axe"))
    return Fleet(
        inventory=dataclasses.replace(hosts, fleet="lab-1", on_event=hooks),
        tasks=some_tasks(),
        transport=FakeTransport({}),
        state=state,
        warn=(said if said is not None else []).append,
    )


def record(fleet: Fleet, *events: Event) -> None:
    """As a probe records: within the block that delivers."""
    with deliver_recorded_events(fleet):
        fleet.history.use(fleet.state, fleet.warn, lambda store: store.record_events(events))


def wait_until(met: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + patience(30)
    while not met():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


def read_runs(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def list_delivered(path: Path) -> list[str]:
    return [item["kind"] for run in read_runs(path) for item in run["items"]]


def is_idle(fleet: Fleet) -> bool:
    newest = fleet.history.use(fleet.state, fleet.warn, lambda store: store.events(limit=1))
    return all(cursor.id == newest[0].id for cursor in load_cursors(fleet.state).hooks.values())


def test_events_of_the_wanted_kinds_arrive_once_and_masked(tmp_path: Path) -> None:
    out, state = tmp_path / "out", tmp_path / "state"
    fleet = make_fleet(state, append_hook(out))
    state.joinpath("x").touch()
    with Store.open(state) as store:
        store.record_events([EVENTS[0]])  # before on_event was written: old news
    record(fleet, *EVENTS[1:])
    wait_until(lambda: is_idle(fleet), "the courier delivers")
    (run,) = read_runs(out)
    assert (run["format_version"], run["kind"], run["fleet"], run["omitted"], run["test"]) == (
        1,
        "event",
        "lab-1",
        0,
        False,
    )
    (item,) = run["items"]
    assert (item["kind"], item["host"], item["task"], item["message"]) == (
        "task-failed", "axe", "slam", "exit code 1; token ***",
    )  # fmt: skip
    record(fleet)
    record(fleet, EVENTS[0])
    wait_until(lambda: is_idle(fleet), "the courier delivers again")
    assert list_delivered(out) == ["task-failed", "host-lost"]


def test_a_caller_never_waits_for_a_hanging_program_and_hears_of_it_once(tmp_path: Path) -> None:
    said: list[str] = []
    sleeper = EventHook(
        command=(sys.executable, "-c", "import time; time.sleep(600)"), timeout=0.3, every=0.0
    )
    fleet = make_fleet(tmp_path / "state", sleeper, said=said)
    record(fleet, EVENTS[0])
    wait_until(lambda: bool(load_cursors(fleet.state).untold), "the program is ended")
    assert said == []
    record(fleet, EVENTS[2])
    record(fleet)
    assert said == [f"on_event {sys.executable} did not end within 0.3 s; try it with: edgectl events test"]
    (cursor,) = load_cursors(fleet.state).hooks.values()
    assert cursor.failures >= 1, "what it did not take is kept"


def test_what_a_failing_program_did_not_take_comes_with_its_next_run(tmp_path: Path) -> None:
    flag, out = tmp_path / "works", tmp_path / "out"
    program = f"import os, sys; os.path.exists({str(flag)!r}) or sys.exit('mail server is down'); " + APPEND
    fleet = make_fleet(
        tmp_path / "state", EventHook(command=(sys.executable, "-c", program, str(out)), every=0.0)
    )
    record(fleet, EVENTS[0])
    wait_until(lambda: bool(load_cursors(fleet.state).untold), "it fails")
    assert load_cursors(fleet.state).untold[0].endswith("failed with exit code 1: mail server is down")
    flag.touch()

    def try_again() -> bool:
        record(fleet)
        return bool(read_runs(out))

    wait_until(try_again, "it is tried again")
    assert list_delivered(out) == ["host-lost"]
    wait_until(lambda: is_idle(fleet), "the cursor is saved")


def test_events_between_two_runs_come_together(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fleet = make_fleet(tmp_path / "state", dataclasses.replace(append_hook(out), every=2.0))
    record(fleet, EVENTS[0])
    wait_until(lambda: len(read_runs(out)) == 1, "the first comes at once")
    record(fleet, EVENTS[2])
    record(fleet, EVENTS[0])
    wait_until(lambda: is_idle(fleet), "the others come")
    assert [len(run["items"]) for run in read_runs(out)] == [1, 2]


def test_a_history_that_begins_anew(tmp_path: Path) -> None:
    """It was set aside as broken: its ids start again, below and up to the one that was delivered last."""
    out = tmp_path / "out"
    fleet = make_fleet(tmp_path / "state", append_hook(out))
    record(fleet)
    for _ in range(3):
        record(fleet, EVENTS[0])
    wait_until(lambda: is_idle(fleet), "all arrive")
    assert len(list_delivered(out)) == 3
    gone = [path for path in fleet.state.iterdir() if path.name.startswith("history")]
    assert gone
    for path in gone:
        path.unlink()
    other = make_fleet(fleet.state, *fleet.inventory.on_event)
    record(other, EVENTS[2])
    wait_until(lambda: is_idle(other), "the new history is delivered")
    record(other, *[dataclasses.replace(EVENTS[2], at=NOW + n) for n in (10, 11)])
    wait_until(lambda: is_idle(other), "the rest too")
    assert list_delivered(out)[3:] == ["task-failed"] * 3


def test_a_clock_that_goes_back_holds_nothing_back(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fleet = make_fleet(tmp_path / "state", append_hook(out))
    record(fleet)
    for back in (0, 86400, 3600):
        record(fleet, dataclasses.replace(EVENTS[0], at=NOW - back))
    wait_until(lambda: is_idle(fleet), "all arrive")
    assert len(list_delivered(out)) == 3


def test_two_couriers_at_once_deliver_each_event_once(tmp_path: Path) -> None:
    out = tmp_path / "out"
    slow = "import time; time.sleep(.3); " + APPEND
    fleet = make_fleet(
        tmp_path / "state", EventHook(command=(sys.executable, "-c", slow, str(out)), every=0.0)
    )
    record(fleet)
    for number in range(6):
        record(fleet, dataclasses.replace(EVENTS[0], at=NOW + number))
        job = CourierJob(fleet="lab-1", state=fleet.state, hooks=fleet.inventory.on_event)
        deliver_events(read_job(job.to_json()))
    wait_until(lambda: is_idle(fleet), "all arrive")
    assert len(list_delivered(out)) == 6


def test_a_program_that_prints_much_ends(tmp_path: Path) -> None:
    del tmp_path
    loud = EventHook(
        command=(
            sys.executable,
            "-c",
            "print('x' * 99 + chr(10) * 1, end='') or [print('y' * 4000) for _ in range(5000)]",
        )
    )
    assert run_hook(loud, {}) == ""


def test_what_a_program_leaves_running_is_ended_with_it(tmp_path: Path) -> None:
    note = tmp_path / "pid"
    program = (
        "import subprocess, sys; child = subprocess.Popen(['sleep', '600']); "
        f"open({str(note)!r}, 'w').write(str(child.pid))"
    )
    began = time.monotonic()
    assert run_hook(EventHook(command=(sys.executable, "-c", program), timeout=60.0), {}) == ""
    assert time.monotonic() - began < 30, "an open pipe is not waited for"
    pid = int(note.read_text())
    wait_until(lambda: not _runs(pid), "sleep is ended")


def _runs(pid: int) -> bool:
    """A process that is no zombie: whoever adopts it may reap it late."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (("/no/such/program",), "cannot be started: No such file or directory"),
        (("false",), "failed with exit code 1"),
        ((sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"), "was ended by signal 9"),
    ],
)
def test_why_a_program_failed(command: tuple[str, ...], why: str) -> None:
    assert run_hook(EventHook(command=command), {}) == why


def test_a_long_list_is_cut_to_its_newest() -> None:
    many = [dataclasses.replace(EVENTS[0], id=n, message="m" * 5000) for n in range(MAX_EVENTS + 7)]
    document = build_hook_document(EventHook(command=("true",)), "lab", many, ())
    items = document["items"]
    assert isinstance(items, list)
    assert (document["omitted"], len(items), items[-1]["id"]) == (7, MAX_EVENTS, MAX_EVENTS + 6)
    assert {len(item["message"]) for item in items} == {1000}


def test_the_courier_ends_when_its_directory_is_gone(tmp_path: Path) -> None:
    deliver_events(CourierJob(fleet="lab", state=tmp_path / "gone", hooks=(append_hook(tmp_path / "out"),)))
    assert not (tmp_path / "gone").exists()


def test_trials_tell_what_works(tmp_path: Path) -> None:
    hooks = (append_hook(tmp_path / "out"), EventHook(command=("false",), kinds=(EventKind.ROAMED,)))
    fleet = make_fleet(tmp_path / "state", *hooks)
    assert [trial.failure for trial in run_hook_trials(fleet)] == ["", "failed with exit code 1"]
    assert read_runs(tmp_path / "out")[0]["test"] is True
    assert [trial.failure for trial in run_hook_trials(fleet, EventKind.ROAMED)] == [
        "failed with exit code 1"
    ]
    assert list_file_secrets(fleet) == ("hunter2",)


@pytest.mark.parametrize(("before", "after"), [(0, 0), (190, 0), (0, 4090), (150, 4000)])
def test_a_secret_that_is_cut_is_masked_too(before: int, after: int) -> None:
    """By the end of the line that is told, by the part of the output that is kept, and by the end of a line."""
    secrets = ("hunter2\nthe second line", "hunter2-and-more")
    said = "'x' * int(sys.argv[1]) + sys.argv[2] + 'y' * int(sys.argv[3])"
    for secret in secrets:
        program = (sys.executable, "-c", f"import sys; sys.exit({said})")
        hook = EventHook(command=(*program, str(before), secret, str(after)))
        failure = run_hook(hook, build_hook_document(hook, "lab-1", EVENTS[:1], secrets), secrets)
        assert failure.startswith("failed with exit code 1: ")
        told = failure.removeprefix("failed with exit code 1: ")
        assert set(told) <= set("xy*"), told


def test_two_managers_with_other_entries_on_one_state_directory(tmp_path: Path) -> None:
    """Neither forgets what the other's entry has received, nor counts it as work that is left."""
    state = tmp_path / "state"
    zeta, axe = tmp_path / "zeta", tmp_path / "axe"
    first = make_fleet(state, append_hook(zeta, kinds=tuple(EventKind)))
    second = make_fleet(state, append_hook(axe, kinds=tuple(EventKind)))
    for fleet, event in ((first, EVENTS[0]), (second, EVENTS[1]), (first, EVENTS[2])):
        record(fleet, event)
        wait_until(lambda: is_idle_for(fleet), "the courier of this manager delivers")  # noqa: B023
    assert list_delivered(zeta) == ["host-lost", "task-ready", "task-failed"]
    record(second)
    wait_until(lambda: is_idle_for(second), "the second has the third event from its own next run")
    assert list_delivered(axe) == ["task-ready", "task-failed"]
    late = dataclasses.replace(first, clock=lambda: time.time() + 2 * 86400.0)
    record(late)
    assert len(load_cursors(state).hooks) == 1, (
        "an entry that no manager had in its files for a day is forgotten"
    )


def is_idle_for(fleet: Fleet) -> bool:
    newest = fleet.history.use(fleet.state, fleet.warn, lambda store: store.events(limit=1))
    cursors = load_cursors(fleet.state).hooks
    return all(cursors[name_hook(hook)].id == newest[0].id for hook in fleet.inventory.on_event)


def test_an_entry_that_comes_while_a_courier_works_is_served_at_once(tmp_path: Path) -> None:
    """The courier of before knows only the entries that it began with."""
    state, out, begun = tmp_path / "state", tmp_path / "out", tmp_path / "begun"
    program = f"import pathlib, time; pathlib.Path({str(begun)!r}).touch(); time.sleep(600)"
    slow = EventHook(command=(sys.executable, "-c", program), timeout=patience(20), every=0.0)
    record(make_fleet(state, slow), EVENTS[0])
    wait_until(begun.exists, "the first courier waits for its program")
    record(make_fleet(state, slow, append_hook(out)), EVENTS[2])
    wait_until(lambda: list_delivered(out) == ["task-failed"], "the new entry does not wait for the slow one")
    with hold_hook_lock(state, name_hook(slow)) as free:
        assert not free, "the slow one is still at work"
    end_started_in([begun.parent])


def test_two_entries_of_one_program_are_two(tmp_path: Path) -> None:
    """The same command for other kinds: neither takes the events of the other."""
    out = tmp_path / "out"
    hooks = [append_hook(out, kinds=(kind,)) for kind in (EventKind.TASK_FAILED, EventKind.HOST_LOST)]
    fleet = make_fleet(tmp_path / "state", *hooks)
    record(fleet, *EVENTS)
    wait_until(lambda: is_idle_for(fleet), "both are served")
    assert sorted(list_delivered(out)) == ["host-lost", "task-failed"]
