# SPDX-License-Identifier: Apache-2.0
"""Faults of a move to a host that has to pull the image first: a slow registry, none, and what breaks meanwhile."""

import signal
from subprocess import Popen
from typing import Any

from tests.containers.registry import ImageRegistry, open_registry
from tests.faults.command_result import ExpectationError
from tests.faults.fleet import APPLY, FaultFleet
from tests.faults.hosts import wait_for
from tests.faults.manager import signal_manager
from tests.faults.registry import CONTAINERS, fault


def start_pulled_task(fleet: FaultFleet) -> ImageRegistry:
    """The image of slam comes from a registry, and is on the first host alone."""
    address = f"{fleet.get_computer(fleet.first).site.network}.1"
    registry = fleet.stack.enter_context(open_registry(address, fleet.netns))
    for task, host in zip(("slam", "nav", "grip"), fleet.edges, strict=False):
        more: dict[str, Any] = {"image": build_pulled_image(fleet, registry, 1)} if task == "slam" else {}
        fleet.add_task(task, on=host, **more)
    fleet.apply_and_check()
    return registry


def build_pulled_image(fleet: FaultFleet, registry: ImageRegistry, number: int) -> dict[str, object]:
    return fleet.build_image(name=f"{registry.address}/slam:{number}", pull="missing")


def begin_held_move(fleet: FaultFleet, registry: ImageRegistry) -> "Popen[str]":
    """An apply that moves slam to the second host, whose engine waits for the registry."""
    registry.open.clear()
    fleet.pin_task("slam", fleet.second)
    running = fleet.start_edgectl(*APPLY)
    address = fleet.get_computer(fleet.second).address
    wait_for(lambda: address in registry.asked, "the pull on the new host", 60)
    return running


def check_untouched(fleet: FaultFleet, host: str, launches: int) -> None:
    """The old instance runs on as it did."""
    fleet.check_verdict({**fleet.expected, "slam": host})
    if fleet.count_launches("slam") != launches:
        raise ExpectationError("slam was started again")


@fault("image pulled while the old instance runs", kinds=CONTAINERS, quick=True, full=3)
def pull_before_stop(fleet: FaultFleet) -> None:
    """Then one that the registry does not have: for a move, or for a new instance in place."""
    registry = start_pulled_task(fleet)
    launches = fleet.count_launches("slam")
    running = begin_held_move(fleet, registry)
    check_untouched(fleet, fleet.first, launches)
    registry.open.set()
    fleet.wait_for_edgectl(running).expect_exit(0)
    fleet.check_verdict()
    registry.empty = True
    if fleet.random.random() < 0.5:
        fleet.pin_task("slam", fleet.third)
    else:
        fleet.tasks["slam"]["image"] = build_pulled_image(fleet, registry, 2)
        fleet.write_files()
    fleet.apply().expect_exit(4).expect_output("cannot be pulled", "slam")
    check_untouched(fleet, fleet.second, launches + 1)
    registry.empty = False


@fault("manager killed while the image is pulled", kinds=CONTAINERS, full=2)
def kill_manager_in_pull(fleet: FaultFleet) -> None:
    registry = start_pulled_task(fleet)
    launches = fleet.count_launches("slam")
    running = begin_held_move(fleet, registry)
    signal_manager(running, signal.SIGKILL)
    fleet.wait_for_edgectl(running)
    check_untouched(fleet, fleet.first, launches)
    registry.open.set()


@fault("host loses power while it pulls the image", kinds=CONTAINERS, full=2)
def power_off_in_pull(fleet: FaultFleet) -> None:
    registry = start_pulled_task(fleet)
    launches = fleet.count_launches("slam")
    running = begin_held_move(fleet, registry)
    fleet.hosts[fleet.second].power_off()
    fleet.wait_for_edgectl(running).expect_exit(4)
    fleet.check_verdict({"slam": fleet.first, "grip": fleet.third})
    if fleet.count_launches("slam") != launches:
        raise ExpectationError("slam was started again")
    registry.open.set()


@fault("engine killed while it pulls the image", kinds=CONTAINERS, full=2)
def kill_engine_in_pull(fleet: FaultFleet) -> None:
    registry = start_pulled_task(fleet)
    launches = fleet.count_launches("slam")
    running = begin_held_move(fleet, registry)
    engine = fleet.engines[fleet.second]
    engine.kill()
    fleet.wait_for_edgectl(running).expect_exit(4)
    engine.start()
    if not engine.live_restore:
        # The engine ends nav as it comes back, which exits with 0 then: its supervisor starts it again all the same.
        wait_for(lambda: fleet.count_launches("nav") == 2, "the second start of nav", 60)
    check_untouched(fleet, fleet.first, launches)
    registry.open.set()
