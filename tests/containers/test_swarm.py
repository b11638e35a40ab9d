# SPDX-License-Identifier: Apache-2.0
"""Tasks as services of a real Docker Swarm of three engines: one manager, two workers.

Each host asks the manager for its own tasks; the proof that one runs or has ended is that of its own engine.
"""

import contextlib
import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.containers.record import find_container_processes, read_container, write_container
from edgectl.agent.measure import proc
from edgectl.errors import RefusedError
from tests.agent.conftest import a_spec, eventually, is_running
from tests.containers.docker_engine import IMAGE
from tests.containers.swarm_nodes import CONTEXT, SHORT_HEARTBEAT, Swarm, SwarmHost, swarm_of
from tests.containers.test_removal import probe_as_manager

NAME = "edgectl-lab-alpha-slam"
TICKS = "while :; do echo tick; sleep 0.1; done"


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    """A swarm for the tests that leave it as it is."""
    with swarm_of(tmp_path_factory.mktemp("swarm"), ["zeta", "mid", "alpha"]) as found:
        yield found


@pytest.fixture
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    """A swarm of each test's own, which it may break."""
    names = ["zeta", "mid", "alpha"]
    with swarm_of(tmp_path_factory.mktemp("swarm"), names, heartbeat=SHORT_HEARTBEAT) as found:
        yield found


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    return tmp_path / "state"


def a_host(swarm: Swarm, name: str, state: Path) -> SwarmHost:
    """The host of a node; only a worker needs to be told of a manager."""
    return SwarmHost(name, state, swarm.nodes[name], [] if name == "zeta" else [CONTEXT])


def ask_for(host: SwarmHost, op: str, command: str, generation: int) -> dict[str, Any]:
    """What an apply asks for: a start, or a takeover of an orphan."""
    spec = a_spec(command, image=host.build_image(), restart="always")
    entry = host.entry("slam") or {}
    name = entry["instance"] if op == "takeover" else f"i{generation}"
    return host.ask(op, task="slam", instance=name, generation=generation, spec=spec, timeout=150.0)


def start_ticks(host: SwarmHost) -> int:
    pid: int = host.start("slam", TICKS, restart="always")["pid"]  # type: ignore[assignment]
    return pid


def until_running(host: SwarmHost, *, seconds: float = 90.0) -> dict[str, Any]:
    """The entry of a task that runs, is supervised, and whose process is that of its container."""

    def find() -> dict[str, Any] | None:
        entry = host.entry("slam") or {}
        good = entry.get("state") == "running" and not entry.get("orphaned") and is_running(entry["pid"])
        return entry if good else None

    return eventually(find, seconds=seconds)


def check_stops(host: SwarmHost, swarm: Swarm) -> None:
    """Nothing of the task is left after its stop: no process, no container, no service."""
    members = host.members("slam")
    assert host.stop("slam", timeout=150.0)["state"] in ("stopped", "not-running")
    assert [pid for pid in members if is_running(pid)] == []
    assert host.node.engine.list_containers() == []
    assert swarm.list_services() == []
    assert host.entry("slam") is None


