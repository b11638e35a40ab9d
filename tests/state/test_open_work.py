# SPDX-License-Identifier: Apache-2.0
"""What one machine's journal leaves, taken over by the journal of another one."""

from pathlib import Path

from edgectl.state.journal import JOURNAL_FILE_NAME, Journal
from edgectl.state.journal_reader import read_journal
from edgectl.state.open_work import OpenWork, add_announcement, collect_open_work, take_over_work
from tests.builders import NOW


def cut_off(folder: Path) -> OpenWork:
    """A move with a hold and a state that was interrupted."""
    folder.mkdir()
    with Journal.open(folder) as journal:
        journal.append("begin", revision=4, plan="p4")
        journal.append("intent", task="slam", generation=7)
        journal.append("phase", task="slam", phase="hold", host="robot1")
        journal.append("phase", task="slam", phase="save", host="edge2")
        journal.append("phase", task="slam", phase="transfer", host="edge1")
    return collect_open_work(folder)


def test_the_next_journal_goes_on_with_it(tmp_path: Path) -> None:
    left = cut_off(tmp_path / "ana")
    assert left == OpenWork(
        revision=4,
        applied=("p4",),
        unfinished=("slam",),
        held=("slam",),
        spooled={"slam": ("edge2", "edge1")},
    )
    ben = tmp_path / "ben"
    ben.mkdir()
    take_over_work(ben, left, OpenWork(), lambda: NOW)
    assert collect_open_work(ben) == left
    before = (ben / JOURNAL_FILE_NAME).read_bytes()
    take_over_work(ben, left, OpenWork(), lambda: NOW)
    assert (ben / JOURNAL_FILE_NAME).read_bytes() == before  # nothing new
    with Journal.open(ben) as journal:
        for event in ("released", "dropped"):
            journal.append(event, task="slam")
        journal.append("recovered", tasks=["slam"])
    ended = collect_open_work(ben)
    assert ended == OpenWork(revision=4, applied=("p4",))
    take_over_work(tmp_path / "ana", ended, left, lambda: NOW)
    assert collect_open_work(tmp_path / "ana") == ended
    assert read_journal(tmp_path / "ana" / JOURNAL_FILE_NAME).sound


def test_what_was_never_shared_stays_open(tmp_path: Path) -> None:
    own = cut_off(tmp_path / "ana")
    take_over_work(tmp_path / "ana", OpenWork(revision=9, held=("map",)), OpenWork(), lambda: NOW)
    assert collect_open_work(tmp_path / "ana") == OpenWork(
        revision=9,
        applied=("p4",),
        unfinished=("slam",),
        held=("map", "slam"),
        spooled=own.spooled,
    )


def test_the_newest_plans_are_shared_in_the_same_order_by_all(tmp_path: Path) -> None:
    """Else two machines would save the same state by turns for ever."""
    folders = [tmp_path / name for name in ("cem", "ben", "ana")]
    for folder in folders:
        folder.mkdir()
    shared = OpenWork()
    for number in range(100):
        folder = folders[number % 3]
        take_over_work(folder, shared, OpenWork(), lambda: NOW)
        announced = add_announcement(collect_open_work(folder), number + 1, f"p{number}", ["t"])
        with Journal.open(folder) as journal:
            journal.append("begin", revision=number + 1, plan=f"p{number}")
        shared = collect_open_work(folder)
        assert (announced.applied, announced.unfinished) == (shared.applied, ("t",))
    for folder in folders:
        take_over_work(folder, shared, OpenWork(), lambda: NOW)
        assert collect_open_work(folder) == shared
    assert shared.applied == tuple(f"p{number}" for number in range(36, 100))
