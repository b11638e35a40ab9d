# SPDX-License-Identifier: Apache-2.0
"""The doctor over real sshd: each problem is found with a remedy, and the remedy works."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.errors import UsageError
from edgectl.model.diagnosis import Diagnosis, Disk, Finding, Severity
from edgectl.model.inventory import Capacity, Connection, Host, Inventory, Role
from edgectl.model.policy import Policy
from edgectl.model.resource import CPU, MEMORY
from edgectl.model.task import Tasks
from edgectl.state.heartbeats import load_heartbeats
from edgectl.state.state_dir_check import inspect_state_dir
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.usecases.doctor import run_doctor
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from tests.agent.conftest import shared_memory
from tests.builders import GI, a_robot, a_task, an_inventory, some_tasks
from tests.pace import patience
from tests.sshd import Lab

# No traffic ever leaves: our own kernel has no route.
NOWHERE = "255.255.255.255"
LINKS = {(edge, "robot1"): 10e6 for edge in ("edge1", "edge2")}
# Slow machines log in slowly; free disk space and memory are the machine's, of which every host here is one.
OWN = {
    ("login", Severity.WARNING),
    ("machine", Severity.FAILED),
    *((check, level) for check in ("disk", "memory", "logind", "clock") for level in Severity),
}


@pytest.fixture
def inventory(lab: Lab) -> Iterator[Inventory]:
    yield an_inventory(
        lab.host("edge1"),
        lab.host("edge2"),
        lab.host("robot1", role=Role.ROBOT, host=lab["robot1"].address, port=lab["robot1"].port),
        links=LINKS,
    )
    lab.restart_stopped_servers()


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Disk:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    return inspect_state_dir("lab", tmp_path / "lab.yaml")


def diagnose_named(inventory: Inventory, state: Disk, *names: str, tasks: Tasks | None = None) -> Diagnosis:
    return run_doctor(open_fleet(inventory, state, tasks), state, names, timeout=patience(30.0))


def list_complaints(diagnosis: Diagnosis) -> list[Finding]:
    """Return the findings that do not depend on the machine of the tests."""
    return [
        finding
        for finding in diagnosis.findings
        if finding.level is not Severity.OK and (finding.check, finding.level) not in OWN
    ]


def replace_hosts(inventory: Inventory, *hosts: Host) -> Inventory:
    return replace(inventory, hosts={**inventory.hosts, **{host.name: host for host in hosts}})


@pytest.mark.parametrize("connection", [Connection.SSH, Connection.OPENSSH])
def test_a_fleet_on_which_all_is_well(
    lab: Lab, inventory: Inventory, state: Disk, connection: Connection
) -> None:
    hosts = (replace(host, connection=connection) for host in inventory.hosts.values())
    diagnosis = diagnose_named(replace_hosts(inventory, *hosts), state)
    assert list_complaints(diagnosis) == []
    said = {(finding.host, finding.check): finding.message for finding in diagnosis.findings}
    assert said[None, "known_hosts"] == f"{lab.known_hosts} can be read"
    assert (
        said["edge1", "login"].endswith("s, host key known") or "every command pays" in said["edge1", "login"]
    )
    assert said["edge1", "robot"].startswith("robot1 answers")
    assert said["edge1", "disk"].endswith(f"free for {lab['edge1'].home}/state/edgectl")
    assert said["edge1", "capacity"] == "robot1 10.0MB/s (declared)"
    assert ("robot1", "robot") not in said
    assert [finding.host for finding in diagnosis.findings] == sorted(
        (f.host for f in diagnosis.findings), key=lambda name: name or ""
    )
    assert load_heartbeats(Path(state.path)).last


def test_what_the_edges_that_answer_lack_for_the_tasks_of_the_files(
    lab: Lab, inventory: Inventory, state: Disk
) -> None:
    """Of two edges of 2 GiB one is silent, so a task of 5 GiB lacks 3."""
    lab["edge2"].stop()
    diagnosis = diagnose_named(slices(inventory), state, tasks=some_tasks(a_task("huge", memory=5 * GI)))
    (found,) = (finding for finding in diagnosis.findings if finding.check == "room")
    assert (found.host, found.level) == (None, Severity.WARNING)
    assert found.message == "the edges are short of 3.0Gi of memory: the least that would help"


def test_names_of_one_machine_which_no_plan_takes(inventory: Inventory, state: Disk) -> None:
    """The three sshd of the lab run on this machine. Slices of it are told apart by what they declare."""
    whole = diagnose_named(inventory, state)
    found = {finding.host: finding for finding in whole.findings if finding.check == "machine"}
    assert (set(found), whole.worst) == ({"edge2", "robot1"}, Severity.FAILED)
    assert {each.message.partition(":")[0] for each in found.values()} == {"is one machine with edge1"}
    with pytest.raises(UsageError, match="edge1 and edge2 are one machine"):
        make_plan(open_fleet(inventory, state), Policy())
    told_apart = diagnose_named(slices(inventory), state)
    assert [finding for finding in told_apart.findings if finding.check == "machine"] == []
    assert not [
        each for each in diagnose_named(inventory, state, "edge2").findings if each.check == "machine"
    ]


def open_fleet(inventory: Inventory, state: Disk, tasks: Tasks | None = None) -> Fleet:
    return Fleet(
        inventory=inventory, tasks=tasks or some_tasks(), transport=FleetTransport(), state=Path(state.path)
    )


def slices(inventory: Inventory) -> Inventory:
    """``inventory`` with edges of 2 GiB each, whatever this machine has."""
    capacity = Capacity({CPU.name: 4.0, MEMORY.name: 2 * GI})
    return replace_hosts(inventory, *(replace(edge, capacity=capacity) for edge in inventory.edges))


def test_one_host_alone_can_be_asked(inventory: Inventory, state: Disk) -> None:
    found = diagnose_named(inventory, state, "edge2", tasks=some_tasks(a_task())).findings
    assert {finding.host for finding in found} == {None, "edge2"}
    assert "room" not in {finding.check for finding in found}


def test_hosts_that_cannot_be_asked_cost_no_other_host_its_answer(
    lab: Lab, inventory: Inventory, state: Disk, tmp_path: Path
) -> None:
    lab.known_hosts.write_text(
        "".join(server.known_hosts_line for server in lab.servers.values() if server.name != "edge1")
    )
    lab["robot1"].stop()
    diagnosis = diagnose_named(inventory, state)
    found = {
        finding.host: finding for finding in list_complaints(diagnosis) if finding.level is Severity.FAILED
    }
    assert (found["edge1"].check, "edgectl trust edge1" in found["edge1"].remedy) == ("host key", True)
    assert (found["robot1"].check, "switch robot1 on" in found["robot1"].remedy) == ("reachability", True)
    assert set(found) == {"edge1", "robot1"}
    assert {finding.check for finding in diagnosis.findings if finding.host == "edge2"} >= {
        "login",
        "python",
        "robot",
        "prelude",
    }


def test_a_host_without_python(lab: Lab, inventory: Inventory, state: Disk) -> None:
    server = lab["edge1"]
    lab.configure(server, [f'SetEnv "PATH=/nonexistent" "HOME={server.home}"'])
    server.restart()
    try:
        (found,) = list_complaints(diagnose_named(inventory, state, "edge1"))
        assert (found.check, found.level) == ("python", Severity.FAILED)
        assert found.remedy == "on edge1: sudo apt-get install python3   (3.6 or later)"
    finally:
        lab.configure(server)
        server.restart()


def test_ros_variables_that_differ_and_their_mend(inventory: Inventory, state: Disk) -> None:
    """Writing what the finding suggests removes it: in env where there is no prelude, else at its end."""
    edge1 = replace(inventory.hosts["edge1"], env={"ROS_DOMAIN_ID": "7"})
    edge2 = replace(inventory.hosts["edge2"], env={"ROS_DOMAIN_ID": "7"}, prelude="export ROS_DOMAIN_ID=9")
    (found,) = list_complaints(diagnose_named(replace_hosts(inventory, edge1, edge2), state))
    assert (found.host, found.check, found.level) == ("edge2", "ros", Severity.FAILED)
    assert found.message == "ROS_DOMAIN_ID is 9, but 7 on edge1"
    assert found.remedy == "in the inventory, end the prelude of edge2 with: export ROS_DOMAIN_ID=7"
    mended = replace(edge2, prelude=f"{edge2.prelude}\n{found.remedy.partition('with: ')[2]}")
    assert list_complaints(diagnose_named(replace_hosts(inventory, edge1, mended), state)) == []


def test_a_state_directory_of_a_host_that_others_may_write_to(
    lab: Lab, inventory: Inventory, state: Disk
) -> None:
    """The agent of such a host uses shared memory instead, and reports it; the remedy works."""
    folder = lab["edge1"].home / "state" / "edgectl"
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o777)
    with shared_memory():
        try:
            (found,) = list_complaints(diagnose_named(inventory, state, "edge1"))
            assert (found.check, found.level) == ("state", Severity.WARNING)
            assert found.remedy.endswith(f" && chmod 700 {folder}")
            folder.chmod(0o700)
            assert list_complaints(diagnose_named(inventory, state, "edge1")) == []
        finally:
            folder.chmod(0o700)


def test_a_prelude_that_fails(inventory: Inventory, state: Disk) -> None:
    broken = replace(inventory.hosts["edge1"], prelude="source /opt/ros/none/setup.bash")
    (found,) = list_complaints(diagnose_named(replace_hosts(inventory, broken), state, "edge1"))
    assert (found.check, found.level) == ("prelude", Severity.WARNING)
    assert "ends with status 1" in found.message
    assert "/opt/ros/none/setup.bash" in found.message


def test_a_robot_that_the_manager_reaches_and_an_edge_does_not(inventory: Inventory, state: Disk) -> None:
    """The connection test from the edge counts: a robot whose address leads nowhere from there, and one
    without a known link.
    """
    far = a_robot("robot1", host=NOWHERE, probe=False)
    found = list_complaints(diagnose_named(replace(replace_hosts(inventory, far), links={}), state, "edge1"))
    assert [(each.check, each.level) for each in found] == [
        ("robot", Severity.FAILED),
        ("capacity", Severity.WARNING),
    ]
    assert f"({NOWHERE})" in found[0].message
    assert "links: [{edge: edge1, robot: robot1, throughput: ..}]" in found[1].remedy


def test_a_known_hosts_file_that_cannot_be_read_is_named(lab: Lab, inventory: Inventory, state: Disk) -> None:
    lab.known_hosts.unlink()
    lab.known_hosts.mkdir()
    try:
        found = next(
            each for each in list_complaints(diagnose_named(inventory, state, "edge1")) if each.host is None
        )
    finally:
        lab.known_hosts.rmdir()
    assert (found.check, found.message) == (
        "known_hosts",
        f"{lab.known_hosts} cannot be read: Is a directory",
    )


def test_a_state_directory_that_is_not_private(
    inventory: Inventory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hosts are examined all the same, unless a task depends on heartbeats that could not be recorded; the
    remedy works.
    """
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    good = inspect_state_dir("lab", tmp_path / "lab.yaml")
    Path(good.path).chmod(0o777)
    bad = inspect_state_dir("lab", tmp_path / "lab.yaml")
    (found,) = list_complaints(diagnose_named(inventory, bad, "edge1"))
    assert (found.host, found.check, found.level) == (None, "state", Severity.FAILED)
    assert f"chmod 700 {good.path}" in found.remedy
    fencing = some_tasks(a_task("slam", self_fence=30.0))
    assert {
        (each.host, each.check)
        for each in list_complaints(diagnose_named(inventory, bad, "edge1", tasks=fencing))
    } == {
        (None, "state"),
        ("edge1", "agent"),
    }
    Path(good.path).chmod(0o700)
    assert inspect_state_dir("lab", tmp_path / "lab.yaml").obstacle == ""


