# SPDX-License-Identifier: Apache-2.0
"""Every check of the doctor, passing and failing, on facts made by hand; every failure with a remedy."""

from dataclasses import replace
from typing import Any

import pytest

from edgectl.doctor.diagnosis import diagnose_fleet, diagnose_no_answer
from edgectl.doctor.ssh_command import format_ssh_command
from edgectl.model.assignment import Shortage
from edgectl.model.diagnosis import (
    NOT_A_DIRECTORY,
    Diagnosis,
    EngineFacts,
    EtcdEndpoint,
    Finding,
    HostFacts,
    ManagerFacts,
    RosFacts,
    Severity,
    ShellEnvironment,
    UnreachableHost,
)
from edgectl.model.inventory import Connection, Host
from edgectl.model.resource import CPU, MEMORY
from edgectl.model.ros import RosSettings
from edgectl.model.snapshot import CapacitySource, TaskSample, TaskState, TrafficSource
from tests.builders import a_link, a_robot, a_sample, a_snapshot, an_edge, an_inventory
from tests.doctor.facts import DISK, FACTS, GI, LINK, LOGIND, MANAGER, ros_facts

OK, WARNING, FAILED = Severity.OK, Severity.WARNING, Severity.FAILED
EDGE, ROBOT = an_edge("edge1", prelude="source /opt/ros/noetic/setup.bash"), a_robot("robot1")


def diagnose_answer(
    answer: HostFacts | UnreachableHost,
    edge: Host = EDGE,
    robot: Host = ROBOT,
    manager: ManagerFacts = MANAGER,
) -> Diagnosis:
    return diagnose_fleet(an_inventory(edge, robot), manager, {"edge1": answer})


def find_only(diagnosis: Diagnosis, check: str, host: str | None = "edge1") -> Finding:
    """Return the one finding of a check."""
    (found,) = (finding for finding in diagnosis.findings if (finding.host, finding.check) == (host, check))
    return found


def test_all_is_well() -> None:
    diagnosis = diagnose_answer(FACTS)
    assert (diagnosis.worst, diagnosis.counts) == (OK, {OK: 11, WARNING: 0, FAILED: 0})
    assert not any(finding.remedy for finding in diagnosis.findings)
    assert [finding.check for finding in diagnosis.findings if finding.host is None] == [
        "disk",
        "known_hosts",
    ]


def test_each_endpoint_of_etcd_is_judged() -> None:
    endpoints = (
        EtcdEndpoint(address="a:2379", version="3.4.23"),
        EtcdEndpoint(address="b:1", error="connection refused"),
    )
    diagnosis = diagnose_answer(FACTS, manager=replace(MANAGER, etcd=endpoints))
    good, bad = (finding for finding in diagnosis.findings if finding.check == "etcd")
    assert (good.level, good.message) == (OK, "a:2379 serves requests, version 3.4.23")
    assert (bad.level, bad.message) == (WARNING, "b:1: connection refused")
    alone = diagnose_answer(FACTS, manager=replace(MANAGER, etcd=endpoints[1:]))
    assert find_only(alone, "etcd", None).level is FAILED
    assert "systemctl status etcd" in bad.remedy


def test_names_of_one_machine_are_refused() -> None:
    answers = dict.fromkeys(("zinc", "arm", "robot1"), replace(FACTS, links={}))
    inventory = an_inventory(an_edge("zinc"), an_edge("arm"), ROBOT)
    shared = [("arm", "zinc"), ("arm", "robot1")]
    diagnosis = diagnose_fleet(inventory, MANAGER, answers, shared=shared)
    found = {each.host: each for each in diagnosis.findings if each.check == "machine"}
    assert (set(found), diagnosis.worst) == ({"zinc", "robot1"}, FAILED)
    said = "is one machine with arm: load and tasks would count twice, so no plan is made"
    assert {each.message for each in found.values()} == {said}
    assert found["zinc"].remedy == (
        "remove arm or zinc from the inventory, or declare both as slices with capacity: {cpu: .., memory: ..}"
    )


