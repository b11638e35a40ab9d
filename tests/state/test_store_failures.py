# SPDX-License-Identifier: Apache-2.0
"""The history under failures: killed writers, concurrent writers, a full disk, a damaged file. None is fatal,
all are reported.
"""

import os
import random
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.model.event import Event, EventKind
from edgectl.model.resource import Usage
from edgectl.state.store import Retention, Store
from edgectl.state.store_file import HISTORY_FILE_NAME
from tests.builders import NOW, a_sample, a_snapshot
from tests.state.test_store import a_task

ROOT = Path(__file__).parents[2]
WRITER = """
import sys
from pathlib import Path
from edgectl.model.resource import Usage
from edgectl.state.store import Store
from tests.builders import NOW, a_sample, a_snapshot
from tests.state.test_store import a_task
directory, name, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
for number in range(count):
    with Store.open(directory, warn=lambda text: print("said:", text, flush=True)) as store:
        store.record_snapshot(a_snapshot(taken_at=NOW + number, **{name: a_sample(tasks={f"task-{name}": a_task(used=Usage(cpu=float(number)))})}))
        print(number, flush=True)
"""


def start_writer(
    directory: Path, name: str, count: int, limit: Callable[[], None] | None = None
) -> subprocess.Popen[str]:
    """Start a process that records ``count`` snapshots, and prints the number of each once it is recorded.

    -B: under a limit of the size of files Python would leave a part of what it compiles as the whole.
    """
    words = [sys.executable, "-B", "-c", WRITER, str(directory), name, str(count)]
    return subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, preexec_fn=limit)


def count_rows(store: Store) -> int:
    """Read all rows; return their number."""
    return sum(
        map(
            len,
            (store.host_points(), store.link_points(), store.task_points(), store.handoffs(), store.events()),
        )
    )


def test_what_a_killed_writer_had_recorded_is_there(tmp_path: Path) -> None:
    for run in range(3):
        process = start_writer(tmp_path, f"edge{run}", 100_000)
        assert process.stdout is not None
        with process.stdout as out:
            said = [out.readline().strip() for _ in range(5 + 7 * run)]
            os.kill(process.pid, signal.SIGKILL)
            assert process.wait(30) == -signal.SIGKILL
        assert said[-1] == str(4 + 7 * run)
        warnings: list[str] = []
        with Store.open(tmp_path, warn=warnings.append) as store:
            assert len(store.host_points(f"edge{run}")) >= len(said)
            assert len(store.task_points(f"task-edge{run}")) >= len(said)
        assert warnings == []
    with sqlite3.connect(tmp_path / HISTORY_FILE_NAME) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    connection.close()


def test_several_write_at_once_from_the_first_moment(tmp_path: Path) -> None:
    count = 25
    processes = [start_writer(tmp_path, f"edge{number}", count) for number in range(3)]
    for process in processes:
        out, _ = process.communicate(timeout=90)
        assert (process.returncode, out.split()) == (0, [str(number) for number in range(count)])
    with Store.open(tmp_path) as store:
        assert [len(store.host_points(f"edge{number}")) for number in range(3)] == [count] * 3
        assert len(store.task_points()) == 3 * count


