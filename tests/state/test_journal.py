# SPDX-License-Identifier: Apache-2.0
"""The journal: chained, synced, and explicit about torn or damaged entries."""

import json
import os
import threading
import tracemalloc
from pathlib import Path

import pytest

from edgectl.errors import StateError
from edgectl.state.journal import JOURNAL_FILE_NAME, Journal
from edgectl.state.journal_reader import JournalSummary, read_journal, read_journal_cached
from tests.state.journal_files import read_entries


def a_written_journal(directory: Path) -> Path:
    """A journal of two applies, the second interrupted while it moved slam."""
    with Journal.open(directory, clock=lambda: 0.0) as journal:
        journal.append("begin", revision=1, plan="plan-a")
        journal.append("intent", task="slam", action="start")
        journal.append("commit", task="slam", outcome="done")
        journal.append("end", revision=1)
        journal.append("begin", revision=2, plan="plan-b")
        journal.append("intent", task="slam", action="move")
        journal.append("intent", task="camera", action="start")
        journal.append("commit", task="camera", outcome="done")
    return directory / "journal.jsonl"


def test_what_was_written_is_read(tmp_path: Path) -> None:
    log = read_journal(a_written_journal(tmp_path))
    assert [entry["event"] for entry in read_entries(tmp_path / JOURNAL_FILE_NAME)] == [
        "begin",
        "intent",
        "commit",
        "end",
        "begin",
        "intent",
        "intent",
        "commit",
    ]
    assert (log.revision, log.applied, log.unfinished) == (2, {"plan-a", "plan-b"}, ("slam",))
    assert (log.torn, log.broken) == (0, 0)


def test_no_journal_is_an_empty_one(tmp_path: Path) -> None:
    log = read_journal(tmp_path / "journal.jsonl")
    assert (log.revision, log.applied, log.unfinished, log) == (0, set(), (), JournalSummary())


def test_every_truncation_is_a_torn_line_and_never_a_wrong_entry(tmp_path: Path) -> None:
    data = a_written_journal(tmp_path).read_bytes()
    whole = read_entries(tmp_path / "journal.jsonl")
    ends = [position + 1 for position, byte in enumerate(data) if byte == ord("\n")]
    for length in range(len(data)):
        path = tmp_path / "cut.jsonl"
        path.write_bytes(data[:length])
        log = read_journal(path)
        sound = [end for end in ends if end <= length]
        assert read_entries(path) == whole[: len(sound)]
        assert (log.size, log.torn, log.broken) == (max(sound, default=0), length - max(sound, default=0), 0)


def test_every_flipped_bit_is_noticed_where_it_is(tmp_path: Path) -> None:
    data = a_written_journal(tmp_path).read_bytes()
    path = tmp_path / "flipped.jsonl"
    for position in range(0, len(data) - 1, 3):
        flipped = bytearray(data)
        flipped[position] ^= 1 << (position % 7)
        path.write_bytes(flipped)
        assert read_journal(path).broken == data.count(b"\n", 0, position) + 1, position


def test_a_removed_or_exchanged_line_breaks_the_chain(tmp_path: Path) -> None:
    lines = a_written_journal(tmp_path).read_bytes().splitlines(keepends=True)
    path = tmp_path / "edited.jsonl"
    path.write_bytes(b"".join(lines[:2] + lines[3:]))
    assert read_journal(path).broken == 3
    path.write_bytes(b"".join([lines[1], lines[0], *lines[2:]]))
    assert read_journal(path).broken == 1


def test_a_torn_line_is_cut_off_said_and_recorded(tmp_path: Path) -> None:
    path = a_written_journal(tmp_path)
    with path.open("ab") as file:
        file.write(b"deadbeef {")
    said: list[str] = []
    with Journal.open(tmp_path, warn=said.append) as journal:
        journal.append("begin", revision=3, plan="plan-c")
    log = read_journal(path)
    assert "unfinished last line (10 bytes) was cut off" in said[0]
    assert [entry["event"] for entry in read_entries(path)[-2:]] == ["torn", "begin"]
    assert (log.torn, log.broken) == (0, 0)


