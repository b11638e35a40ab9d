# SPDX-License-Identifier: Apache-2.0
"""Self-fencing: a host without heartbeat stops its fenced tasks, and only then."""

import itertools
import os
import signal
import time
from pathlib import Path
from typing import Any

from edgectl.agent.measure import proc, system_files
from edgectl.agent.supervise import liveness, lockfile, records
from tests.agent.conftest import AgentHost, both_runtimes, eventually, is_running
from tests.agent.test_supervisor import FIVE, python


def fenced(host: AgentHost, task: str, *, seconds: float = 30.0) -> dict[str, object]:
    """The status record of ``task`` once it has been fenced, read without a call to the host, which would be a heartbeat."""
    return dict(
        eventually(
            lambda: s if "fenced" in (s := record_of(host, task).status).get("detail", "") else None,
            seconds=seconds,
        )
    )


def record_of(host: AgentHost, task: str) -> liveness.InstanceRecord:
    return liveness.read_instance(str(host.folder(task)))


@both_runtimes
def test_fencing_stops_the_whole_tree_and_nothing_restarts_it(host: AgentHost, tmp_path: Path) -> None:
    host.start(
        "slam",
        python(FIVE, tmp_path),
        self_fence_s=3,
        restart="always",
        stop={"signal": "TERM", "grace_s": 0.5, "preset": None},
    )
    pids = eventually(lambda: found if len(found := host.members("slam")) >= 5 else None)
    fenced(host, "slam")
    eventually(lambda: not lockfile.is_lock_held(str(host.folder("slam"))))
    assert [pid for pid in pids if is_running(pid)] == []
    entry = host.entry("slam")
    assert entry is not None
    assert (entry["state"], entry["pid"], entry["detail"]) == ("failed", 0, "fenced: no manager call for 3 s")
    time.sleep(1.5)
    later = host.entry("slam")
    assert later is not None
    assert later["ended_s"] >= entry["ended_s"] + 1.5 - 0.02  # each is rounded
    assert {**later, "ended_s": entry["ended_s"]} == entry
    assert host.start("slam", "exec sleep 600", instance="i2")["state"] == "started"
    host.stop("slam")


def test_any_call_is_a_heartbeat_for_every_task_of_its_host(host: AgentHost) -> None:
    pid = host.start("slam", "exec sleep 600", self_fence_s=5)["pid"]
    other = AgentHost("edge2", host.state)
    other.start("slam", "exec sleep 600", self_fence_s=5)
    requests: list[tuple[str, dict[str, Any]]] = [
        ("status", {"task": None}),
        ("check", {"command": "true", "timeout_s": 20}),
        ("logs", {"task": "nav", "tail": 1}),
    ]
    calls = itertools.cycle(requests)

    def fenced_meanwhile() -> bool:
        op, fields = next(calls)
        host.ask(op, **fields)
        time.sleep(0.3)
        return "fenced" in record_of(other, "slam").status.get("detail", "")

    eventually(fenced_meanwhile)  # a call to another host of this machine is no heartbeat
    assert is_running(pid)
    host.stop("slam")


def test_task_without_a_fence_runs_on(host: AgentHost) -> None:
    pid = host.start("slam", "exec sleep 600")["pid"]
    records.write_record(str(host.home / "contact"), {"boot_id": system_files.read_boot_id(), "at": 1.0})
    os.kill(host.supervisor("slam"), signal.SIGCHLD)
    time.sleep(1.0)
    assert is_running(pid)
    host.stop("slam")


def test_old_heartbeat_and_heartbeat_of_another_boot(host: AgentHost) -> None:
    """A heartbeat that is old on the clock since boot fences at the next check; one of another boot is ignored."""
    host.start("slam", "exec sleep 600", self_fence_s=30)
    path = str(host.home / "contact")
    assert abs(records.read_record(path)["at"] - proc.read_uptime_s()) < 10
    records.write_record(path, {"boot_id": "another", "at": proc.read_uptime_s() + 1e6})
    supervisor = host.supervisor("slam")
    time.sleep(2.5)
    assert is_running(supervisor), "begun less than 30 s ago"
    host.stop("slam")


def test_waiting_for_a_restart_is_ended_too(host: AgentHost) -> None:
    """With its jitter it runs at 0, at about 1, by 3.75, and not again before 5.25 s."""
    host.start("slam", "exit 3", self_fence_s=4.5, restart="always")
    status = fenced(host, "slam")
    assert (status["state"], status["exit_code"], status["last_exit"]) == ("failed", 3, 3)


def test_a_suspended_host_restarts_nothing_without_a_recent_heartbeat(host: AgentHost) -> None:
    """By then the manager may have started the task elsewhere."""
    host.start("slam", "exit 3", self_fence_s=3, restart="always")
    eventually(
        lambda: (
            s
            if "restarting" in (s := record_of(host, "slam").status).get("detail", "") and s["restarts"]
            else None
        )
    )
    supervisor, begun = host.supervisor("slam"), proc.read_uptime_s()
    os.kill(supervisor, signal.SIGSTOP)
    restarts = record_of(host, "slam").status["restarts"]
    eventually(lambda: proc.read_uptime_s() > begun + 3.5)
    os.kill(supervisor, signal.SIGCONT)
    assert fenced(host, "slam")["restarts"] == restarts


def test_heartbeat_is_kept_in_shared_memory_where_the_disk_refuses(host: AgentHost) -> None:
    host.name = f"test-{os.getpid()}"
    fallback = Path(f"/dev/shm/edgectl-{os.geteuid()}/agent-state/{host.fleet}/hosts/{host.name}")
    pid = host.start("slam", "exec sleep 600", self_fence_s=4)["pid"]
    begun = proc.read_uptime_s()
    path = host.home / "contact"
    try:
        path.unlink()
        path.mkdir()
        while proc.read_uptime_s() < begun + 5.5:
            host.ask("status", task=None)
            time.sleep(0.3)
        assert is_running(pid)
        assert (fallback / "contact").is_file()
        assert fenced(host, "slam")["state"] == "failed"
    finally:
        path.rmdir()
        (fallback / "contact").unlink()
        fallback.rmdir()


def test_fencing_uses_the_ros_preset(host: AgentHost, tmp_path: Path) -> None:
    program = f"""
import signal, sys, time
from typing import Any
def end(*_):
    open({str(tmp_path / "clean")!r}, "w").close(); sys.exit(0)
signal.signal(signal.SIGINT, end)
open({str(tmp_path / "up")!r}, "w").close()
time.sleep(600)
"""
    command = python(program, tmp_path).removeprefix("exec ") + "; true"
    host.start("nav", command, self_fence_s=3, stop={"signal": None, "grace_s": None, "preset": "ros"})
    eventually((tmp_path / "up").exists)
    assert fenced(host, "nav")["exit_code"] == 0
    assert (tmp_path / "clean").exists()