def test_a_disk_that_takes_no_more_is_said_once_per_store_and_harms_nothing(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.record_snapshot(a_snapshot(edge1=a_sample()))

    def full() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    process = start_writer(tmp_path, "edge2", 2, full)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    lines = out.splitlines()
    assert [line for line in lines if not line.startswith("said:")] == ["0", "1"]
    assert len([line for line in lines if "history is not recorded" in line]) == 2
    with Store.open(tmp_path) as store:
        assert [point.host for point in store.host_points()] == ["edge1"]


def test_a_history_of_a_newer_edgectl_is_left_alone(tmp_path: Path) -> None:
    Store.open(tmp_path).close()
    with sqlite3.connect(tmp_path / HISTORY_FILE_NAME) as connection:
        connection.execute("PRAGMA user_version = 99")
    connection.close()
    said: list[str] = []
    with Store.open(tmp_path, warn=said.append) as store:
        store.record_snapshot(a_snapshot(edge1=a_sample()))
        assert count_rows(store) == 0
    assert len(said) == 1
    assert "newer edgectl (schema 99)" in said[0]
    assert [path.name for path in tmp_path.iterdir()] == [HISTORY_FILE_NAME]


def test_a_place_that_cannot_be_used_is_said(tmp_path: Path) -> None:
    (tmp_path / HISTORY_FILE_NAME).mkdir()
    for directory in (tmp_path, tmp_path / "missing"):
        said: list[str] = []
        with Store.open(directory, warn=said.append) as store:
            store.record_events([Event(at=NOW, kind=EventKind.PLANNED)])
            assert count_rows(store) == 0
            assert not store.is_prune_due(NOW)
        assert len(said) == 1
        assert said[0].startswith("history is not recorded")


# -- damage
# ------------------------------------------------------------------------------------------------------------------------------


def a_history(directory: Path) -> bytes:
    """A valid history of a few pages."""
    directory.mkdir()
    with Store.open(directory) as store:
        for number in range(40):
            tasks = {f"task{each}": a_task(used=Usage(cpu=float(each))) for each in range(4)}
            store.record_snapshot(
                a_snapshot(taken_at=NOW + number, edge1=a_sample(tasks=tasks), edge2=a_sample())
            )
            store.record_events([Event(at=NOW + number, kind=EventKind.PLANNED, message="1 start")])
    return (directory / HISTORY_FILE_NAME).read_bytes()


def use_history(directory: Path) -> list[str]:
    """Use the history twice as a command does: problems may be reported, then it must store and return rows.
    Returns the warnings.
    """
    said: list[str] = []
    for second in (1000.0, 1001.0):
        with Store.open(directory, warn=said.append) as store:
            count_rows(store)
            store.record_snapshot(a_snapshot(taken_at=NOW + second, edge9=a_sample(tasks={"new": a_task()})))
            store.prune(NOW + second)
            count_rows(store)
    return said


def test_a_truncated_history_is_set_aside_or_read_but_never_fatal(tmp_path: Path) -> None:
    sound = a_history(tmp_path / "sound")
    places = sorted(
        {0, 1, 50, 99, 100, 512, 4095, 4096, 4097, *range(8192, len(sound), 4096), len(sound) - 1}
    )
    for place in places:
        directory = tmp_path / f"cut-{place}"
        directory.mkdir()
        (directory / HISTORY_FILE_NAME).write_bytes(sound[:place])
        said = use_history(directory)
        with Store.open(directory) as store:
            assert len(store.host_points("edge9")) == 2, place
        assert bool(said) == (directory / f"{HISTORY_FILE_NAME}.broken-1").exists(), (place, said)
        shutil.rmtree(directory)


def test_flipped_bits_are_never_fatal(tmp_path: Path) -> None:
    sound, chance = a_history(tmp_path / "sound"), random.Random(7)
    aside = 0
    for number in range(40):
        directory = tmp_path / f"flip-{number}"
        directory.mkdir()
        data = bytearray(sound)
        for _ in range(chance.choice((1, 1, 8, 64))):
            data[chance.randrange(4096 if number % 3 else len(data))] ^= 1 << chance.randrange(8)
        (directory / HISTORY_FILE_NAME).write_bytes(data)
        use_history(directory)
        aside += (directory / f"{HISTORY_FILE_NAME}.broken-1").exists()
        shutil.rmtree(directory)
    assert aside > 5


def test_a_log_that_is_cut_or_damaged_costs_at_most_what_was_in_it(tmp_path: Path) -> None:
    (tmp_path / "sound").mkdir()
    process = start_writer(tmp_path / "sound", "edge1", 100_000)
    with Store.open(tmp_path / "sound"):  # while another connection is open, no ending writer empties the log
        assert process.stdout is not None
        with process.stdout as out:
            for _ in range(10):
                out.readline()
            os.kill(process.pid, signal.SIGKILL)
            process.wait(30)
        parts = {
            path.name: path.read_bytes()
            for path in (tmp_path / "sound").iterdir()
            if not path.name.endswith("-shm")
        }
    log = parts[f"{HISTORY_FILE_NAME}-wal"]
    assert len(log) > 4096
    for place in (0, 1, 31, 32, 40, 56, 2000, len(log) // 2, len(log) - 1):
        directory = tmp_path / f"log-{place}"
        directory.mkdir()
        for name, data in parts.items():
            (directory / name).write_bytes(data)
        (directory / f"{HISTORY_FILE_NAME}-wal").write_bytes(
            log[:place] + b"\xff" + log[place + 1 :] if place % 2 else log[:place]
        )
        use_history(directory)
        with Store.open(directory) as store:
            assert len(store.host_points("edge9")) == 2
        shutil.rmtree(directory)


def test_few_broken_files_are_kept(tmp_path: Path) -> None:
    for number in range(6):
        (tmp_path / HISTORY_FILE_NAME).write_bytes(b"%d is no database, however long it is" % number * 50)
        said: list[str] = []
        Store.open(tmp_path, warn=said.append).close()
        assert len(said) == 1
    kept = sorted(path.name for path in tmp_path.glob(f"{HISTORY_FILE_NAME}.broken-*"))
    assert len(kept) == 2
    assert any(b"5 is no database" in (tmp_path / name).read_bytes() for name in kept)


# -- size --------------------------------------------------------------------------------------------------------------------------------


def test_the_file_is_kept_small_by_the_oldest_samples(tmp_path: Path) -> None:
    most = 200_000
    with Store.open(tmp_path, retention=Retention(max_bytes=most)) as store:
        for number in range(300):
            tasks = {f"task{each}": a_task(used=Usage(cpu=float(each))) for each in range(30)}
            store.record_snapshot(a_snapshot(taken_at=NOW + number, edge1=a_sample(tasks=tasks)))
        store.record_events([Event(at=NOW, kind=EventKind.PLANNED)])
        store.prune(NOW + 300)
        points = store.task_points("task7")
        assert points[-1].at == NOW + 299
        assert 20 < len(points) < 300
        assert [event.kind for event in store.events()] == [EventKind.PLANNED]
    assert (tmp_path / HISTORY_FILE_NAME).stat().st_size <= most


@pytest.mark.parametrize("most", [0, 20_000])
def test_a_limit_below_what_an_empty_file_takes_ends(tmp_path: Path, most: int) -> None:
    with Store.open(tmp_path, retention=Retention(max_bytes=most)) as store:
        store.record_snapshot(a_snapshot(edge1=a_sample(tasks={"slam": a_task()})))
        store.record_events([Event(at=NOW, kind=EventKind.PLANNED)])
        store.prune(NOW)
        assert count_rows(store) == 0