def test_a_damaged_journal_is_set_aside_and_its_plans_still_count(tmp_path: Path) -> None:
    path = a_written_journal(tmp_path)
    path.write_bytes(path.read_bytes().replace(b'"camera"', b'"kamera"', 1))
    said: list[str] = []
    with Journal.open(tmp_path, warn=said.append) as journal:
        assert journal.log.applied == {"plan-a", "plan-b"}
        assert journal.log.revision == 2
        journal.append("begin", revision=3, plan="plan-c")
    assert "damaged at line 7; set aside as journal.jsonl.broken-1" in said[0]
    again = read_journal(path)
    assert (again.revision, again.applied, again.broken) == (3, {"plan-a", "plan-b", "plan-c"}, 0)


def test_a_long_journal_is_put_away_and_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = a_written_journal(tmp_path)
    monkeypatch.setattr("edgectl.state.journal._ROTATE_BYTES", 100)
    with Journal.open(tmp_path) as journal:
        assert not (tmp_path / "journal-2.jsonl").exists()  # slam is unfinished
        journal.append("recovered")
    last = read_journal(path).last
    with Journal.open(tmp_path) as journal:
        assert journal.log.revision == 2
        journal.append("begin", revision=3, plan="plan-c")
    log = read_journal(path)
    assert (log.revision, log.applied, read_entries(tmp_path / JOURNAL_FILE_NAME)[0]["after"]) == (
        3,
        {"plan-a", "plan-b", "plan-c"},
        last,
    )
    assert read_journal(tmp_path / "journal-2.jsonl").last == last


def test_a_newer_format_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("edgectl.state.journal.JOURNAL_FORMAT", 2)
        a_written_journal(tmp_path)
    with pytest.raises(StateError, match="written by a newer edgectl"):
        Journal.open(tmp_path)


def test_a_full_disk_stops_the_caller(tmp_path: Path) -> None:
    with Journal.open(tmp_path) as journal:
        full = os.open("/dev/full", os.O_WRONLY)
        kept, journal._descriptor = journal._descriptor, full
        with pytest.raises(StateError, match="No space left"):
            journal.append("intent", task="slam")
        journal._descriptor = kept
        os.close(full)
        journal.append("intent", task="slam")
    assert read_journal(tmp_path / "journal.jsonl").broken == 0


def test_threads_keep_the_chain(tmp_path: Path) -> None:
    with Journal.open(tmp_path) as journal:

        def append_ten() -> None:
            for _ in range(10):
                journal.append("phase", task="t")

        threads = [threading.Thread(target=append_ten) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    log = read_journal(tmp_path / "journal.jsonl")
    assert (len(read_entries(tmp_path / JOURNAL_FILE_NAME)), log.broken) == (80, 0)


def test_the_file_is_private_and_plain_json(tmp_path: Path) -> None:
    path = a_written_journal(tmp_path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert json.loads(path.read_text().splitlines()[0][65:])["at"] == "1970-01-01T00:00:00Z"


def test_how_a_journal_stands_is_read_anew_only_where_it_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = read_journal_cached(tmp_path / JOURNAL_FILE_NAME)
    assert (log.located, log.sound) == ({}, True)
    with Journal.open(tmp_path) as journal:
        journal.append("begin", revision=1, plan="p")
        journal.append("intent", task="slam", generation=7)
        journal.append("phase", task="slam", phase="start", host="edge1")
        log = read_journal_cached(tmp_path / JOURNAL_FILE_NAME)
        assert (log.located, log.sound) == ({"slam": ("edge1", 7)}, False)
        reads: list[Path] = []

        def note_read(path: Path) -> JournalSummary:
            reads.append(path)
            return read_journal(path)

        monkeypatch.setattr("edgectl.state.journal_reader.read_journal", note_read)
        for _ in range(3):
            assert not read_journal_cached(tmp_path / JOURNAL_FILE_NAME).sound
        assert reads == []
        journal.append("commit", task="slam", located="edge1")
        journal.append("end", revision=1)
        journal.append("placed", revision=1, placements={"slam": "edge1"})
        for _ in range(3):
            log = read_journal_cached(tmp_path / JOURNAL_FILE_NAME)
            assert (log.located, log.sound) == ({}, True)
        assert len(reads) == 1


def test_a_long_journal_costs_no_memory(tmp_path: Path) -> None:
    with Journal.open(tmp_path) as journal:
        for number in range(40):
            journal.append("begin", revision=number, plan=f"plan-{number}", note="x" * 100_000)
    tracemalloc.start()
    try:
        log = read_journal(tmp_path / JOURNAL_FILE_NAME)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (log.revision, log.size) == (39, (tmp_path / JOURNAL_FILE_NAME).stat().st_size)
    assert peak < log.size / 4
