# SPDX-License-Identifier: Apache-2.0
"""Fleets on one host and login: each has tasks of its own; what the first release left has one owner."""

import fcntl
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link import document_keys
from edgectl.agent.supervise import liveness, records
from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost, a_spec, eventually
from tests.pace import patience

# As the first release did: the directory of a task names no fleet.
_START_UNOWNED = """
import sys
from edgectl.agent.supervise import launch, lockfile, records, scope, task_dirs
from edgectl.agent.link.boot import make_private_dir
from edgectl.agent.measure import system_files
from tests.pace import patience
folder, spec = sys.argv[1], eval(sys.argv[2])
make_private_dir(folder)
identity = {"instance": "old", "host": "edge1", "task": "slam", "generation": 7, "spec_hash": "h1",
    "boot_id": system_files.read_boot_id(), "stop": spec["stop"], "fields": {}, "kind": "service"}
for name in ("lock", "instance", "status", "mark", "generation"):
    task_dirs.reserve_file(folder + "/" + name, 0 if name == "lock" else records.RECORD_BYTES)
records.write_record(folder + "/generation", {"generation": 7})
print(launch.launch_supervisor(folder, lockfile.take_lock(folder), identity, spec, scope.Scope([], {}, ""))["pid"])
"""


@pytest.fixture
def other(host: AgentHost) -> AgentHost:
    """Another fleet that names the same host."""
    other = AgentHost(host.name, host.state)
    other.fleet = "hall"
    return other


def start_unowned(host: AgentHost, task: str, command: str) -> int:
    folder = host.state / "hosts" / host.name / "tasks" / task
    folder.parent.mkdir(parents=True)
    for path in (host.state, host.state / "hosts", host.state / "hosts" / host.name, folder.parent):
        path.chmod(0o700)
    words = [sys.executable, "-c", _START_UNOWNED, str(folder), repr(a_spec(command))]
    return int(subprocess.run(words, check=True, capture_output=True, timeout=patience(30)).stdout)


def others(host: AgentHost) -> list[dict[str, Any]]:
    """Without those of other tests on this machine, which may be in shared memory."""
    return [each for each in host.ask("probe", window_s=0.05)["other_tasks"] if each["host"] == "edge1"]


def end_unowned(host: AgentHost, task: str, pid: int) -> None:
    record = liveness.read_instance(str(host.state / "hosts" / host.name / "tasks" / task))
    for each in (liveness.find_supervisor(record), pid):
        if each:
            os.kill(each, signal.SIGKILL)


def test_fleets_do_not_see_or_touch_each_other(host: AgentHost, other: AgentHost) -> None:
    first = host.start("slam", "exec sleep 600")
    second = other.start("slam", "exec sleep 600", instance="theirs")
    assert (first["state"], second["state"]) == ("started", "started")
    assert other.stop("slam")["state"] == "stopped"
    assert other.stop("slam")["state"] == "not-running"
    found = host.entry("slam")
    assert found is not None
    assert (found["pid"], found["state"]) == (first["pid"], "running")
    assert host.stop("slam")["state"] == "stopped"


def test_a_probe_lists_what_else_lives_on_the_machine(host: AgentHost, other: AgentHost) -> None:
    """Of the same fleet under another name of this machine, and of other fleets; nothing that has ended."""
    renamed = AgentHost("jetson-a", host.state)
    pid = start_unowned(host, "web", "exec sleep 600")
    try:
        host.start("slam", "exec sleep 600", generation=4)
        other.ask(
            "start", task="slam", instance="theirs", generation=2, manager="paula@laptop",
            spec=a_spec("exec sleep 600", runtime="process"),
        )  # fmt: skip
        other.start("once", "exit 0")
        eventually(lambda: (entry := other.entry("once")) and entry["state"] == "failed")
        found = others(renamed)
        assert [(each["fleet"], each["host"], each["task"]) for each in found] == [
            ("lab", "edge1", "slam"), ("", "edge1", "web"), ("hall", "edge1", "slam"),
        ]  # fmt: skip
        assert all(set(each) == set(document_keys.OTHER_TASK_KEYS) for each in found)
        own, _, foreign = found
        assert (own["instance"], own["generation"], own["state"]) == ("i1", 4, "running")
        assert (foreign["started_by"], foreign["instance"]) == ("paula@laptop", "theirs")
        assert 0 <= foreign["age_s"] < 60
        assert [each["fleet"] for each in others(host)] == ["", "hall"]
    finally:
        other.end()
        end_unowned(host, "web", pid)


def test_a_task_that_another_fleet_begins_to_start_is_no_task_yet(host: AgentHost, other: AgentHost) -> None:
    """Its directory is made and locked before its record is written."""
    other.start("once", "exit 0")
    (once,) = host.state.glob("**/hall/hosts/edge1/tasks/once")
    begun = once.with_name("begun")
    begun.mkdir(mode=0o700)
    with (begun / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert "begun" not in [each["task"] for each in others(host)]


@pytest.mark.parametrize("fleet", [None, "", "../lab", "Lab"])
def test_a_request_names_its_fleet(host: AgentHost, fleet: str | None) -> None:
    with pytest.raises(RefusedError, match="not a name"):
        host.ask("status", fleet=fleet, task=None)


def test_a_task_of_the_first_release_is_adopted_once(host: AgentHost, other: AgentHost) -> None:
    """By the fleet that names it: that one sees it, starts no second, and stops it; another does nothing to it."""
    pid = start_unowned(host, "slam", "exec sleep 600")
    probe = host.ask("probe", window_s=0.05)
    assert (probe["tasks"], probe["unowned"]) == ({}, ["slam"])
    assert other.ask("adopt", tasks=["web"])["adopted"] == []
    assert host.ask("adopt", tasks=["slam", "web"])["adopted"] == ["slam"]
    assert other.ask("adopt", tasks=["slam"])["adopted"] == []
    probe = host.ask("probe", window_s=0.05)
    assert (probe["tasks"]["slam"]["pid"], probe["unowned"]) == (pid, [])
    assert other.ask("probe", window_s=0.05)["tasks"] == {}
    assert host.start("slam", "exec sleep 600", generation=8)["state"] == "already-running"
    contact = host.state / "hosts" / host.name / "contact"
    assert records.read_record(str(contact))["at"] > 0, "its supervisor looks for heartbeats there"
    assert other.stop("slam")["state"] == "not-running"
    assert host.stop("slam")["state"] == "stopped"
    assert host.start("slam", "exec sleep 600", generation=9)["state"] == "started"
    assert Path(host.folder("slam")).is_dir()
    host.stop("slam")
