# SPDX-License-Identifier: Apache-2.0
"""Agents that stay of two versions of edgectl on one real host: each manager talks to one of its own."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import edgectl
from tests.sshd import Lab
from tests.transport.test_conversation import ANSWERS_S, Fleet, begin_early, list_agents, until

# What the agents say of their Python: that of this edgectl, and that of the other one.
OTHER_PYTHON, OWN_PYTHON = "0.0.0", ".".join(map(str, sys.version_info[:3]))
ROOT = Path(edgectl.__file__).parent.parent
# Asks the host again and again until its input ends: what it says of its Python, and whether that took no call.
PROGRAM = """
import json, sys, threading, time
from edgectl.model.inventory import Host, Role
from edgectl.transport import conversation
from tests.transport.test_conversation import Fleet
conversation.MIN_IN_ROW = 2
over = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
fleet = Fleet(Host(name="edge1", role=Role.EDGE, host="edge1"))
with fleet.pool:
    while not over.wait(0.1):
        calls = len(fleet.transport.calls)
        python = fleet.ask("probe", window_s=0.0)["python"]
        print(json.dumps([python, len(fleet.transport.calls) == calls]), flush=True)
"""


def change_agent(folder: Path) -> None:
    """Write to ``folder`` an edgectl whose agent is another one."""
    shutil.copytree(
        ROOT / "edgectl", folder / "edgectl", ignore=shutil.ignore_patterns("__pycache__", "*.pyc")
    )
    probe = folder / "edgectl" / "agent" / "measure" / "probe.py"
    own = '"python": "%d.%d.%d" % sys.version_info[:3],'
    text = probe.read_text()
    assert text.count(own) == 1
    probe.write_text(text.replace(own, f'"python": "{OTHER_PYTHON}",'))


class OtherManager:
    """A process of another edgectl that asks edge1 again and again."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process

    def until_conversed(self) -> str:
        """What the host says of its Python, once that takes no call."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            python, conversed = json.loads(line)
            if conversed:
                return str(python)
        raise AssertionError("it has ended")


@contextmanager
def running_other_manager(folder: Path) -> Iterator[OtherManager]:
    change_agent(folder)
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield OtherManager(process)
        finally:
            process.communicate(timeout=ANSWERS_S)


def test_a_manager_with_another_agent_has_one_of_its_own_that_outlives_the_other(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_early(monkeypatch)
    fleet, folder = Fleet(lab.host("edge1")), lab["edge1"].directory
    with fleet.pool:
        with running_other_manager(tmp_path / "other") as other:
            assert other.until_conversed() == OTHER_PYTHON
            until(fleet.is_conversed)
            del fleet.transport.calls[:]
            # It does not have the code of a probe yet, which a call keeps.
            until(lambda: fleet.ask("probe", window_s=0.0) and not is_called(fleet))
            assert fleet.ask("probe", window_s=0.0)["python"] == OWN_PYTHON
            assert not is_called(fleet)
            assert other.until_conversed() == OTHER_PYTHON, "neither ends the other"
        until(lambda: len(list_agents(folder)) == 1)
        assert fleet.is_conversed()
        assert fleet.ask("probe", window_s=0.0)["python"] == OWN_PYTHON
        assert not is_called(fleet)
    until(lambda: not list_agents(folder))


def is_called(fleet: Fleet) -> bool:
    """Whether any request had a call of its own since the last time."""
    called = bool(fleet.transport.calls)
    del fleet.transport.calls[:]
    return called
