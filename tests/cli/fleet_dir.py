# SPDX-License-Identifier: Apache-2.0
"""Files and the state directory of a small fleet."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory
from edgectl.state.fleet_dir import ensure_fleet_dir
from tests.compiled_agent import give_agent_and_keys
from tests.leftovers import end_started_in


def open_fleet_dir(inventory: Path) -> Path:
    return ensure_fleet_dir(load_inventory(inventory).fleet, inventory)


@contextmanager
def enter_fleet(folder: Path, inventory: str, tasks: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A directory with both files as the working directory, without a terminal; what was started is ended.

    Local hosts have the agent, and the manager its key.
    """
    for name, text in (("inventories/lab.yaml", inventory), ("tasks/lab.yaml", tasks)):
        (folder / name).parent.mkdir()
        (folder / name).write_text(text)
    give_agent_and_keys(folder / "state", folder / "inventories" / "lab.yaml")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(folder / "state"))
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: SIM115, PTH123 - closed below
    try:
        with sys.stdin:
            yield folder
    finally:
        end_started_in([folder / "state"])
