# SPDX-License-Identifier: Apache-2.0
"""What a task in a container loses is found again: supervisor, runner, client, shim and engine, one by one and all at once.

After each loss there is exactly one instance; after the stop nothing of it is left.
"""

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.containers.record import find_container_processes, read_container
from edgectl.agent.measure import proc
from edgectl.agent.supervise import liveness
from tests.agent.conftest import a_spec, eventually, is_running
from tests.containers.conftest import ContainerHost, an_image
from tests.containers.docker_engine import DockerEngine, docker_engine

COMMAND = "while :; do echo tick; sleep 0.1; done"


@pytest.fixture(params=["live-restore", "no live-restore"])
def engine(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[DockerEngine]:
    """An engine of each test's own, which it may break."""
    with docker_engine(tmp_path_factory.mktemp("d"), live_restore=request.param == "live-restore") as found:
        yield found


def start(host: ContainerHost) -> int:
    pid: int = host.start("slam", COMMAND, restart="always")["pid"]  # type: ignore[assignment]
    return pid


def list_inside(host: ContainerHost) -> set[int]:
    return find_container_processes(str(host.folder("slam")), proc.read_process_table())


def list_followers(host: ContainerHost) -> set[int]:
    """Runner and client: what is below the supervisor outside of the container."""
    record, table = liveness.read_instance(str(host.folder("slam"))), proc.read_process_table()
    return liveness.find_processes(record, table) - list_inside(host)


def read_log(host: ContainerHost) -> str:
    text: str = host.ask("logs", task="slam", tail=5000)["text"]
    return text


def await_runs(host: ContainerHost, number: int) -> None:
    eventually(lambda: read_log(host).count("up\n") == number and find_settled(host), seconds=60.0)


def kill(pids: set[int]) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def repair(host: ContainerHost, generation: int) -> None:
    """What an apply does: a takeover of an orphan, a start of what does not run."""
    entry = host.entry("slam")
    spec: dict[str, Any] = a_spec(COMMAND, image=an_image(), restart="always")
    if entry and entry.get("orphaned"):
        host.ask(
            "takeover",
            task="slam",
            instance=entry["instance"],
            generation=generation,
            spec=spec,
            timeout=120.0,
        )
    elif not entry or entry["state"] not in ("running", "starting"):
        host.start("slam", COMMAND, instance=f"i{generation}", generation=generation, restart="always")


def find_settled(host: ContainerHost) -> dict[str, Any] | None:
    """The entry of a task that runs and has nothing to say; not one whose end its supervisor is just handling."""
    entry = host.entry("slam") or {}
    good = entry.get("state") == "running" and not entry.get("orphaned") and not entry["detail"]
    return entry if good and entry["pid"] in list_inside(host) else None


def check_one_runs_and_ends(host: ContainerHost, engine: DockerEngine) -> None:
    """Exactly one instance, which is supervised and logs; nothing is left of it after a stop."""
    entry = eventually(lambda: find_settled(host), seconds=60.0)
    assert entry["container"] == "edgectl-lab-edge1-slam"
    assert len(engine.list_containers()) == 1
    inside = list_inside(host)
    assert inside
    size = len(read_log(host))
    eventually(lambda: len(read_log(host)) > size)
    followers = list_followers(host)
    assert host.stop("slam", timeout=120.0)["state"] == "stopped"
    assert [pid for pid in inside | followers if is_running(pid)] == []
    assert engine.list_containers() == []


def kill_supervisor(host: ContainerHost, _engine: DockerEngine) -> None:
    kill({host.supervisor("slam")})


def kill_followers(host: ContainerHost, _engine: DockerEngine) -> None:
    kill(list_followers(host))


def kill_all_of_ours(host: ContainerHost, _engine: DockerEngine) -> None:
    kill({host.supervisor("slam")} | list_followers(host))


def kill_shim(host: ContainerHost, engine: DockerEngine) -> None:
    del host
    kill(set(engine.find_shims()))


def restart_engine(_host: ContainerHost, engine: DockerEngine) -> None:
    engine.stop()
    engine.start()


def kill_engine(_host: ContainerHost, engine: DockerEngine) -> None:
    engine.kill()
    engine.start()


def lose_power(host: ContainerHost, engine: DockerEngine) -> None:
    """Everything dies at once; the engine comes back with its disk."""
    kill({host.supervisor("slam")} | list_followers(host))
    engine.kill()
    while left := set(engine.list_processes()):
        kill(left)
        time.sleep(0.05)
    engine.start()


@pytest.mark.parametrize(
    "lose",
    [kill_supervisor, kill_followers, kill_all_of_ours, kill_shim, restart_engine, kill_engine, lose_power],
    ids=lambda lose: lose.__name__,
)
def test_nothing_is_lost_doubled_or_left(
    host: ContainerHost, engine: DockerEngine, lose: Callable[[ContainerHost, DockerEngine], None]
) -> None:
    start(host)
    lose(host, engine)
    for generation in (2, 3):
        repair(host, generation)
    check_one_runs_and_ends(host, engine)


def stop_by_hand(_host: ContainerHost, engine: DockerEngine) -> None:
    engine.call("stop", "edgectl-lab-edge1-slam")


@pytest.mark.parametrize("engine", ["no live-restore"], indirect=True)
def test_a_job_that_is_told_to_end_is_not_completed_by_exit_code_0(
    host: ContainerHost, engine: DockerEngine
) -> None:
    """As an engine does when it ends itself, or finds containers of its former self, without live-restore."""
    # One that is told while its shell has not read the trap yet would exit with 143.
    host.start("slam", "trap 'exit 0' TERM; echo up; while [ ! -e /done ]; do sleep 0.1; done", kind="job")
    for number, lose in enumerate([stop_by_hand, kill_engine, restart_engine], 1):
        await_runs(host, number)
        lose(host, engine)
    await_runs(host, 4)
    assert eventually(lambda: find_settled(host), seconds=60.0)["last_exit"] == 0
    engine.call("exec", "edgectl-lab-edge1-slam", "touch", "/done")
    assert host.until("slam", "completed")["exit_code"] == 0


def test_an_engine_that_is_away_is_said_and_the_container_runs_on(
    host: ContainerHost, engine: DockerEngine
) -> None:
    pid = start(host)
    engine.kill()
    entry = eventually(
        lambda: e if (e := host.entry("slam")) and "docker does not answer" in e["detail"] else None
    )
    assert (entry["state"], entry["pid"], entry["restarts"]) == ("running", pid, 0)
    assert "the container runs on without it" in entry["detail"]
    assert host.ask("probe", window_s=0.2)["tasks"]["slam"]["used_bytes"] > 0
    engine.start()
    if engine.live_restore:
        back = eventually(lambda: e if (e := host.entry("slam")) and not e["detail"] else None)
        assert (back["pid"], back["restarts"]) == (pid, 0)
    else:
        back = eventually(
            lambda: e if (e := host.entry("slam")) and e["restarts"] and e["state"] == "running" else None
        )
        assert back["pid"] != pid
    check_one_runs_and_ends(host, engine)


def test_a_stop_without_an_engine_ends_the_processes(host: ContainerHost, engine: DockerEngine) -> None:
    start(host)
    inside = list_inside(host)
    engine.kill()
    assert host.stop("slam", timeout=120.0)["state"] == "stopped"
    assert [pid for pid in inside if is_running(pid)] == []
    engine.start()
    assert host.entry("slam") is None
    assert host.start("slam", COMMAND, instance="i2", generation=2)["state"] == "started"
    check_one_runs_and_ends(host, engine)


def test_the_record_is_on_disk_before_the_container_runs(host: ContainerHost, engine: DockerEngine) -> None:
    start(host)
    record = read_container(str(host.folder("slam")))
    shown = engine.call("inspect", "--format", "{{.Id}} {{.State.Pid}}", "edgectl-lab-edge1-slam")
    assert shown == f"{record['id']} {record['pid']}"
    assert Path(f"/proc/{record['pid']}").exists()
    host.stop("slam")