CASES: list[tuple[str, dict[str, Any], Severity, str, str]] = [
    ("login", {"login_s": 3.0}, OK, "3.00s, host key known", ""),
    ("login", {"login_s": 3.1}, WARNING, "3.10s for every command", "UseDNS no"),
    ("python", {"psutil": True}, OK, "3.8.10, psutil", ""),
    ("python", {"psutil": False}, OK, "3.8.10, no psutil: /proc is read instead, same figures", ""),
    ("clock", {"skew_s": (0.4, 0.49)}, OK, "agrees with this machine's", ""),
    ("clock", {"skew_s": (-9.0, 9.0)}, OK, "agrees with this machine's", ""),  # a slow link: no conclusion
    ("clock", {"skew_s": (0.6, 0.8)}, WARNING, "is 0.6s ahead of this machine's", "timedatectl set-ntp true"),
    ("clock", {"skew_s": (-3601.0, -3600.0)}, WARNING, "is 1h00m behind this machine's", 'ssh edge1.lab sudo date -s "@$(date +%s)"'),
    ("logind", {"logind": replace(LOGIND, present=False, lingers=False)}, OK, "no logind;", ""),
    ("logind", {"logind": LOGIND}, OK, "jetson lingers", ""),
    ("logind", {"logind": replace(LOGIND, lingers=False, removes_ipc=False)}, OK, "nothing of jetson ends with a login", ""),
    ("logind", {"logind": replace(LOGIND, lingers=False)}, WARNING, "RemoveIPC=yes", "on edge1: sudo loginctl enable-linger jetson"),
    ("logind", {"logind": replace(LOGIND, lingers=False, kills=True)}, FAILED, "starts are refused", "on edge1: sudo loginctl enable-linger jetson"),
    ("logind", {"logind": replace(LOGIND, kills=True)}, OK, "jetson lingers", ""),
    ("disk", {"disk": replace(DISK, free_bytes=500 * 2**20)}, OK, "500.0Mi of 28.0Gi free for /home/jetson", ""),
    ("disk", {"disk": replace(DISK, free_bytes=499 * 2**20)}, WARNING, "499.0Mi of 28.0Gi free", "on edge1: sudo journalctl --vacuum-size=100M"),
    ("disk", {"disk": replace(DISK, free_bytes=49 * 2**20)}, FAILED, "49.0Mi of 28.0Gi free", "sudo apt-get clean"),
    ("disk", {"disk": replace(DISK, files_left=999)}, FAILED, "only 999 more files", "sudo apt-get clean"),
    ("disk", {"disk": replace(DISK, files_left=None)}, OK, "10.0Gi of 28.0Gi free", ""),
    ("state", {"disk": replace(DISK, obstacle="it cannot be written")}, FAILED, "it cannot be written", "chmod 700 /home/jetson/.local/state/edgectl"),
    ("state", {"disk": replace(DISK, skipped=("/dev/shm/edgectl-1001",))}, WARNING, "made by another user", "on edge1: sudo rm -r /dev/shm/edgectl-1001"),
    ("state", {"disk": replace(DISK, obstacle=NOT_A_DIRECTORY)}, FAILED, "not a directory", "on edge1: mv /home/jetson/.local/state/edgectl /home"),
    ("state", {"disk": replace(DISK, obstacle="it cannot be written", in_shared_memory=True)}, WARNING, "shared memory is used instead", "on edge1: sudo mkdir"),
    ("memory", {"used_bytes": 7 * GI}, OK, "1.0Gi of 8.0Gi free", ""),
    ("memory", {"used_bytes": 7.3 * GI}, WARNING, "716.8Mi of 8.0Gi free", "--sort=-rss"),
    ("memory", {"used_bytes": 8 * GI - 63 * 2**20}, FAILED, "63.0Mi of 8.0Gi free", "--sort=-rss"),
    ("prelude", {}, OK, "runs", ""),
    ("prelude", {"surroundings": ShellEnvironment(status=1, last_line="no such file")}, WARNING, "ends with status 1: no such file", "prelude: of edge1"),
    ("prelude", {"surroundings": ShellEnvironment(status=None, last_line="bye")}, FAILED, "exits the shell: bye; no task can start", "prelude: of edge1"),
    ("prelude", {"surroundings": ShellEnvironment(status=None, timed_out=True)}, FAILED, "does not end in time", "prelude: of edge1"),
    ("containers", {"engines": {"docker": EngineFacts(version="20.10.24")}}, OK, "docker 20.10.24", ""),
    ("containers", {"engines": {"docker": EngineFacts(error="gone"), "podman": EngineFacts(version="4.3.1")}}, OK, "podman 4.3.1", ""),
    ("containers", {"engines": {}}, WARNING, "no task with an image runs here", "on edge1: sudo apt-get install docker.io"),
    ("containers", {"engines": {"docker": EngineFacts(version="20.10.24"), "swarm": EngineFacts(version="worker")}}, OK, "docker 20.10.24, swarm worker", ""),
    ("containers", {"engines": {"swarm": EngineFacts(error="the engine of this host is in no swarm")}}, WARNING, "swarm: the engine of this host is in no swarm", "docker swarm join"),
    ("containers", {"engines": {"swarm": EngineFacts(error="no manager of the swarm answers")}}, WARNING, "swarm: no manager", "docker context create lab"),
    ("containers", {"engines": {"docker": EngineFacts(error="Cannot connect")}}, WARNING, "docker: Cannot connect", "systemctl enable --now docker"),
    ("containers", {"engines": {"docker": EngineFacts(error="Got permission denied")}}, WARNING, "permission denied", "sudo usermod -aG docker jetson"),
    ("robot", {"links": {"robot1": LINK}}, OK, "robot1 answers in 1.2ms", ""),
    ("robot", {"links": {"robot1": replace(LINK, rtt_ms=None)}}, OK, "robot1 answers", ""),
    ("robot", {"links": {"robot1": replace(LINK, address="rosie", found=False, reachable=None)}}, FAILED, "a name that edge1 cannot resolve", "rosie' | sudo tee -a /etc/hosts"),
    ("robot", {"links": {"robot1": replace(LINK, reachable=False, interface=None)}}, FAILED, "no route from edge1 to robot1", "ip route get 10.0.0.21"),
    ("robot", {"links": {"robot1": replace(LINK, reachable=False)}}, FAILED, "cannot be reached from edge1", "ping -c3 10.0.0.21"),
    ("robot", {"links": {"robot1": replace(LINK, reachable=None)}}, WARNING, "to edge1", "on robot1: sudo ufw allow from edge1.lab"),
    ("capacity", {}, OK, "robot1 12.5MB/s (nic)", ""),
    ("capacity", {"links": {"robot1": replace(LINK, capacity_bytes_per_s=6.75e6, capacity_source=CapacitySource.ASSUMED)}}, WARNING,
     "of the link to robot1 is unknown, 6.8MB/s is assumed", "edgectl probe --bandwidth; or links: [{edge: edge1, robot: robot1, throughput: ..}]"),
]  # fmt: skip


