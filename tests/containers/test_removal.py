# SPDX-License-Identifier: Apache-2.0
"""Containers whose tasks are dead: removed once a manager is granted the fleet, and no others."""

import contextlib
import fcntl
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.containers.record import find_container_processes, may_be_left
from edgectl.agent.measure import proc
from edgectl.agent.supervise import lockfile
from edgectl.errors import RefusedError
from tests.agent.conftest import eventually
from tests.agent.test_lease import a_claim, signature
from tests.containers.conftest import ContainerHost
from tests.containers.docker_engine import IMAGE, DockerEngine, find_missing_for_containers

SLAM = "edgectl-lab-edge1-slam"
MISSING = find_missing_for_containers()
pytestmark = pytest.mark.skipif(bool(MISSING), reason=MISSING)


def die(host: ContainerHost, engine: DockerEngine, task: str = "slam") -> None:
    """Everything of the task ends at once, as in a loss of power: its container is dead, and nobody removes it."""
    inside = find_container_processes(str(host.folder(task)), proc.read_process_table())
    outside = host.members(task) - inside
    for pid in (host.supervisor(task), *outside, *inside):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    name = f"edgectl-lab-edge1-{task}"
    eventually(lambda: engine.call("inspect", "--format", "{{.State.Running}}", name) == "false")


def read_log(host: ContainerHost, **fields: Any) -> str:
    return str(host.ask("logs", task="slam", tail=5, **fields)["text"])


def probe_as_manager(host: ContainerHost) -> dict[str, Any]:
    """What an apply does first, and its end."""
    reply = host.ask("probe", window_s=0.05, lease=a_claim())
    assert reply["lease"]["state"] == "granted"
    signed = signature(reply["lease"]["epoch"])
    host.ask("lease", action="release", lease=signed, end_watch=False)
    return reply


def test_a_dead_container_is_removed_for_a_manager_and_not_for_a_reader(
    host: ContainerHost, engine: DockerEngine
) -> None:
    host.start("slam", "echo said; exec sleep 600")
    eventually(lambda: read_log(host) == "said\n")
    die(host, engine)
    assert host.ask("status", task=None)["tasks"]["slam"]["state"] == "failed"
    assert host.ask("probe", window_s=0.05)["tasks"]["slam"]["state"] == "failed"
    assert not lockfile.is_lock_held(str(host.folder("slam")), lockfile.GUARD)
    assert engine.list_containers() == [SLAM]
    assert probe_as_manager(host)["tasks"]["slam"]["state"] == "failed"
    eventually(lambda: not engine.list_containers())
    eventually(lambda: not may_be_left(str(host.folder("slam"))))
    assert read_log(host) == "said\n"
    assert host.start("slam", "echo again; exec sleep 600", instance="i2", generation=2)["state"] == "started"
    eventually(lambda: "again" in read_log(host))
    assert read_log(host, previous=True) == "said\n"
    assert may_be_left(str(host.folder("slam")))
    assert host.stop("slam")["state"] == "stopped"
    assert not may_be_left(str(host.folder("slam")))


def test_a_start_beside_the_removal_is_a_start(host: ContainerHost, engine: DockerEngine) -> None:
    for generation in range(1, 4):
        started = host.start("slam", "exec sleep 600", instance=f"i{generation}", generation=generation)
        assert (started["state"], started["instance"]) == ("started", f"i{generation}")
        if generation < 3:
            die(host, engine)
            probe_as_manager(host)
    assert engine.list_containers() == [SLAM]
    assert host.stop("slam")["state"] == "stopped"


def test_a_start_waits_for_the_end_of_a_removal(host: ContainerHost, engine: DockerEngine) -> None:
    host.start("slam", "exec sleep 600")
    host.stop("slam")
    replies: list[dict[str, object]] = []
    guard = os.open(host.folder("slam") / lockfile.GUARD, os.O_RDWR | os.O_CREAT, 0o600)
    fcntl.flock(guard, fcntl.LOCK_EX)
    starter = threading.Thread(
        target=lambda: replies.append(host.start("slam", "exec sleep 600", instance="i2", generation=2))
    )
    starter.start()
    eventually(lambda: lockfile.is_lock_held(str(host.folder("slam"))))
    time.sleep(0.5)
    assert engine.list_containers() == []
    os.close(guard)
    starter.join()
    assert [reply["state"] for reply in replies] == ["started"]
    assert host.stop("slam")["state"] == "stopped"


def test_a_container_whose_record_the_power_cut_has_taken(
    host: ContainerHost, engine: DockerEngine, tmp_path: Path
) -> None:
    """It makes way for a start on its host, unless it may be another user's."""
    labels = [
        f"--label=edgectl.{key}={text}"
        for key, text in (("fleet", "lab"), ("host", "edge1"), ("task", "slam"))
    ]
    for folder in (f"{tmp_path}/other/agent-state/lab", f"{host.state}/gone/hosts/edge1/tasks/slam"):
        with contextlib.suppress(AssertionError):
            engine.call("rm", SLAM)
        mark = f"--label=edgectl.dir={folder}"
        engine.call("create", "--name", SLAM, *labels, mark, "--network=host", IMAGE, "/opt/busybox", "true")
        engine.call("start", "--attach", SLAM)
        if folder.startswith(str(host.state)):
            assert host.start("slam", "exec sleep 600")["state"] == "started"
        else:
            with pytest.raises(RefusedError, match="that is not of this task; it was not touched"):
                host.start("slam", "exec sleep 600")
    assert engine.list_containers() == [SLAM]
    assert host.stop("slam")["state"] == "stopped"


def test_what_runs_or_is_not_of_the_task_is_kept(
    host: ContainerHost, engine: DockerEngine, tmp_path: Path
) -> None:
    folder = f"{tmp_path}/agent-state/other/hosts/edge1/tasks/slam"
    labels = ("--label", "edgectl.fleet=other", "--label", f"edgectl.dir={folder}")
    for name, words in (("foreign", ()), ("edgectl-other-edge1-slam", labels)):
        engine.call("create", "--name", name, *words, "--network=host", IMAGE, "/opt/busybox", "true")
        engine.call("start", "--attach", name)
    host.start("slam", "exec sleep 600")
    host.start("nav", "exec sleep 600")
    host.start("zed", "exec sleep 600")
    for task in ("slam", "zed"):
        die(host, engine, task)
    engine.call("start", SLAM)  # by a person
    probe_as_manager(host)
    # It comes after the other ones.
    eventually(lambda: not may_be_left(str(host.folder("zed"))))
    kept = ["edgectl-lab-edge1-nav", SLAM, "edgectl-other-edge1-slam", "foreign"]
    assert sorted(engine.list_containers()) == kept
    shown = engine.call("inspect", "--format", "{{.State.Running}}", SLAM, "edgectl-lab-edge1-nav")
    assert shown.split() == ["true", "true"]
    assert host.stop("nav")["state"] == "stopped"
    engine.call("rm", "--force", SLAM, "edgectl-other-edge1-slam", "foreign")