def test_a_service_runs_on_the_node_of_its_host_and_nowhere_else(shared: Swarm, state: Path) -> None:
    hosts = {name: a_host(shared, name, state) for name in shared.nodes}
    for name, host in hosts.items():
        started = host.start(
            "slam",
            'echo "in $KEY, {{x}} at $(pwd)"; ' + TICKS,
            env={"KEY": "{{y}}"},
            image={"workdir": "/tmp"},
        )
        assert started["state"] == "started"
        (container,) = host.node.list_running()
        assert container.startswith(f"edgectl-lab-{name}-slam.1.")
    host = hosts["alpha"]
    entry = until_running(host)
    record = read_container(str(host.folder("slam")))
    assert (entry["container"], entry["engine"]) == (host.node.list_running()[0], "docker")
    shown = json.loads(shared.manager.call("service", "inspect", "--format", "{{json .Spec}}", NAME))
    task, labels = shown["TaskTemplate"], shown["Labels"]
    assert task["Placement"]["Constraints"] == [f"node.id=={host.node.node_id}"]
    assert (task["RestartPolicy"]["Condition"], shown["Mode"]) == ("none", {"Replicated": {"Replicas": 1}})
    parts = {"fleet": "lab", "host": "alpha", "task": "slam", "instance": "i1"}
    assert {name: labels[f"edgectl.{name}"] for name in parts} == parts
    seen = host.node.engine.call("inspect", "--format", "{{json .Config.Labels}}", record["id"])
    assert json.loads(seen)["edgectl.place"] == labels["edgectl.place"] == record["place"]
    assert ("pending", False) in record.items()
    text = eventually(lambda: host.ask("logs", task="slam", tail=1000)["text"])
    assert text.startswith("in {{y}}, {{x}} at /tmp\n")
    probe = host.ask("probe", window_s=1.0, engines=True, swarm=True)
    assert probe["engines"][:1] + probe["engines"][-1:] == ["docker", "swarm"]
    used = probe["tasks"]["slam"]
    assert used["used_cores"] > 0.0
    assert 0 < used["used_bytes"] < 50_000_000
    assert host.start("slam", TICKS, instance="i2", generation=2)["state"] == "already-running"
    for each in hosts.values():
        assert each.stop("slam", timeout=150.0)["state"] == "stopped"
    check_stops(host, shared)


def test_a_restart_is_a_new_service_and_the_swarm_makes_none(shared: Swarm, state: Path) -> None:
    host = a_host(shared, "alpha", state)
    pid = host.start("slam", "sleep 1; exit 3", restart="on-failure")["pid"]
    eventually(lambda: (e := host.entry("slam")) and e["restarts"] == 1 and e["state"] == "running")
    entry = host.entry("slam") or {}
    assert (entry["last_exit"], entry["instance"]) == (3, "i1")
    assert entry["pid"] != pid
    assert shared.list_services() == [NAME]
    check_stops(host, shared)
    host.start("job", "exit 0", kind="job")
    assert host.until("job", "completed")["exit_code"] == 0
    host.start("bad", "exit 4", restart="never")
    assert host.until("bad", "failed")["exit_code"] == 4
    eventually(lambda: shared.list_services() == [])


def test_checks_are_given_the_name_of_the_container(shared: Swarm, state: Path) -> None:
    host = a_host(shared, "mid", state)
    ready = {"command": 'docker exec "$EDGECTL_CONTAINER" test -e /tmp/up', "timeout_s": 10.0}
    host.start("slam", 'echo "$EDGECTL_CONTAINER"; touch /tmp/up; exec sleep 600', ready=ready)
    entry = host.until("slam", "ready")
    assert host.ask("logs", task="slam", tail=1)["text"] == f"{entry['container']}\n"
    check_stops(host, shared)


@pytest.mark.parametrize(
    ("image", "command", "reason"),
    [
        ({"name": "nobody/nothing:1"}, "true", "No such image"),
        ({"volumes": ["/usr:/usr:ro", "/nowhere-here:/x"]}, "true", "nowhere-here"),
        ({"user": "nobody-here"}, "true", "nobody-here"),
        ({"managers": ["nobody"]}, "true", "no manager of the swarm answers"),
    ],
)
def test_what_cannot_start_is_refused_and_leaves_nothing(
    shared: Swarm, state: Path, image: dict[str, object], command: str, reason: str
) -> None:
    host = a_host(shared, "alpha", state)
    with pytest.raises(RefusedError, match=reason):
        host.start("slam", command, image=image)
    assert (host.entry("slam") or {}).get("state") != "running"
    assert (shared.list_services(), host.node.engine.list_containers()) == ([], [])


