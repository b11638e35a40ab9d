# SPDX-License-Identifier: Apache-2.0
"""A lifecycle node of ROS 2 that moves warm while something dies: never two active, and one in the end."""

import shutil
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from tests.faults.failpoint_runner import read_failpoints
from tests.faults.faults_failpoints import APPLY_ONE, kill_at_failpoint
from tests.faults.faults_warm_move import kill_supervisor_on, strike_at_point
from tests.faults.fleet import FaultFleet
from tests.faults.hosts import wait_for
from tests.handoffs import ros_node
from tests.handoffs.__main__ import find_missing
from tests.handoffs.ros_subscriber import hear_ros
from tests.handoffs.subscriber import Subscriber
from tests.ros.lab import CORE, SECOND, add_task, open_lab

pytestmark = pytest.mark.skipif(bool(find_missing("ros2")), reason=find_missing("ros2"))
DOMAIN = 7
# A move, its undoing, and the apply that follows; two that send every 4 ms change far more often.
MOST_CHANGES = 3


class Scene:
    """The node, its copy on the other computer, and who hears it beside the manager."""

    def __init__(self, fleet: FaultFleet, subscriber: Subscriber) -> None:
        self.fleet, self.subscriber, self.active = fleet, subscriber, CORE
        self.points: list[str] = []

    @property
    def other(self) -> str:
        return SECOND if self.active == CORE else CORE

    def prefer(self, host: str) -> None:
        """From now on this host is by far the best."""
        for name, each in self.fleet.inventory.items():
            each["capacity"] = {"cpu": 16 if name == host else 1, "memory": "8Gi"}
        self.fleet.write_files()

    def apply(self) -> None:
        """Apply, and find out who is active: the only one that is heard."""
        self.fleet.run_edgectl(*APPLY_ONE).expect_exit(0)
        before = self.subscriber.count()
        # Discovery of a new node takes seconds on a busy machine.
        wait_for(lambda: self.subscriber.count() > before, "a message of the node that is active")
        self.fleet.wait(1.0)
        senders = {message.sender for message in self.subscriber.take()[before:]}
        assert len(senders) == 1, senders
        (self.active,) = senders

    def note_points(self) -> None:
        """Note the failpoints of a warm move that is not disturbed."""
        self.fleet.kill_at = 0
        self.fleet.failpoint_log.unlink(missing_ok=True)
        self.prefer(self.other)
        self.apply()
        self.fleet.kill_at = None
        self.points = read_failpoints(self.fleet.failpoint_log)

    def count_changes(self, since: int) -> int:
        messages = sorted(self.subscriber.take()[since:], key=lambda message: message.sent_ns)
        return sum(first.sender != second.sender for first, second in pairwise(messages))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    with (
        open_lab(tmp_path_factory.mktemp("lab"), 2) as fleet,
        hear_ros(DOMAIN, fleet.prefix) as subscriber,
    ):
        for name in (CORE, SECOND):
            shutil.copy(Path(ros_node.__file__), fleet.get_computer(name).home / "ros_node.py")
        fleet.policy = {"min_dwell": "0s", "move_margin": 0.01, "weights": "cpu"}
        add_task(
            fleet,
            "camera",
            f"exec python3 $HOME/ros_node.py camera_$EDGECTL_HOST $EDGECTL_HOST {fleet.mark}",
            CORE,
            SECOND,
            demand={"cpu": 0.8, "memory": "1Mi", "throughput": 0},
            standby={"ros_lifecycle": "/camera_{host}"},
        )
        found = Scene(fleet, subscriber)
        found.prefer(CORE)
        found.apply()
        found.note_points()
        yield found
        fleet.run_edgectl("stop", "--all", "--yes").expect_exit(0)


@pytest.mark.parametrize("point", ["deactivate sent", "deactivate acknowledged", "activate sent"])
def test_the_manager_is_killed(scene: Scene, point: str) -> None:
    number = scene.points.index(point) + 1
    before, injected = scene.subscriber.count(), scene.fleet.injected
    scene.prefer(scene.other)
    kill_at_failpoint(scene.fleet, APPLY_ONE, number)
    assert scene.fleet.injected == injected + 1
    scene.apply()
    assert scene.count_changes(before) <= MOST_CHANGES


def kill_old_supervisor(scene: Scene) -> None:
    kill_supervisor_on(scene.fleet, scene.active)


def lose_new_host(scene: Scene) -> None:
    scene.fleet.hosts[scene.other].power_off()


@pytest.mark.parametrize(
    ("strike", "point"),
    [
        (kill_old_supervisor, "deactivate held"),
        (kill_old_supervisor, "deactivate acknowledged"),
        (lose_new_host, "deactivate acknowledged"),
    ],
)
def test_the_old_supervisor_or_the_new_host_dies(
    scene: Scene, strike: Callable[[Scene], None], point: str
) -> None:
    number = scene.points.index(point) + 1
    before, injected = scene.subscriber.count(), scene.fleet.injected
    scene.prefer(scene.other)
    strike_at_point(scene.fleet, APPLY_ONE, number, lambda: strike(scene))
    assert scene.fleet.injected == injected + 1
    for name in (CORE, SECOND):
        scene.fleet.hosts[name].boot()
    scene.apply()
    assert scene.count_changes(before) <= MOST_CHANGES
