# SPDX-License-Identifier: Apache-2.0
"""What is moved, by name: a plain TCP task, and a lifecycle node of ROS 2."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

from edgectl.model.ros import RosSettings
from edgectl.model.standby import Activation, StandbyRule
from edgectl.model.task import Task
from tests.builders import a_task
from tests.e2e.bench import GENTLE
from tests.faults.namespace_host import USER
from tests.handoffs import node, ros_node
from tests.handoffs.computers import NAMES, copy_program, open_computers, slow_line
from tests.handoffs.ros_subscriber import hear_ros
from tests.handoffs.scene import Scene, a_node_task
from tests.handoffs.subscriber import listen
from tests.ros.lab import LIBRARIES, install_ros2
from tests.views.fixtures import ROOT

# The computers have a network of their own, so any domain is free there.
DOMAIN = 7


@contextmanager
def open_tcp_scene(folder: Path, delay_ms: float) -> Iterator[Scene]:
    """The subscriber is beside the manager; each message takes a slow line to it."""
    with (
        open_computers(folder, delay_ms) as computers,
        listen("127.0.0.1") as subscriber,
        slow_line((subscriber.address, subscriber.port), delay_ms) as far,
    ):
        for host in computers.hosts.values():
            copy_program(host, node.__file__, "node.py")
        task = a_node_task(Path(f"/home/{USER}/handoff"), computers.address, far[1])
        # As it is on computers that do not have this repository.
        command = task.command.replace(node.__file__, f"/home/{USER}/node.py")
        yield Scene(computers.bench, NAMES, replace(task, command=command), subscriber)


@contextmanager
def open_ros2_scene(folder: Path, delay_ms: float) -> Iterator[Scene]:
    """The subscriber is beside the manager. The slow lines are TCP and carry what edgectl says alone; the messages,
    which are UDP, take the cables between the namespaces.
    """
    ros = RosSettings(version=2, domain=DOMAIN, setup=("~/setup.bash",))
    shared = {LIBRARIES: ROOT / ".venv-ros2" / "lib"}
    with (
        open_computers(folder, delay_ms, ros=ros, shared=shared) as computers,
        hear_ros(DOMAIN) as subscriber,
    ):
        for host in computers.hosts.values():
            install_ros2(host.home)
            copy_program(host, ros_node.__file__, "ros_node.py")
        yield Scene(computers.bench, NAMES, a_ros_task(), subscriber, discovers=True)


def a_ros_task() -> Task:
    """The lifecycle node: each of its copies has a name of its own."""
    return a_task(
        "camera",
        cpu=0.5,
        command="exec python3 $HOME/ros_node.py camera_$EDGECTL_HOST $EDGECTL_HOST",
        standby=StandbyRule(activation=Activation(lifecycle="/camera_{host}")),
        stop=GENTLE,
        up=0.1,
    )


SCENES: dict[str, Callable[[Path, float], AbstractContextManager[Scene]]] = {
    "tcp": open_tcp_scene,
    "ros2": open_ros2_scene,
}
