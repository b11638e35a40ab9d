"""Faults of the inventory: a host is renamed, removed or given another address while tasks run on it."""

from tests.faults.command_result import ExpectationError
from tests.faults.fleet import FaultFleet
from tests.faults.registry import ALL, fault

EDGES = ("edge1", "edge2", "edge3")


def start_on_edge1(fleet: FaultFleet) -> None:
    """Start two tasks, one of them on edge1, that may run anywhere afterwards."""
    fleet.add_task("slam", on="edge1")
    fleet.add_task("nav", on="edge2")
    fleet.apply_and_check()
    fleet.pin_task("slam", None)
    fleet.pin_task("nav", None)


def expect_held(fleet: FaultFleet) -> None:
    """``slam`` is held and named by status, plan and apply; a second apply changes nothing about that."""
    for words in (("status",), ("plan",), ("apply", "--yes"), ("apply", "--yes")):
        found = fleet.run_edgectl(*words).expect_exit(4)
        if "edgectl fence edge1" not in found.out + found.err:
            raise ExpectationError(f"no word about slam on edge1: {found}")
        fleet.check_verdict()


@fault("host renamed in the inventory while tasks run", full=3, hosts=EDGES, kinds=ALL)
def rename_host(fleet: FaultFleet) -> None:
    """The machine tells under which name it keeps the task, so it runs on; at random it is renamed back."""
    start_on_edge1(fleet)
    fleet.inventory["jetson-a"] = fleet.inventory.pop("edge1")
    fleet.write_files()
    fleet.apply_and_check()
    if fleet.random.random() < 0.5:
        fleet.inventory["edge1"] = fleet.inventory.pop("jetson-a")
        fleet.write_files()
        fleet.apply_and_check()
    if fleet.count_launches("slam") != 1:
        raise ExpectationError("slam was started again")


@fault("host removed from the inventory while tasks run", full=3, hosts=EDGES, kinds=ALL)
def remove_host(fleet: FaultFleet) -> None:
    start_on_edge1(fleet)
    removed = fleet.inventory.pop("edge1")
    fleet.write_files()
    expect_held(fleet)
    fleet.inventory["edge1"] = removed
    fleet.write_files()


@fault("host given another address while tasks run", full=3, hosts=EDGES, kinds=ALL)
def readdress_host(fleet: FaultFleet) -> None:
    start_on_edge1(fleet)
    spare = fleet.inventory.pop("edge3")
    fleet.inventory["edge1"]["host"] = "edge3"
    fleet.write_files()
    expect_held(fleet)
    fleet.inventory["edge1"]["host"] = "edge1"
    fleet.inventory["edge3"] = spare
    fleet.write_files()