def test_a_foreign_service_of_the_name_is_not_touched(shared: Swarm, state: Path) -> None:
    place = f"node.id=={shared.nodes['mid'].node_id}"
    options = ["--detach", "--no-resolve-image", "--network=host", f"--constraint={place}"]
    shared.manager.call(
        "service", "create", *options, f"--name={NAME}", IMAGE, "/opt/busybox", "sleep", "600"
    )
    host = a_host(shared, "alpha", state)
    with pytest.raises(RefusedError, match=f"a service {NAME} exists that is not of this task"):
        host.start("slam", TICKS)
    assert host.stop("slam", timeout=150.0)["state"] == "not-running"
    assert shared.list_services() == [NAME]
    eventually(shared.nodes["mid"].list_running)
    shared.manager.call("service", "rm", NAME)
    eventually(lambda: shared.nodes["mid"].engine.list_containers() == [])


def test_a_lost_supervisor_is_replaced_and_the_container_goes_on(shared: Swarm, state: Path) -> None:
    host = a_host(shared, "alpha", state)
    pid = start_ticks(host)
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    eventually(lambda: (e := host.entry("slam")) and e.get("orphaned") and e["adoptable"])
    assert ask_for(host, "takeover", TICKS, 2)["state"] == "taken-over"
    assert until_running(host)["pid"] == pid
    size = len(host.ask("logs", task="slam", tail=5000)["text"])
    eventually(lambda: len(host.ask("logs", task="slam", tail=5000)["text"]) > size)
    check_stops(host, shared)


def test_without_a_manager_a_task_runs_on_and_its_stop_is_proven(swarm: Swarm, state: Path) -> None:
    """The swarm starts it neither as its node's engine is restarted, nor as its managers are back."""
    host = a_host(swarm, "alpha", state)
    host.start("slam", TICKS, restart="always")
    swarm.manager.kill()
    pid = until_running(host)["pid"]
    assert is_running(pid)
    members = host.members("slam")
    assert host.stop("slam", timeout=150.0)["state"] == "stopped"
    assert [each for each in members if is_running(each)] == []
    assert (host.entry("slam"), host.node.engine.list_containers()) == (None, [])
    with pytest.raises(RefusedError, match="no manager of the swarm answers"):
        host.start("slam", TICKS, instance="i2", generation=2)
    assert host.entry("slam") is None or (host.entry("slam") or {})["state"] == "failed"
    host.node.engine.stop()
    host.node.engine.start()
    swarm.manager.start()
    eventually(lambda: swarm.get_state("alpha") == "ready", seconds=60.0)
    time.sleep(5.0)  # as long as a swarm would take to start it
    assert host.node.engine.list_containers() == []
    # What could not be removed then is removed beside the next command that changes the fleet.
    assert swarm.list_services() == [NAME]
    probe_as_manager(host)
    eventually(lambda: swarm.list_services() == [])
    host.start("slam", TICKS, instance="i3", generation=3)
    check_stops(host, swarm)


def test_a_request_that_the_managers_agree_on_later_starts_one_container(
    tmp_path_factory: pytest.TempPathFactory, state: Path
) -> None:
    """Of two managers one is lost: the other takes the request, and both agree on it once there are two again."""
    with swarm_of(tmp_path_factory.mktemp("swarm"), ["zeta", "mid", "alpha"], managers=2) as swarm:
        host = a_host(swarm, "alpha", state)
        swarm.nodes["mid"].engine.kill()
        # Refused where the managers have noticed already.
        with contextlib.suppress(RefusedError):
            ask_for(host, "start", TICKS, 1)
        may_start = bool(read_container(str(host.folder("slam"))).get("pending"))
        assert ((host.entry("slam") or {}).get("state") == "starting") == may_start
        swarm.nodes["mid"].engine.start()
        eventually(lambda: swarm.manager.request("GET", "/services")[0] == 200, seconds=60.0)
        eventually(lambda: swarm.get_state("alpha") == "ready", seconds=60.0)
        if not may_start or (host.entry("slam") or {}).get("orphaned"):
            ask_for(host, "takeover" if may_start else "start", TICKS, 2)
        until_running(host, seconds=120.0)
        assert (len(host.node.list_running()), swarm.list_services()) == (1, [NAME])
        check_stops(host, swarm)