@pytest.mark.parametrize(("check", "changes", "level", "says", "mend"), CASES)
def test_each_check_of_a_host(
    check: str, changes: dict[str, Any], level: Severity, says: str, mend: str
) -> None:
    diagnosis = diagnose_answer(replace(FACTS, **changes))
    found = find_only(diagnosis, check)
    assert (found.level, diagnosis.worst) == (level, level)
    assert says in found.message
    assert bool(found.remedy) == (level is not OK)
    assert mend in found.remedy


def test_a_local_host_has_no_login_and_our_clock() -> None:
    diagnosis = diagnose_answer(
        replace(FACTS, login_s=9.0, skew_s=(5.0, 6.0)), replace(EDGE, connection=Connection.LOCAL)
    )
    assert diagnosis.worst is OK
    assert "host key" not in find_only(diagnosis, "login").message


def test_a_robot_that_is_never_contacted_may_be_silent_but_must_be_on_the_way() -> None:
    blind = replace(ROBOT, probe=False)
    assert (
        find_only(
            diagnose_answer(replace(FACTS, links={"robot1": replace(LINK, reachable=None)}), robot=blind),
            "robot",
        ).level
        is OK
    )
    assert (
        find_only(
            diagnose_answer(replace(FACTS, links={"robot1": replace(LINK, reachable=False)}), robot=blind),
            "robot",
        ).level
        is FAILED
    )
    assumed = replace(LINK, capacity_source=CapacitySource.ASSUMED)
    assert (
        "--bandwidth"
        not in find_only(
            diagnose_answer(replace(FACTS, links={"robot1": assumed}), robot=blind), "capacity"
        ).remedy
    )


