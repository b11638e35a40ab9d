"""A lab for the tests: real ROS 1 on computers in namespaces, each with an address of its own."""

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.faults.fleet import APPLY, FaultFleet, open_fleet
from tests.pace import patience

HERE = Path(__file__).parent
MASTER = "http://{address}:11311"
CORE, SECOND, ROBOT = "host1", "host2", "host3"
WITH_CORE = {"task": "roscore", "restart": "with"}
NODE = "exec /usr/bin/python3 $HOME/{file}"


@contextmanager
def open_lab(folder: Path) -> Iterator[FaultFleet]:
    """Open a fleet of three computers with the ROS 1 of this machine; the master is to run on the first."""
    with open_fleet("namespace", folder, [CORE, SECOND, ROBOT], 1) as fleet:
        master = MASTER.format(address=fleet.get_computer(CORE).address)
        for name in fleet.hosts:
            fleet.inventory[name]["ros"] = {"version": 1, "master": master}
            host = fleet.get_computer(name)
            host.boot()
            for file in ("counting.py", "pipeline.py"):
                shutil.copy(HERE / file, host.home / file)
        fleet.trust_host_keys()
        for name in fleet.hosts:
            result = fleet.run_edgectl("trust", name, "--yes")
            assert result.code == 0, result
        yield fleet


def add_task(fleet: FaultFleet, name: str, command: str, *hosts: str, **fields: Any) -> None:
    """Add a task that may run on ``hosts``."""
    where = {"pin": hosts[0]} if len(hosts) == 1 else {"only": list(hosts)}
    demand = {"cpu": 0, "memory": "1Mi", "throughput": 0}
    fleet.tasks[name] = {"command": command, "hosts": where, "demand": demand, "stop": {"signal": "INT", "grace": "5s"}} | fields  # fmt: skip
    fleet.write_files()


def add_core(fleet: FaultFleet) -> None:
    add_task(
        fleet,
        "roscore",
        "exec roscore",
        CORE,
        ready={"ros_node": "/rosout", "timeout": "60s"},
        restart="always",
        stop="ros",
    )


def apply(fleet: FaultFleet) -> dict[str, Any]:
    """Apply; the results as a document."""
    result = fleet.run_edgectl(*APPLY, "-o", "json")
    document: dict[str, Any] = json.loads(result.out)
    return document


def list_nodes(fleet: FaultFleet) -> set[str]:
    """The nodes that the master knows, asked from its own host; empty where there is none."""
    core = fleet.get_computer(CORE)
    uri = MASTER.format(address=core.address)
    return set(core.run("env", f"ROS_MASTER_URI={uri}", "rosnode", "list").stdout.split())


def read_times(fleet: FaultFleet, file: str) -> list[float]:
    """When the sink on the robot heard something."""
    path = fleet.get_computer(ROBOT).home / file
    lines = path.read_text().split("\n")[:-1] if path.exists() else []
    return [float(line) for line in lines]


def wait_for(found: Any, seconds: float) -> None:
    until = time.monotonic() + patience(seconds)
    while not found():
        assert time.monotonic() < until, "did not happen in time"
        time.sleep(0.2)