def test_the_engine_of_its_node_is_killed(swarm: Swarm, state: Path) -> None:
    """It ends its containers as it comes back; the supervisor starts another service."""
    host = a_host(swarm, "alpha", state)
    pid = start_ticks(host)
    host.node.engine.kill()
    eventually(lambda: "does not answer" in (host.entry("slam") or {}).get("detail", ""))
    assert (host.entry("slam") or {})["pid"] == pid
    host.node.engine.start()
    eventually(lambda: (e := host.entry("slam")) and e["restarts"] and e["state"] == "running", seconds=90.0)
    assert until_running(host)["pid"] != pid
    assert len(host.node.list_running()) == 1
    check_stops(host, swarm)


def test_a_node_that_was_cut_off_is_never_doubled(swarm: Swarm, state: Path) -> None:
    """Cut off it runs on; back again, the swarm ends what it had given up, and the supervisor restarts it."""
    host = a_host(swarm, "alpha", state)
    pid = start_ticks(host)
    host.node.drop_packets()
    eventually(lambda: swarm.get_state("alpha") == "down", seconds=60.0)
    assert (is_running(pid), (host.entry("slam") or {})["pid"]) == (True, pid)
    assert all(node.list_running() == [] for name, node in swarm.nodes.items() if name != "alpha")
    host.node.pass_packets()
    eventually(lambda: swarm.get_state("alpha") == "ready", seconds=60.0)
    time.sleep(5.0)  # as long as the swarm takes to end what it had given up
    until_running(host)
    assert len(host.node.list_running()) == 1
    check_stops(host, swarm)


def test_a_service_that_may_start_later_is_held_until_it_is_removed(swarm: Swarm, state: Path) -> None:
    """A manager has given the task to a node that was just cut off: it may start it once it hears of it."""
    host = a_host(swarm, "alpha", state)
    host.node.drop_packets()
    assert ask_for(host, "start", TICKS, 1)["state"] == "started"
    entry = host.entry("slam") or {}
    assert (entry["state"], entry["pid"], read_container(str(host.folder("slam")))["pending"]) == (
        "starting",
        host.supervisor("slam"),
        True,
    )
    eventually(lambda: "waiting for the swarm" in (host.entry("slam") or {}).get("detail", ""))
    assert host.stop("slam", timeout=150.0)["state"] == "stop-incomplete"
    assert host.entry("slam") is not None
    assert ask_for(host, "start", TICKS, 2)["state"] == "already-running"
    host.node.pass_packets()
    eventually(lambda: swarm.get_state("alpha") == "ready", seconds=60.0)
    check_stops(host, swarm)


def test_a_request_of_which_nobody_knows_is_found_again(swarm: Swarm, state: Path) -> None:
    """The supervisor dies right after it has asked: what starts later is found, and followed or stopped."""
    host = a_host(swarm, "alpha", state)
    host.start("slam", TICKS, restart="always")
    folder = str(host.folder("slam"))
    inside = find_container_processes(folder, proc.read_process_table())
    for pid in (host.supervisor("slam"), *(host.members("slam") - inside)):
        os.kill(pid, signal.SIGKILL)
    # As its record was before the container was seen.
    before = {"id": "", "pid": 0, "ticks": -1, "name": "", "pending": True}
    write_container(folder, read_container(folder) | before)
    entry = host.entry("slam") or {}
    assert (entry["orphaned"], entry["adoptable"]) == (True, True)
    assert ask_for(host, "takeover", TICKS, 2)["state"] == "taken-over"
    until_running(host)
    assert len(host.node.list_running()) == 1
    check_stops(host, swarm)