SILENT: list[tuple[str, str, str, str]] = [
    ("connect", "", "reachability", "switch edge1 on"),
    ("deadline", "", "reachability", "edgectl doctor edge1 --timeout 60s"),
    ("host-key", "compare the fingerprint, then: edgectl trust edge1", "host key", "edgectl trust edge1"),
    ("host-key", "", "host key", "edgectl trust edge1"),
    ("auth", "", "login", "ssh-copy-id -p 2222 -i ~/.ssh/lab jetson@edge1.lab"),
    ("no-python", "", "python", "on edge1: sudo apt-get install python3"),
    ("bad-reply", "", "agent", "ssh -p 2222 -i ~/.ssh/lab jetson@edge1.lab python3 --version"),
    ("refused", "do this", "agent", "do this"),
]


@pytest.mark.parametrize(("kind", "hint", "check", "mend"), SILENT)
def test_a_host_that_cannot_be_asked_is_one_failed_check(kind: str, hint: str, check: str, mend: str) -> None:
    edge = replace(EDGE, port=2222, user="jetson", identity_file="~/.ssh/lab")
    diagnosis = diagnose_answer(UnreachableHost(kind=kind, error="it says so", hint=hint), edge)
    found = find_only(diagnosis, check)
    assert (found.level, found.message) == (FAILED, "it says so")
    assert mend in found.remedy
    assert [finding.host for finding in diagnosis.findings] == [None, None, "edge1"]


MANAGERS: list[tuple[dict[str, Any], str, Severity, str]] = [
    ({}, "disk", OK, ""),
    ({"state": replace(DISK, obstacle="is not private to you")}, "state", FAILED, "sudo chown $(id -u)"),
    ({"state": replace(DISK, free_bytes=1.0)}, "disk", FAILED, "sudo journalctl --vacuum-size=100M"),
    ({}, "known_hosts", OK, ""),
    ({"known_hosts": {}}, "known_hosts", OK, ""),
    (
        {"known_hosts": {"/k": "Permission denied"}},
        "known_hosts",
        FAILED,
        "sudo chown $USER /k && chmod 600 /k",
    ),
    ({"known_hosts": {"/k": "Is a directory"}}, "known_hosts", FAILED, "mv /k /k.old"),
    ({}, "ssh", OK, ""),
    ({"ssh": False}, "ssh", FAILED, "sudo apt-get install openssh-client"),
]


@pytest.mark.parametrize(("changes", "check", "level", "mend"), MANAGERS)
def test_each_check_of_this_machine(changes: dict[str, Any], check: str, level: Severity, mend: str) -> None:
    edge = replace(EDGE, connection=Connection.OPENSSH)
    found = find_only(diagnose_answer(FACTS, edge, manager=replace(MANAGER, **changes)), check, None)
    assert (found.level, bool(found.remedy)) == (level, level is not OK)
    assert mend in found.remedy
    assert not found.remedy.startswith("on ")


def test_what_no_host_needs_is_not_checked() -> None:
    local = replace(EDGE, connection=Connection.LOCAL), replace(ROBOT, connection=Connection.LOCAL)
    broken = replace(MANAGER, known_hosts={"/k": "Permission denied"}, ssh=False)
    assert diagnose_answer(FACTS, *local, manager=broken).worst is OK
    assert [
        finding.check for finding in diagnose_answer(FACTS, manager=replace(broken, known_hosts={})).findings
    ][:2] == ["disk", "known_hosts"]
    assert diagnose_fleet(an_inventory(EDGE, ROBOT), MANAGER, {}).counts[OK] == 2


def compare_ros(*hosts: tuple[Host, HostFacts]) -> dict[str, tuple[Severity, str, str]]:
    """Return the ROS findings by host: level, message, remedy."""
    diagnosis = diagnose_fleet(
        an_inventory(*(host for host, _ in hosts)), MANAGER, {host.name: facts for host, facts in hosts}
    )
    return {f.host: (f.level, f.message, f.remedy) for f in diagnosis.findings if f.check == "ros" and f.host}


