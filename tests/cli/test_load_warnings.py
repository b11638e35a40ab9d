# SPDX-License-Identifier: Apache-2.0
"""A real task that uses more than it declares, on edges that are too small: what every command says of it."""

import json
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.rules.measured_demand import WARM_UP_S
from tests.cli.conftest import Run
from tests.cli.fleet_dir import enter_fleet
from tests.pace import patience

INVENTORY = """version: 1
defaults: {connection: local}
edges:
  zeta: {host: 127.0.0.1, capacity: {cpu: 1, memory: 64Mi}}
  beta: {host: 127.0.0.1, capacity: {cpu: 1, memory: 16Mi}}
  alpha: {host: 127.0.0.1, capacity: {cpu: 1, memory: 16Mi}}
"""
# 160 MiB without any CPU time.
TASKS = """version: 1
tasks:
  hog:
    command: exec python3 -c "held = bytearray(160 << 20); import time; time.sleep(600)"
    demand: {cpu: 0.01, memory: 60Mi}
    stop: {grace: 2s}
"""
SAID = r"uses 1\d\d\.\dMi of memory, declares 60\.0Mi; edgectl profile hog --write"


@pytest.fixture
def hog(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The fleet with its task, which has run long enough for its usage to count."""
    with enter_fleet(tmp_path, INVENTORY, TASKS, monkeypatch) as folder:
        assert run("apply", "--yes").code == 0
        deadline = time.monotonic() + patience(WARM_UP_S + 60.0)
        # On a busy machine a host may not answer in time, which is a warning, too.
        while not re.search(SAID, " ".join(json.loads(run("status", "-o", "json").out)["warnings"])):
            assert time.monotonic() < deadline
            time.sleep(1.0)
        yield folder


LACKING = r"the edges are short of \d+\.\dMi of memory: the least that would help"


def test_every_command_says_it_with_both_figures_and_what_mends_it(run: Run, hog: Path) -> None:
    found = json.loads(run("plan", "-o", "json").out)
    (overuse,), (shortage,) = found["overuses"], found["shortages"]
    assert (overuse["task"], overuse["host"], overuse["declared"]) == ("hog", "zeta", 60 * 2**20)
    assert (overuse["used"] > 160 * 2**20, shortage["resource"], shortage["amount"] > 0) == (
        True,
        "memory",
        True,
    )
    for words in (("plan",), ("status",)):
        err = " ".join(run(*words).err.split())
        assert re.search(f"note: {LACKING} note: hog on zeta {SAID}", err), err
    both, warnings = f"{LACKING}; hog on zeta {SAID}", json.loads(run("status", "-o", "json").out)["warnings"]
    assert re.fullmatch(both, "; ".join(warnings)), warnings
    assert len(warnings) == 2
    assert re.search(LACKING, " ".join(run("doctor").out.split()))

    # The event is older than the watch, which says it all the same.
    (event,) = json.loads(run("events", "--task", "hog", "-o", "json").out)["items"][-1:]
    assert (event["kind"], event["host"]) == ("task-overuse", "zeta")
    assert re.fullmatch(SAID, event["message"])
    assert "task-overuse" in run("events").out
    cycle = json.loads(run("watch", "--cycles", "1", "-o", "jsonl").out)
    assert cycle["events"] == []
    assert re.fullmatch(both, "; ".join(cycle["warnings"])), cycle["warnings"]
    assert re.search(f"warning: {LACKING}; warning: hog on zeta {SAID}", run("watch", "--cycles", "1").out)
