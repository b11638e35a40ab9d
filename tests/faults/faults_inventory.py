# SPDX-License-Identifier: Apache-2.0
"""Faults of the inventory: a host is renamed, removed, or given another address or user while tasks run on it."""

from collections.abc import Callable
from copy import deepcopy

from tests.faults.command_result import ExpectationError
from tests.faults.fleet import FaultFleet
from tests.faults.registry import ALL, fault


def start_on_first(fleet: FaultFleet) -> None:
    """Start two tasks, one of them on the first host, that may run anywhere afterwards."""
    fleet.add_task("slam", on=fleet.first)
    fleet.add_task("nav", on=fleet.second)
    fleet.apply_and_check()
    fleet.pin_task("slam", None)
    fleet.pin_task("nav", None)


def expect_held(fleet: FaultFleet) -> None:
    """``slam`` is held and named by status, plan and apply; a second apply changes nothing about that."""
    asked = [("status",), ("plan",), ("apply", "--yes"), ("apply", "--yes")]
    for words in asked[2:3] if fleet.sample else asked:
        found = fleet.run_edgectl(*words).expect_exit(4)
        if f"edgectl fence {fleet.first}" not in found.out + found.err:
            raise ExpectationError(f"no word about slam on {fleet.first}: {found}")
        fleet.check_verdict()


@fault("host renamed in the inventory while tasks run", full=3, kinds=ALL)
def rename_host(fleet: FaultFleet) -> None:
    """The machine tells under which name it keeps the task, so it runs on; at random it is renamed back."""
    start_on_first(fleet)
    fleet.inventory["jetson-a"] = fleet.inventory.pop(fleet.first)
    fleet.write_files()
    fleet.apply_and_check()
    if fleet.random.random() < 0.5:
        fleet.inventory[fleet.first] = fleet.inventory.pop("jetson-a")
        fleet.write_files()
        fleet.apply_and_check()
    if fleet.count_launches("slam") != 1:
        raise ExpectationError("slam was started again")


@fault("host removed from the inventory while tasks run", full=3, kinds=ALL)
def remove_host(fleet: FaultFleet) -> None:
    start_on_first(fleet)
    removed = fleet.inventory.pop(fleet.first)
    fleet.write_files()
    expect_held(fleet)
    fleet.inventory[fleet.first] = removed
    fleet.write_files()


@fault("host given another address while tasks run", quick=True, full=3, kinds=ALL)
def readdress_host(fleet: FaultFleet) -> None:
    start_on_first(fleet)
    spare = fleet.inventory.pop(fleet.third)
    fleet.inventory[fleet.first]["host"] = fleet.third
    fleet.write_files()
    expect_held(fleet)
    fleet.inventory[fleet.first]["host"] = fleet.first
    fleet.inventory[fleet.third] = spare
    fleet.write_files()


@fault("two hosts swap their addresses while tasks run", full=3, kinds=ALL)
def swap_addresses(fleet: FaultFleet) -> None:
    start_on_first(fleet)
    _swap(fleet, fleet.first, fleet.second)
    expect_held(fleet)
    _swap(fleet, fleet.first, fleet.second)
    fleet.write_files()


@fault("login user of a host changed while tasks run", full=3, kinds=("namespace", "systemd"))
def change_user(fleet: FaultFleet) -> None:
    start_on_first(fleet)
    fleet.inventory[fleet.first]["user"] = "root"
    fleet.write_files()
    expect_held(fleet)
    del fleet.inventory[fleet.first]["user"]
    fleet.write_files()


@fault("eight random edits of the inventory, each applied", full=6, kinds=ALL)
def edit_at_random(fleet: FaultFleet) -> None:
    """Whatever the inventory says, each task runs on as it was started."""
    for task in ("slam", "nav", "map"):
        fleet.add_task(task, on=fleet.random.choice(fleet.edges))
    fleet.apply_and_check()
    for task in fleet.expected:
        fleet.pin_task(task, None)
    before = deepcopy(fleet.inventory)
    for _ in range(8):
        _edit(fleet)
        fleet.write_files()
        fleet.injected += 1
        fleet.apply().expect_exit(0, 4)
        fleet.check_verdict()
    fleet.inventory = before
    fleet.write_files()
    if any(fleet.count_launches(task) != 1 for task in fleet.expected):
        raise ExpectationError("a task was started again")


def _edit(fleet: FaultFleet) -> None:
    edits: list[Callable[[FaultFleet], None]] = [
        _rename_any,
        _remove_any,
        _restore_any,
        _swap_any,
        _readdress_any,
    ]
    if fleet.hosts[fleet.first].kind != "loopback":
        edits.append(_change_any_user)
    fleet.random.choice(edits)(fleet)


def _draw_name(fleet: FaultFleet) -> str:
    return fleet.random.choice(sorted(fleet.inventory))


def _rename_any(fleet: FaultFleet) -> None:
    fleet.inventory[f"jetson-{fleet.injected}"] = fleet.inventory.pop(_draw_name(fleet))


def _remove_any(fleet: FaultFleet) -> None:
    if len(fleet.inventory) > 1:
        del fleet.inventory[_draw_name(fleet)]


def _restore_any(fleet: FaultFleet) -> None:
    """Bring back a machine that no name reaches, under its first name or another one."""
    reached = {host["host"] for host in fleet.inventory.values()}
    for machine in sorted(fleet.hosts.keys() - reached):
        name = machine if machine not in fleet.inventory else f"again-{fleet.injected}"
        fleet.inventory[name] = {**next(iter(fleet.inventory.values())), "host": machine}


def _swap_any(fleet: FaultFleet) -> None:
    if len(fleet.inventory) > 1:
        _swap(fleet, *fleet.random.sample(sorted(fleet.inventory), 2))


def _swap(fleet: FaultFleet, one: str, other: str) -> None:
    first, second = fleet.inventory[one], fleet.inventory[other]
    first["host"], second["host"] = second["host"], first["host"]
    fleet.write_files()


def _readdress_any(fleet: FaultFleet) -> None:
    """Give a name the address of a machine that no name reaches, if there is one."""
    free = sorted(fleet.hosts.keys() - {host["host"] for host in fleet.inventory.values()})
    if free:
        fleet.inventory[_draw_name(fleet)]["host"] = fleet.random.choice(free)


def _change_any_user(fleet: FaultFleet) -> None:
    host = fleet.inventory[_draw_name(fleet)]
    if host.pop("user", None) is None:
        host["user"] = "root"
