# SPDX-License-Identifier: Apache-2.0
"""A task in a container from its start to the proof of its end."""

import os
import signal
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.containers.record import read_container
from edgectl.errors import RefusedError
from tests.agent.conftest import a_spec, eventually, is_running
from tests.containers.conftest import ContainerHost, an_image
from tests.containers.docker_engine import IMAGE, DockerEngine

NAME = "edgectl-lab-edge1-slam"


def test_start_list_logs_usage_and_stop(host: ContainerHost, engine: DockerEngine) -> None:
    command = "echo in $EDGECTL_TASK at $(pwd); while :; do :; done"
    started = host.start("slam", command, env={"EDGECTL_TASK": "slam"}, image={"workdir": "/tmp"})
    assert started["state"] == "started"
    entry = host.entry("slam")
    assert entry is not None
    assert (entry["state"], entry["pid"], entry["container"], entry["engine"]) == (
        "running", started["pid"], NAME, "docker",
    )  # fmt: skip
    record = read_container(str(host.folder("slam")))
    assert engine.call("ps", "--no-trunc", "--format", "{{.ID}} {{.Names}}") == f"{record['id']} {NAME}"
    labels = engine.call("inspect", "--format", "{{json .Config.Labels}}", NAME)
    for part in (
        '"edgectl.fleet":"lab"',
        '"edgectl.host":"edge1"',
        '"edgectl.task":"slam"',
        '"edgectl.instance":"i1"',
    ):
        assert part in labels
    assert host.start("slam", command, instance="i2", generation=2)["state"] == "already-running"
    used = host.ask("probe", window_s=1.0)["tasks"]["slam"]
    assert used["used_cores"] > 0.1
    assert 0 < used["used_bytes"] < 50_000_000
    assert eventually(lambda: host.ask("logs", task="slam", tail=5)["text"]) == "in slam at /tmp\n"
    members = host.members("slam")
    assert host.stop("slam")["state"] == "stopped"
    assert [pid for pid in members if is_running(pid)] == []
    assert engine.list_containers() == []
    assert host.entry("slam") is None


def test_a_job_completes_and_a_failure_is_restarted(host: ContainerHost, engine: DockerEngine) -> None:
    host.start("job", "exit 0", kind="job")
    assert host.until("job", "completed")["exit_code"] == 0
    host.start("bad", "exit 3", restart="never")
    entry = host.until("bad", "failed")
    assert (entry["exit_code"], entry["given_up"]) == (3, True)
    marker = host.state / "again"
    host.start(
        "twice",
        f"test -e {marker} && exec sleep 600; touch {marker}; exit 4",
        image={"volumes": ["/usr:/usr:ro", f"{host.state}:{host.state}"]},
    )
    again = eventually(
        lambda: e if (e := host.entry("twice")) and e["restarts"] == 1 and e["state"] == "running" else None
    )
    assert (again["state"], again["last_exit"]) == ("running", 4)
    assert host.stop("twice")["state"] == "stopped"
    assert engine.list_containers() == []


def test_signals_reach_the_command_and_what_it_started(host: ContainerHost) -> None:
    command = "trap 'echo got TERM; sleep 0.2; exit 0' TERM; echo up; while :; do sleep 0.05; done"
    host.start("slam", f'echo first; sh -c "{command}"; echo last')
    eventually(lambda: "up" in host.ask("logs", task="slam", tail=9)["text"])
    assert host.stop("slam")["state"] == "stopped"
    text = host.ask("logs", task="slam", tail=9)["text"]
    assert "got TERM" in text


def test_what_ignores_signals_is_killed(host: ContainerHost) -> None:
    host.start(
        "slam",
        "trap '' TERM; echo up; while :; do sleep 0.1; done",
        stop={"signal": "TERM", "grace_s": 0.5, "preset": None},
    )
    eventually(lambda: "up" in host.ask("logs", task="slam", tail=9)["text"])
    members = host.members("slam")
    assert host.stop("slam")["state"] == "stopped"
    assert [pid for pid in members if is_running(pid)] == []


def test_checks_run_on_the_host_and_know_the_container(host: ContainerHost) -> None:
    ready = {"command": 'docker exec "$EDGECTL_CONTAINER" test -e /tmp/up', "timeout_s": 10.0}
    host.start("slam", "sleep 0.5; touch /tmp/up; exec sleep 600", ready=ready)
    assert host.until("slam", "ready")["state"] == "ready"
    assert host.stop("slam")["state"] == "stopped"