def test_something_else_stands_in_the_place_of_the_state_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "file"))
    bad = inspect_state_dir("lab", tmp_path / "lab.yaml")
    assert (bad.path, "not a directory" in bad.obstacle) == (str(tmp_path / "file"), True)
    (tmp_path / "file").rename(tmp_path / "file.old")
    assert inspect_state_dir("lab", tmp_path / "lab.yaml").obstacle == ""


def test_the_command(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from edgectl.cli.main import main

    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    (tmp_path / "lab.yaml").write_text(
        "version: 1\nedges:\n  edge1: {host: edge1, env: {ROS_DOMAIN_ID: '7'}}\n  edge2: {host: edge2}\n"
    )
    (tmp_path / "tasks.yaml").write_text(
        "version: 1\ntasks:\n  idle: {command: sleep 1, demand: {cpu: 0.1, memory: 1Mi}}\n"
    )
    files = ("-i", str(tmp_path / "lab.yaml"), "-t", str(tmp_path / "tasks.yaml"))
    assert main(["doctor", *files]) == 1
    out, err = capfd.readouterr()
    assert err == ""
    assert out.startswith("this machine\nok    disk ")
    assert "\nedge2\nFAIL  machine       is one machine with edge1: load and tasks would count twice" in out
    assert "fix: remove edge1 or edge2 from the inventory, or declare both as slices with capacity: {" in out
    assert "FAIL  ros           ROS_DOMAIN_ID is not set (0 by default), but 7 on edge1\n" in out
    assert '                    fix: in the inventory, for edge2: env: {ROS_DOMAIN_ID: "7"}\n' in out
    assert main(["doctor", "edge1", "-o", "json", *files]) == 0
    document = json.loads(capfd.readouterr().out)
    assert not [finding for finding in document["items"] if finding["level"] == "failed"]
    assert {finding["host"] for finding in document["items"]} == {None, "edge1"}
    assert main(["doctor", "edge9", *files]) == 64
    assert "edge9" in capfd.readouterr().err
