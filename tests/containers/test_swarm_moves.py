# SPDX-License-Identifier: Apache-2.0
"""The commands on services of a swarm, over ssh to three computers with an engine each: plan, apply, a move, a loss of power, stop.

The workers reach their manager as the page on containers says: by a context of docker over ssh.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults.fleet import EdgectlVariant, FaultFleet, open_fleet, repair_fleet
from tests.faults.registry import find_missing_for_engines
from tests.faults.swarm_fleet import CONTEXT, get_engine


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[FaultFleet]:
    assert not (lacking := find_missing_for_engines()), lacking
    variant = EdgectlVariant(swarm=True)
    with open_fleet("containers", tmp_path, ["zeta", "mid", "alpha"], 1, variant) as found:
        yield found


def list_services(fleet: FaultFleet) -> list[str]:
    _, said = get_engine(fleet.get_computer("zeta")).request("GET", "/services")
    return [each["Spec"]["Name"] for each in json.loads(said)]


def test_apply_move_power_cut_and_stop(fleet: FaultFleet) -> None:
    fleet.add_task("slam", on="alpha")
    fleet.add_task("nav", on="zeta")
    doctor = fleet.run_edgectl("doctor", "-o", "json").expect_exit(0, 1, 4)
    found = {each["host"]: each for each in json.loads(doctor.out)["items"] if each["check"] == "containers"}
    assert [found[name]["message"].rpartition(", ")[2] for name in ("zeta", "mid", "alpha")] == [
        "swarm manager",
        "swarm worker",
        "swarm worker",
    ]
    fleet.apply_and_check()
    assert sorted(list_services(fleet)) == ["edgectl-faults-alpha-slam", "edgectl-faults-zeta-nav"]
    fleet.pin_task("slam", "mid")
    fleet.apply_and_check()
    assert sorted(list_services(fleet)) == ["edgectl-faults-mid-slam", "edgectl-faults-zeta-nav"]
    mid = fleet.get_computer("mid")
    mid.power_off()
    fleet.apply().expect_exit(0, 4)
    fleet.check_verdict({"nav": "zeta"})
    repair_fleet(fleet)
    fleet.apply_and_check()
    fleet.run_edgectl("stop", "--all", "--yes").expect_exit(0)
    assert list_services(fleet) == []
    assert fleet.find_leftovers().clean


def test_a_host_that_reaches_no_manager_is_reported_and_takes_nothing(fleet: FaultFleet) -> None:
    fleet.add_task("slam", on="alpha")
    fleet.get_computer("alpha").run("docker", "context", "rm", "--force", CONTEXT)
    doctor = fleet.run_edgectl("doctor", "-o", "json").expect_exit(0, 1, 4)
    (found,) = [
        each
        for each in json.loads(doctor.out)["items"]
        if (each["host"], each["check"], each["level"]) == ("alpha", "containers", "warning")
    ]
    assert "no manager of the swarm answers" in found["message"]
    assert "docker context create" in found["hint"]
    fleet.apply().expect_exit(4).expect_output("no manager of the swarm answers")
    fleet.check_verdict({})
    assert list_services(fleet) == []
