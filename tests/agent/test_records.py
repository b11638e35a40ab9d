# SPDX-License-Identifier: Apache-2.0
"""Records on disk: rewritten in place, never lost by a partial write, never misread."""

import os
from pathlib import Path

import pytest

from edgectl.agent.supervise import records


def test_writers_alternate_and_readers_take_the_newest(tmp_path: Path) -> None:
    path = str(tmp_path / "status")
    for number in range(5):
        records.write_record(path, {"number": number})
        assert records.read_record(path) == {"number": number}
    assert Path(path).stat().st_size <= records.RECORD_BYTES
    assert Path(path).stat().st_mode & 0o777 == 0o600


def test_durable_writes_wait_for_the_disk_and_others_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, real = tmp_path / "generation", os.fdatasync
    synced: list[tuple[str, dict[str, object]]] = []

    def watched(descriptor: int) -> None:
        real(descriptor)
        synced.append((str(Path(f"/proc/self/fd/{descriptor}").readlink()), records.read_record(str(path))))

    monkeypatch.setattr(os, "fdatasync", watched)
    records.write_record(str(path), {"generation": 1})
    assert synced == []
    records.write_record(str(path), {"generation": 2}, durable=True)
    assert synced == [(str(path), {"generation": 2})]


def test_any_changed_byte_gives_a_good_document_or_none(tmp_path: Path) -> None:
    path = tmp_path / "status"
    records.write_record(str(path), {"state": "running", "pid": 41})
    records.write_record(str(path), {"state": "failed", "pid": 0})
    good = path.read_bytes()
    allowed: tuple[dict[str, object], ...] = (
        {"state": "running", "pid": 41},
        {"state": "failed", "pid": 0},
        {},
    )
    for at in [*range(120), *range(records.SLOT_BYTES - 5, records.SLOT_BYTES + 120)]:
        for bit in range(8):
            path.write_bytes(good[:at] + bytes([good[at] ^ 1 << bit]) + good[at + 1 :])
            assert records.read_record(str(path)) in allowed, (at, bit)


def test_every_truncation_gives_a_good_document_or_none(tmp_path: Path) -> None:
    path = tmp_path / "status"
    for number in range(2):
        records.write_record(str(path), {"number": number})
    good = path.read_bytes()
    for length in range(0, len(good), 7):
        path.write_bytes(good[:length])
        assert records.read_record(str(path)) in ({"number": 0}, {"number": 1}, {})


def test_torn_write_leaves_the_document_before(tmp_path: Path) -> None:
    path = tmp_path / "status"
    records.write_record(str(path), {"number": 1})
    before = path.read_bytes().ljust(records.RECORD_BYTES)
    records.write_record(str(path), {"number": 2})
    after = path.read_bytes().ljust(records.RECORD_BYTES)
    changed = next(at for at in range(records.RECORD_BYTES) if before[at] != after[at])
    path.write_bytes(after[: changed + 10] + before[changed + 10 :])
    assert records.read_record(str(path)) == {"number": 1}


def test_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "target").write_bytes(b"")
    (tmp_path / "status").symlink_to(tmp_path / "target")
    with pytest.raises(OSError, match="symbolic links"):
        records.write_record(str(tmp_path / "status"), {"number": 1})
    assert records.read_record(str(tmp_path / "status")) == {}


def test_too_long_a_document_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    path = str(tmp_path / "status")
    records.write_record(path, {"number": 1})
    with pytest.raises(ValueError, match="too long"):
        records.write_record(path, {"number": "x" * 3000})
    assert records.read_record(path) == {"number": 1}