E1, E2, E3, R1 = an_edge("edge1"), an_edge("edge2"), an_edge("edge3"), a_robot("robot1")
MASTER = "http://10.0.0.5:11311"


def test_without_ros_nothing_is_said() -> None:
    assert compare_ros((E1, ros_facts()), (E2, ros_facts(ROS_DOMAIN_ID="")), (R1, ros_facts())) == {}


def test_equal_variables_are_shown() -> None:
    same = ros_facts(ROS_MASTER_URI=MASTER, ROS_DOMAIN_ID="")
    assert compare_ros((E1, same), (R1, same)) == dict.fromkeys(
        ("edge1", "robot1"), (OK, f"ROS_MASTER_URI={MASTER}", "")
    )


def test_the_minority_is_told_and_its_mend_is_an_edit_that_has_the_last_word() -> None:
    seven, eight = ros_facts(ROS_DOMAIN_ID="7"), ros_facts(ROS_DOMAIN_ID="8")
    said = compare_ros((E1, seven), (E2, eight), (E3, seven))
    assert said["edge1"][0] is said["edge3"][0] is OK
    assert said["edge2"] == (
        FAILED,
        "ROS_DOMAIN_ID is 8, but 7 on edge1, edge3",
        'in the inventory, for edge2: env: {ROS_DOMAIN_ID: "7"}',
    )
    with_prelude = compare_ros((E1, seven), (replace(E2, prelude="source x"), eight))["edge2"]
    assert with_prelude[2] == "in the inventory, end the prelude of edge2 with: export ROS_DOMAIN_ID=7"


def test_what_is_not_set_counts_as_the_default_of_ros() -> None:
    assert {
        each[0] for each in compare_ros((E1, ros_facts(ROS_DOMAIN_ID="0")), (E2, ros_facts())).values()
    } == {OK}
    said = compare_ros((E1, ros_facts(ROS_DOMAIN_ID="5")), (E2, ros_facts()))["edge2"]
    assert (said[0], said[1]) == (FAILED, "ROS_DOMAIN_ID is not set (0 by default), but 5 on edge1")
    assert (
        compare_ros((E1, ros_facts(ROS_MASTER_URI=MASTER)), (E2, ros_facts()))["edge2"][1]
        == f"ROS_MASTER_URI is not set, but {MASTER} on edge1"
    )
    rmw = compare_ros((E1, ros_facts(RMW_IMPLEMENTATION="rmw_cyclonedds_cpp")), (E2, ros_facts()))["edge2"]
    assert rmw[0] is WARNING
    assert {
        each[0]
        for each in compare_ros(
            (E1, ros_facts(RMW_IMPLEMENTATION="rmw_fastrtps_cpp")), (E2, ros_facts())
        ).values()
    } == {OK}


def test_a_robot_that_sets_nothing_is_not_compared_and_one_that_differs_is_a_warning() -> None:
    assert "robot1" not in compare_ros((E1, ros_facts(ROS_DOMAIN_ID="5")), (R1, ros_facts()))
    assert (
        compare_ros((E1, ros_facts(ROS_DOMAIN_ID="5")), (replace(R1, onboard=True), ros_facts()))["robot1"][0]
        is WARNING
    )
    assert (
        compare_ros(
            (E1, ros_facts(ROS_DOMAIN_ID="5")),
            (E2, ros_facts(ROS_DOMAIN_ID="5")),
            (R1, ros_facts(ROS_DOMAIN_ID="6")),
        )["robot1"][0]
        is WARNING
    )


@pytest.mark.parametrize("uri", ["http://localhost:11311", "http://127.0.0.1:11311/"])
def test_a_master_on_localhost_is_another_one_on_each_host(uri: str) -> None:
    own = ros_facts(ROS_MASTER_URI=uri)
    said = compare_ros((E1, own), (E2, own), (R1, own))
    assert {name: each[0] for name, each in said.items()} == {
        "edge1": FAILED,
        "edge2": FAILED,
        "robot1": WARNING,
    }
    assert "each host has its own master" in said["edge1"][1]
    assert (
        said["edge1"][2]
        == 'in the inventory, for edge1: env: {ROS_MASTER_URI: "http://ADDRESS-OF-THE-MASTER:11311"}'
    )


