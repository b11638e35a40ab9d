# SPDX-License-Identifier: Apache-2.0
"""Tasks that are gone leave the history's known state: a host that invents names does not make it grow."""

import sqlite3
from contextlib import closing
from pathlib import Path

from edgectl.state.store import Store
from edgectl.state.store_file import HISTORY_FILE_NAME
from tests.builders import NOW, a_run, a_sample, a_snapshot

DAY_S = 86400.0


def count_known(state: Path) -> int:
    with closing(sqlite3.connect(state / HISTORY_FILE_NAME)) as connection:
        return int(connection.execute("SELECT count(*) FROM known_tasks").fetchone()[0])


def test_invented_tasks_are_forgotten_again(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        for number in range(3):
            names = [f"ghost-{number}-{each}" for each in range(700)]
            tasks = {"slam": a_run(), **dict.fromkeys(names, a_run())}
            store.record_snapshot(a_snapshot(taken_at=NOW + number, edge1=a_sample(tasks=tasks)))
        assert count_known(tmp_path) == 1 + 700 + 1000
        store.record_snapshot(a_snapshot(taken_at=NOW + 9, edge1=a_sample(tasks={"slam": a_run()})))
        store.prune(NOW + 400 * DAY_S)
    assert count_known(tmp_path) == 1
