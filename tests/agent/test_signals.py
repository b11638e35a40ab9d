# SPDX-License-Identifier: Apache-2.0
"""Signals reach only the process that was seen, never another with its pid."""

import os
import signal
import subprocess
from collections.abc import Iterator

import pytest

from edgectl.agent.measure import proc, system_files
from edgectl.agent.supervise import records, signals
from edgectl.agent.supervise.liveness import InstanceRecord, find_orphans, find_supervisor, is_alive
from tests.agent.conftest import AgentHost, eventually, is_running


@pytest.fixture(params=["pidfd", "kill"])
def sleeper(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[subprocess.Popen[bytes]]:
    if request.param == "kill":
        monkeypatch.delattr(os, "pidfd_open")
    process = subprocess.Popen(["sleep", "600"])
    yield process
    process.kill()
    process.wait()


def read_ticks(pid: int) -> int:
    process = proc.read_process(pid)
    assert process is not None
    return process.ticks


def test_reused_pid_is_not_signalled(sleeper: subprocess.Popen[bytes]) -> None:
    ticks = read_ticks(sleeper.pid)
    assert not signals.send_signal(sleeper.pid, ticks - 1, signal.SIGKILL)
    assert is_running(sleeper.pid)
    assert signals.send_signal(sleeper.pid, ticks, signal.SIGKILL)
    sleeper.wait(timeout=30)
    assert not signals.send_signal(sleeper.pid, ticks, signal.SIGKILL)


@pytest.mark.parametrize(("name", "number"), [("TERM", 15), ("SIGTERM", 15), ("int", 2), ("SIGUSR1", 10)])
def test_names_of_signals(name: str, number: int) -> None:
    assert signals.parse_signal(name) == number


def test_record_with_a_reused_pid_is_dead(
    sleeper: subprocess.Popen[bytes], tmp_path_factory: pytest.TempPathFactory
) -> None:
    ticks = read_ticks(sleeper.pid) - 1
    folder = tmp_path_factory.mktemp("task")
    instance = {
        "instance": "i1",
        "boot_id": system_files.read_boot_id(),
        "supervisor": sleeper.pid,
        "supervisor_ticks": ticks,
    }
    record = InstanceRecord(
        str(folder),
        instance,
        {"instance": "i1", "state": "running", "pid": sleeper.pid, "ticks": ticks},
        locked=False,
    )
    assert find_supervisor(record) == 0
    assert find_orphans(record, proc.read_process_table()) == set()
    assert not is_alive(record)


def test_reboot_ends_every_instance(host: AgentHost) -> None:
    pid = host.start("slam", "exec sleep 600")["pid"]
    for victim in (host.supervisor("slam"), pid):
        os.kill(victim, signal.SIGKILL)
    path = str(host.folder("slam") / "instance")
    eventually(lambda: not is_running(pid))
    records.write_record(path, dict(records.read_record(path), boot_id="another"))
    entry = host.entry("slam")
    assert entry is not None
    assert (entry["state"], entry["pid"], entry["detail"]) == ("failed", 0, "the host was rebooted")
    assert host.start("slam", "exec sleep 600", instance="i2")["state"] == "started"
    host.stop("slam")


def test_stop_clears_a_failure(host: AgentHost) -> None:
    host.start("work", "exit 3")
    host.until("work", "failed")
    assert host.stop("work")["state"] == "not-running"
    assert host.entry("work") is None
