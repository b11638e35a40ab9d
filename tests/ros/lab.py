# SPDX-License-Identifier: Apache-2.0
"""A lab for the tests: real ROS on computers in namespaces, each with an address of its own."""

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.faults.fleet import APPLY, FaultFleet, open_fleet
from tests.pace import patience
from tests.views.fixtures import ROOT

HERE = Path(__file__).parent
MASTER = "http://{address}:11311"
CORE, SECOND, ROBOT = "host1", "host2", "host3"
WITH_CORE = {"task": "roscore", "restart": "with"}
NODE = "exec /usr/bin/python3 $HOME/{file}"
NODE2 = "exec python3 $HOME/{file}"
# Where computers have the libraries of ROS 2.
LIBRARIES = "/opt/ros2-libraries"


@contextmanager
def open_lab(
    folder: Path, version: int = 1, names: "tuple[str, ...]" = (CORE, SECOND, ROBOT)
) -> Iterator[FaultFleet]:
    """Open a fleet of three computers with the ROS 1 of this machine, where the master is to run on the first, or
    with the ROS 2 of the tests.
    """
    shared = {} if version == 1 else {LIBRARIES: ROOT / ".venv-ros2" / "lib"}
    with open_fleet("namespace", folder, list(names), 1, shared=shared) as fleet:
        master = MASTER.format(address=fleet.get_computer(names[0]).address)
        for name in fleet.hosts:
            host = fleet.get_computer(name)
            host.boot()
            ros = {"version": 1, "master": master}
            if version != 1:
                ros = {"version": 2, "domain": 7, "setup": [install_ros2(host.home)]}
            fleet.inventory[name]["ros"] = ros
            for file in ("counting.py", "pipeline.py"):
                shutil.copy(HERE / file, host.home / file)
        fleet.trust_host_keys()
        for name in fleet.hosts:
            result = fleet.run_edgectl("trust", name, "--yes")
            assert result.code == 0, result
        yield fleet


def install_ros2(home: Path) -> str:
    """Make a Python of the computer that has the libraries of ROS 2: the set-up file, as the computer names it."""
    venv = home / "ros2"
    (venv / "bin").mkdir(parents=True, exist_ok=True)
    (venv / "pyvenv.cfg").write_text("home = /usr/bin\n")
    for place, target in ((venv / "bin" / "python3", "/usr/bin/python3"), (venv / "lib", LIBRARIES)):
        if not place.is_symlink():
            place.symlink_to(target)
    (home / "setup.bash").write_text("export PATH=$HOME/ros2/bin:$PATH\n")
    return "~/setup.bash"


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