def test_a_master_on_localhost_is_right_where_there_is_one_machine() -> None:
    own = ros_facts(ROS_MASTER_URI="http://localhost:11311")
    assert compare_ros((E1, own))["edge1"][0] is OK
    local = [(replace(host, connection=Connection.LOCAL), own) for host in (E1, E2, R1)]
    assert {each[0] for each in compare_ros(*local).values()} == {OK}


def test_a_uri_that_is_none_is_compared_like_any_text() -> None:
    odd = ros_facts(ROS_MASTER_URI="http://[::1")
    assert compare_ros((E1, odd), (E2, odd))["edge1"][0] is OK


def test_a_fleet_without_a_name_is_told_with_the_line_to_add() -> None:
    inventory = replace(an_inventory(EDGE, ROBOT), fleet="lab-1a2b3c4d", is_fleet_named=False)
    (found,) = [each for each in diagnose_fleet(inventory, MANAGER, {}).findings if each.check == "fleet"]
    assert (found.level, found.remedy) == (WARNING, "add to the inventory: fleet: lab-1a2b3c4d")


@pytest.mark.parametrize("kind", ["connect", "auth", "deadline"])
def test_a_jump_host_that_fails_is_not_mended_on_the_host_behind_it(kind: str) -> None:
    host = an_edge(port=22911, proxy_jump="gate")
    found = diagnose_no_answer(host, UnreachableHost(kind=kind, error="jump host gate: name unknown"))
    assert found.remedy == "see which login fails: ssh -v -p 22911 -J gate edge1.lab true"


def test_an_unknown_name_is_mended_in_the_files() -> None:
    answer = UnreachableHost(kind="connect", error="name unknown (Name or service not known)")
    found = diagnose_no_answer(an_edge(), answer)
    assert found.remedy == "correct its host: (edge1.lab) in the inventory, or name it in your ssh_config"


def test_lines_to_paste_have_port_key_and_jump() -> None:
    host = an_edge(port=22911, user="ana", identity_file="/keys/my key", proxy_jump="gate")
    words = "-p 22911 -i '/keys/my key' -J gate ana@edge1.lab"
    assert format_ssh_command(host, "-vvv") == f"ssh -vvv {words}"
    facts = replace(FACTS, skew_s=(-3601.0, -3600.0), login_s=9.0)
    mends = [finding.remedy for finding in diagnose_answer(facts, host).findings]
    assert any(f"ssh {words} sudo date" in mend for mend in mends)
    assert any(f"ssh -vvv {words} true" in mend for mend in mends)
    refused = diagnose_answer(UnreachableHost(kind="connect", error="connection refused"), host)
    assert "sshd runs there on port 22911" in find_only(refused, "reachability").remedy


ROS2 = RosSettings(version=2, setup=("/opt/ros/setup.bash",), domain=3)
DDS_READY = RosFacts(interfaces=("wlan0",), receive_bytes=8.0 * 2**20, fragment_bytes=128.0 * 2**20)