def test_metrics_of_an_application(host: ContainerHost) -> None:
    host.start("slam", 'echo "fps 29.5" >> $EDGECTL_METRICS; exec sleep 600')
    eventually(lambda: host.ask("probe", window_s=0.05)["tasks"]["slam"].get("metrics") == {"fps": 29.5})
    host.stop("slam")


def test_a_foreign_container_of_the_name_is_not_touched(host: ContainerHost, engine: DockerEngine) -> None:
    engine.call("run", "--detach", "--name", NAME, "--network=host", IMAGE, "/opt/busybox", "sleep", "600")
    with pytest.raises(
        RefusedError, match=f"a container {NAME} exists that is not of this task; it was not touched"
    ):
        host.start("slam", "exec sleep 600")
    assert host.stop("slam")["state"] == "not-running"
    assert engine.call("inspect", "--format", "{{.State.Running}}", NAME) == "true"
    engine.call("rm", "--force", NAME)


@pytest.mark.parametrize(
    ("image", "command", "reason"),
    [
        ({"name": "nobody/nothing:1"}, "true", "No such image"),
        ({"devices": ["/dev/none"]}, "true", "/dev/none"),
        ({"user": "nobody-here"}, "true", "nobody-here"),
        ({"engine": "podman"}, "true", "podman is not installed"),
    ],
)
def test_what_cannot_start_is_refused_and_leaves_nothing(
    host: ContainerHost, engine: DockerEngine, image: dict[str, object], command: str, reason: str
) -> None:
    with pytest.raises(RefusedError, match=reason):
        host.start("slam", command, image=image)
    assert host.entry("slam") is None or host.entry("slam")["state"] != "running"  # type: ignore[index]
    assert engine.list_containers() == []


def test_secrets_are_on_no_command_line(host: ContainerHost) -> None:
    host.start(
        "slam",
        'echo "key is $KEY"; exec sleep 600',
        env={"KEY": "canary-5711", "DOCKER_HOST": "tcp://nowhere:1"},
    )
    eventually(lambda: "key is canary-5711" in host.ask("logs", task="slam", tail=5)["text"])
    lines = (path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if path.exists())
    assert not any(b"canary-5711" in line for line in lines)
    host.stop("slam")


def test_limits_are_those_of_the_container(host: ContainerHost, engine: DockerEngine) -> None:
    host.start("slam", "exec sleep 600", limits={"cpu": 0.5, "memory": 64 << 20})
    entry = host.entry("slam")
    assert entry is not None
    assert entry["limits"] == "enforced"
    shown = engine.call("inspect", "--format", "{{.HostConfig.NanoCpus}} {{.HostConfig.Memory}}", NAME)
    assert shown == "500000000 67108864"
    host.stop("slam")


def test_an_image_that_is_there_is_not_pulled(host: ContainerHost) -> None:
    image = {"name": IMAGE, "engine": "docker", "pull": "missing"}
    ask: dict[str, Any] = {"task": "slam", "instance": "i1", "timeout_s": 10.0}
    assert host.ask("pull", image=image, **ask)["state"] == "present"
    with pytest.raises(RefusedError, match="is not on this host, and pull: never"):
        host.ask("pull", image={**image, "name": "lab/none:1", "pull": "never"}, **ask)
    with pytest.raises(RefusedError, match=r"the image localhost:1/none:1 cannot be pulled: .*refused"):
        host.ask("pull", image={**image, "name": "localhost:1/none:1"}, **ask)


def test_a_lost_supervisor_is_replaced_and_the_container_goes_on(
    host: ContainerHost, engine: DockerEngine
) -> None:
    pid = host.start("slam", "while :; do echo tick; sleep 0.1; done")["pid"]
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    entry = eventually(lambda: e if (e := host.entry("slam")) and e.get("orphaned") else None)
    assert (entry["adoptable"], entry["pid"]) == (True, pid)
    spec = a_spec("while :; do echo tick; sleep 0.1; done", image=an_image())
    assert host.ask("takeover", task="slam", instance="i1", generation=2, spec=spec)["state"] == "taken-over"
    entry = host.entry("slam") or {}
    assert (entry["pid"], entry["state"], entry["restarts"]) == (pid, "running", 0)
    size = len(host.ask("logs", task="slam", tail=1000)["text"])
    eventually(lambda: len(host.ask("logs", task="slam", tail=1000)["text"]) > size)
    assert len(engine.list_containers()) == 1
    assert host.stop("slam")["state"] == "stopped"
