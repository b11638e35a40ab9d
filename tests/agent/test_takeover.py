# SPDX-License-Identifier: Apache-2.0
"""Takeover of a task whose supervisor was killed: one instance before and after, supervised as before."""

import os
import signal
from typing import Any

import pytest

from edgectl.agent.supervise import liveness
from edgectl.errors import HostError
from tests.agent.conftest import AgentHost, a_spec, eventually, is_running
from tests.pace import patience


def orphan(host: AgentHost, command: str = "exec sleep 600", **spec: Any) -> int:
    """Start ``slam`` and kill its supervisor; the pid of the main process."""
    pid = int(host.start("slam", command, **spec)["pid"])
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    entry = eventually(lambda: e if (e := host.entry("slam")) and e.get("orphaned") else None)
    assert (entry["adoptable"], entry["pid"]) == (True, pid)
    return pid


def take_over(host: AgentHost, command: str = "exec sleep 600", **spec: Any) -> dict[str, Any]:
    return host.ask(
        "takeover",
        task="slam",
        instance="i1",
        generation=2,
        spec=a_spec(command, **{"runtime": "process", **spec}),
    )


def test_a_takeover_keeps_the_process_and_restarts_it_by_policy(host: AgentHost) -> None:
    pid = orphan(host, restart="always")
    assert take_over(host, restart="always")["state"] == "taken-over"
    entry = host.entry("slam")
    assert entry is not None
    assert (entry["state"], entry["pid"], entry["instance"]) == ("running", pid, "i1")
    assert "orphaned" not in entry
    assert "no log until it restarts" in entry["detail"]
    assert host.start("slam", "exec sleep 600", instance="i2", generation=3)["state"] == "already-running"
    assert take_over(host, restart="always")["state"] == "already-running"
    os.kill(pid, signal.SIGKILL)
    again = eventually(lambda: e if (e := host.entry("slam")) and e["restarts"] == 1 else None)
    assert (again["instance"], again["pid"] == pid) == ("i1", False)
    assert host.stop("slam")["state"] == "stopped"
    assert not is_running(int(again["pid"]))


def test_the_exit_code_of_an_adopted_task_is_not_known(host: AgentHost) -> None:
    pid = orphan(host)
    take_over(host)
    os.kill(pid, signal.SIGTERM)
    entry = host.until("slam", "failed")
    assert (entry["exit_code"], entry["given_up"]) == (None, True)
    assert "exit code unknown" in entry["detail"]


def test_self_fence_works_again_and_ends_the_whole_tree(host: AgentHost) -> None:
    stop = {"signal": "TERM", "grace_s": 0.5, "preset": None}
    command = "setsid sleep 601 & exec sleep 600"
    pid = orphan(host, command, self_fence_s=2, stop=stop)
    assert take_over(host, command, self_fence_s=2, stop=stop)["state"] == "taken-over"
    tree = host.members("slam")
    assert len(tree) >= 2
    folder = str(host.folder("slam"))
    status = eventually(
        lambda: s if "fenced" in (s := liveness.read_instance(folder).status).get("detail", "") else None,
        seconds=patience(10.0),
    )
    assert (status["state"], [each for each in tree if is_running(each)]) == ("failed", [])
    assert not is_running(pid)


def test_an_adopted_task_is_stopped_with_proof(host: AgentHost) -> None:
    pid = orphan(host, "setsid sleep 601 & exec sleep 600")
    take_over(host)
    tree = host.members("slam")
    assert host.stop("slam")["state"] == "stopped"
    assert [each for each in {pid, *tree} if is_running(each)] == []
    assert host.entry("slam") is None


def test_what_is_not_an_orphan_is_not_taken_over(host: AgentHost) -> None:
    host.start("slam", "exec sleep 600")
    assert take_over(host)["state"] == "already-running"
    host.stop("slam")
    with pytest.raises(HostError, match="not running"):
        take_over(host)