@pytest.mark.parametrize(
    ("ros", "seen", "expected"),
    [
        (ROS2, DDS_READY, []),
        (RosSettings(version=1), RosFacts(interfaces=("eth0", "wlan0"), addresses={"r1": "10.0.0.1", "r2": "10.0.0.1"}), []),
        (RosSettings(version=1), RosFacts(addresses={"r1": "10.0.0.1", "r2": "10.9.0.1"}),
         [(WARNING, "has several addresses on its ways to the robots (10.0.0.1 to r1, 10.9.0.1 to r2)")]),
        (ROS2, replace(DDS_READY, missing_files=("/opt/ros/setup.bash",)), [(FAILED, "set-up file /opt/ros/setup.bash cannot be read")]),
        (ROS2, replace(DDS_READY, missing_packages=("slam",)), [(FAILED, "package slam, which a task runs, is not found")]),
        (ROS2, replace(DDS_READY, interfaces=("eth0", "wlan0")), [(WARNING, "DDS announces 2 interfaces: eth0, wlan0")]),
        (ROS2, replace(DDS_READY, no_multicast=("eth0",)), [(FAILED, "eth0, the way to the robots, has no multicast")]),
        (replace(ROS2, discovery_server="a:1"), replace(DDS_READY, no_multicast=("eth0",)), []),
        (ROS2, replace(DDS_READY, no_multicast=("tun0",)), []),
        (ROS2, replace(DDS_READY, receive_bytes=212992.0), [(WARNING, "net.core.rmem_max is 208.0Ki: large messages are lost")]),
    ],
)  # fmt: skip
def test_what_a_host_lacks_of_its_ros(
    ros: RosSettings, seen: RosFacts, expected: list[tuple[Severity, str]]
) -> None:
    edge = replace(E1, ros=ros)
    found = diagnose_fleet(an_inventory(edge, R1), MANAGER, {"edge1": replace(FACTS, ros=seen)}).findings
    said = [(each.level, each.message) for each in found if each.check == "ros"]
    assert [level for level, _ in said] == [level for level, _ in expected]
    for (_, message), (_, begin) in zip(said, expected, strict=True):
        assert message.startswith(begin)


def test_what_the_edges_lack_is_a_warning_for_each_resource() -> None:
    fleet = an_inventory(EDGE, ROBOT)
    short = (Shortage(resource=CPU, amount=1.3), Shortage(resource=MEMORY, amount=GI))
    found = [f for f in diagnose_fleet(fleet, MANAGER, {"edge1": FACTS}, short).findings if f.check == "room"]
    assert [(f.host, f.level, f.message) for f in found] == [
        (None, WARNING, "the edges are short of 1.30 cores of cpu: the least that would help"),
        (None, WARNING, "the edges are short of 1.0Gi of memory: the least that would help"),
    ]
    assert all("edgectl plan -o wide" in f.remedy for f in found)
    enough = find_only(diagnose_fleet(fleet, MANAGER, {"edge1": FACTS}, ()), "room", None)
    assert (enough.level, enough.remedy) == (OK, "")
    assert not [f for f in diagnose_fleet(fleet, MANAGER, {"edge1": FACTS}).findings if f.check == "room"]


@pytest.mark.parametrize(
    ("state", "source", "expected"),
    [
        ("installed", TrafficSource.COUNTERS, (OK, "byte counters of robot1", "")),
        (
            "installed",
            TrafficSource.TCP,
            (WARNING, "no byte counter for the present address of robot1", "edgectl counters install edge1"),
        ),
        (
            "sudo: no",
            TrafficSource.TCP,
            (WARNING, "its byte counters cannot be read: sudo: no", "edgectl counters install edge1"),
        ),
    ],
)
def test_byte_counters_are_judged(
    state: str, source: TrafficSource, expected: tuple[Severity, str, str]
) -> None:
    links = {"robot1": replace(a_link(), used_source=source)}
    snapshot = a_snapshot(edge1=replace(a_sample(links=links), counters=state))
    fleet = an_inventory(EDGE, ROBOT)
    found = find_only(diagnose_fleet(fleet, MANAGER, {"edge1": FACTS}, (), snapshot), "traffic")
    assert (found.level, found.message, found.remedy) == expected


def test_traffic_that_is_partly_seen_is_a_warning_with_its_tasks() -> None:
    unseen = replace(a_link(), partial="udp unseen")
    slam = TaskSample(state=TaskState.READY, partial="udp unseen")
    snapshot = a_snapshot(edge1=a_sample(links={"robot1": unseen, "robot2": a_link()}, tasks={"slam": slam}))
    fleet = an_inventory(EDGE, ROBOT)
    found = find_only(diagnose_fleet(fleet, MANAGER, {"edge1": FACTS}, (), snapshot), "traffic")
    assert (found.level, found.message) == (
        WARNING,
        "partial: udp unseen of slam to robot1; the declared demand stands",
    )
    assert found.remedy.startswith("edgectl counters install edge1; ")
    whole = diagnose_fleet(fleet, MANAGER, {"edge1": FACTS}, (), a_snapshot(edge1=a_sample()))
    assert not [each for each in whole.findings if each.check == "traffic"]
