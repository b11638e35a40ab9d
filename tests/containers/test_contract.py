# SPDX-License-Identifier: Apache-2.0
"""One contract for all that runs tasks: processes, scopes of systemd, containers of docker, services of a swarm."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.agent.conftest import AgentHost, eventually, is_running, systemd
from tests.containers.conftest import ContainerHost
from tests.containers.docker_engine import find_missing_for_containers
from tests.containers.swarm_nodes import CONTEXT, Swarm, SwarmHost, swarm_of

__all__ = ["systemd"]

MISSING = find_missing_for_containers()
NEEDS_ENGINE = pytest.mark.skipif(bool(MISSING), reason=MISSING)
LAUNCHERS = [
    "process",
    "systemd",
    pytest.param("docker", marks=NEEDS_ENGINE),
    pytest.param("swarm", marks=NEEDS_ENGINE),
]
COMMAND = "echo up as $EDGECTL_TASK; while :; do :; done"


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    """A manager, and a worker that runs the tasks."""
    with swarm_of(tmp_path_factory.mktemp("swarm"), ["zeta", "alpha"]) as found:
        yield found


@pytest.fixture(params=LAUNCHERS)
def launcher(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[AgentHost]:
    """A host whose tasks this launcher runs."""
    if request.param == "docker":
        yield request.getfixturevalue("host")
        return
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    if request.param == "swarm":
        node = request.getfixturevalue("swarm").nodes["alpha"]
        host = SwarmHost("edge1", tmp_path / "state", node, [CONTEXT])
        yield host
        host.end()
        assert node.engine.list_containers() == []
        return
    agent = AgentHost("edge1", tmp_path / "state")
    if request.param == "systemd":
        agent.runtime, agent.session.python = "systemd", str(request.getfixturevalue("systemd").python)
    yield agent
    agent.end()


def read_log(host: AgentHost, task: str) -> str:
    text: str = host.ask("logs", task=task, tail=20)["text"]
    return text


def test_one_instance_is_started_listed_measured_and_stopped_with_proof(launcher: AgentHost) -> None:
    started: dict[str, Any] = launcher.start("slam", COMMAND, env={"EDGECTL_TASK": "slam"}, restart="always")
    assert started["state"] == "started"
    again = launcher.start("slam", COMMAND, instance="i2", generation=2)
    assert (again["state"], again["instance"]) == ("already-running", "i1")
    entry = launcher.entry("slam") or {}
    assert (entry["state"], entry["pid"], entry["restarts"]) == ("running", started["pid"], 0)
    assert is_running(started["pid"])
    assert bool(entry.get("container")) == isinstance(launcher, ContainerHost)
    assert eventually(lambda: read_log(launcher, "slam") == "up as slam\n")
    used = launcher.ask("probe", window_s=1.0)["tasks"]["slam"]
    assert used["used_cores"] > 0.01
    assert 0 < used["used_bytes"] < 1 << 30
    os.kill(started["pid"], signal.SIGKILL)
    second = eventually(
        lambda: (
            e if (e := launcher.entry("slam")) and e["restarts"] == 1 and e["state"] == "running" else None
        )
    )
    assert (second["instance"], second["last_exit"]) == ("i1", 137)
    members = launcher.members("slam")
    assert launcher.stop("slam")["state"] == "stopped"
    assert [pid for pid in members if is_running(pid)] == []
    assert launcher.entry("slam") is None
    assert launcher.stop("slam")["state"] == "not-running"


def test_a_job_ends_with_its_exit_code(launcher: AgentHost) -> None:
    launcher.start("job", "echo done; exit 0", kind="job")
    assert launcher.until("job", "completed")["exit_code"] == 0
    launcher.start("bad", "exit 3", restart="never")
    assert launcher.until("bad", "failed")["exit_code"] == 3
    assert read_log(launcher, "job") == "done\n"
