# SPDX-License-Identifier: Apache-2.0
"""A Docker Swarm of the computers of a fleet, whose tasks are its services. The first computer is the manager; the
ordinary user of each other one reaches it by ssh, with a context of docker.
"""

import json
import os
import shutil
from typing import TYPE_CHECKING

from tests.faults.hosts import wait_for
from tests.faults.namespace_host import USER, NamespaceHost

if TYPE_CHECKING:
    from tests.containers.docker_engine import EngineClient
    from tests.faults.fleet import FaultFleet

CONTEXT = "lab"
_UID = 4711
# A node that is away for three of these is down; a busy machine must not pass for that.
_HEARTBEAT = "10s"


def form_swarm(fleet: "FaultFleet") -> None:
    """Make the computers one swarm, and tell the inventory how each reaches the manager."""
    manager, *workers = (fleet.get_computer(name) for name in fleet.edges)
    engine = get_engine(manager)
    engine.call("swarm", "init", *_build_place(manager), "--dispatcher-heartbeat", _HEARTBEAT)
    token = engine.call("swarm", "join-token", "--quiet", "worker")
    for worker in workers:
        get_engine(worker).call(
            "swarm", "join", "--token", token, *_build_place(worker), f"{manager.address}:2377"
        )
        _give_context(fleet, worker, manager)
        fleet.inventory[worker.name]["swarm"] = [CONTEXT]
    fleet.write_files()


def _build_place(computer: NamespaceHost) -> tuple[str, ...]:
    return "--advertise-addr", computer.address, "--listen-addr", f"{computer.address}:2377"


def get_engine(computer: NamespaceHost) -> "EngineClient":
    """The engine of a computer that has one."""
    assert computer.engine is not None
    return computer.engine


def _give_context(fleet: "FaultFleet", worker: NamespaceHost, manager: NamespaceHost) -> None:
    """What the page on containers asks of a worker: a key, a known host, and the context."""
    folder = worker.home / ".ssh"
    folder.mkdir(mode=0o700)
    shutil.copy(fleet.key_file, folder / "id")
    (folder / "config").write_text(f"IdentityFile ~/.ssh/id\nHost {manager.address}\n  User {USER}\n")
    _trust(worker, manager)
    for path in (folder, *folder.iterdir()):
        os.chown(path, _UID, _UID)
        path.chmod(0o700 if path == folder else 0o600)
    place = f"host=ssh://{USER}@{manager.address}"
    done = worker.run("docker", "context", "create", CONTEXT, "--docker", place)
    assert done.returncode == 0, done.stderr


def _trust(worker: NamespaceHost, manager: NamespaceHost) -> None:
    (worker.home / ".ssh" / "known_hosts").write_text(f"{manager.address} {manager.key}\n")


def trust_manager(fleet: "FaultFleet") -> None:
    """Have the user of each worker accept the present host key of the manager."""
    manager, *workers = (fleet.get_computer(name) for name in fleet.edges)
    for worker in workers:
        _trust(worker, manager)


def await_nodes(fleet: "FaultFleet") -> None:
    """Wait until the manager has heard of every node, and each has ended what it was told to end meanwhile."""
    engine = get_engine(fleet.get_computer(fleet.first))

    def all_ready() -> bool:
        status, said = engine.request("GET", "/nodes")
        return status == 200 and all(each["Status"]["State"] == "ready" for each in json.loads(said))

    def all_ended() -> bool:
        status, said = engine.request("GET", "/tasks")
        return status == 200 and not any(
            each["DesiredState"] in ("shutdown", "remove") and each["Status"]["State"] == "running"
            for each in json.loads(said)
        )

    wait_for(all_ready, "all nodes of the swarm", 90)
    wait_for(all_ended, "the end of what the swarm had given up", 60)


def list_left_services(fleet: "FaultFleet") -> list[str]:
    """The services that are left after all tasks were stopped, one sentence each."""
    status, said = get_engine(fleet.get_computer(fleet.first)).request("GET", "/services")
    assert status == 200, said
    return [f"service {each['Spec']['Name']}" for each in json.loads(said)]
