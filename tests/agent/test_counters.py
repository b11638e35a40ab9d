# SPDX-License-Identifier: Apache-2.0
"""Byte counters of nftables: rules, readings and rights, on two computers in network namespaces with a cable."""

import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from edgectl.agent.measure import counters, counters_rules
from edgectl.errors import RefusedError
from edgectl.model.inventory import Host
from edgectl.transport.base import Session, Transport
from edgectl.usecases.byte_counters import ask_counters, build_script
from edgectl.usecases.fleet import Fleet
from tests import network_hosts
from tests.agent.conftest import AgentHost, eventually
from tests.agent.user_systemd import can_be_real, user_systemd
from tests.builders import a_robot, an_edge, an_inventory, some_tasks
from tests.network_hosts import NetworkHost, pair_of_hosts

pytestmark = pytest.mark.usefixtures("_quiet")
real_only = pytest.mark.skipif(
    bool(network_hosts.find_missing_for_counters()), reason=network_hosts.find_missing_for_counters() or "-"
)
# As nft 1.0.6 prints them; the last group has ended.
LISTED = """table inet edgectl_my-lab.1 {
	counter tcp_in_10.0.0.5 {
		packets 12 bytes 3400
	}

	counter other_out_fd00--5 {
		packets 7 bytes 9100
	}

	set tasks_out4 {
		type ipv4_addr . inet_proto . cgroupsv2
		size 65536
		flags dynamic,timeout
		counter
		timeout 1h
		elements = { 10.0.0.5 . udp . "unified/user.slice/a/b/edgectl-edge1-slam-1a2b.scope" counter packets 3 bytes 4000 expires 59m59s960ms,
				10.0.0.5 . 6 . "user.slice" counter packets 1 bytes 52 expires 1m, 10.0.0.5 . udp . 4711 counter packets 2 bytes 60 expires 3s }
	}

	chain from_robots {
		type filter hook prerouting priority -450; policy accept;
		meta l4proto tcp counter name ip saddr map { 10.0.0.5 : "tcp_in_10.0.0.5" }
	}
}
"""
SCOPE = "user.slice/a/b/edgectl-edge1-slam-1a2b.scope"
_SEND = """
import socket, sys, time
peer, size, rate = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 22)
began = time.monotonic()
for number in range(1 << 30):
    time.sleep(max(0.0, began + number / rate - time.monotonic()))
    try:
        s.sendto(bytes(size), (peer, 20001))
    except ConnectionRefusedError:
        pass
"""


@pytest.fixture
def _quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs of the system directories are found, as on a host."""
    monkeypatch.setenv("PATH", f"{os.environ['PATH']}:/usr/sbin:/sbin")


def test_the_listing_of_a_table_is_parsed() -> None:
    assert counters.parse_table(LISTED) == {
        ("tcp_in", "10.0.0.5"): (12, 3400),
        ("other_out", "fd00::5"): (7, 9100),
        ("tasks_out4", "10.0.0.5", "udp", SCOPE): (3, 4000),
        ("tasks_out4", "10.0.0.5", "6", "user.slice"): (1, 52),
        ("tasks_out4", "10.0.0.5", "udp", "4711"): (2, 60),
    }
    assert counters.Reading(0.0, LISTED).tasks
    assert not counters.Reading(0.0, LISTED.replace("tasks_out4", "x")).tasks
    assert counters.parse_table("") == counters.parse_table("Error: No such file or directory\n") == {}


def test_rates_are_of_the_window_and_begin_again_where_counters_did() -> None:
    before = counters.Reading(10.0, LISTED)
    after = counters.Reading(12.0, LISTED.replace("packets 12 bytes 3400", "packets 14 bytes 5400"))
    rates = counters.compute_rates(before, after, {"10.0.0.5": (1500, 14)})
    assert rates.robots["10.0.0.5"] == {"rx": (2000 + 2 * 14) / 2, "tx": 0.0, "other": 0.0}
    assert (rates.covers(["10.0.0.5"]), rates.covers(["10.0.0.6"]), rates.covers([])) == (True, False, False)
    assert rates.get_group(SCOPE) == {"10.0.0.5": {"rx": 0.0, "tx": 0.0}}
    assert (rates.get_group("other.scope"), rates.get_group("")) == ({}, None)
    again = counters.Reading(12.0, LISTED.replace("packets 12 bytes 3400", "packets 2 bytes 100"))
    assert counters.compute_rates(before, again, {}).robots["10.0.0.5"]["rx"] == (100 + 2 * 14) / 2


@pytest.mark.parametrize(
    ("packets", "count", "tcp", "expected"),
    [
        (10, 1000, False, 1000 + 10 * 14),
        # One datagram of 60,000 bytes in 41 fragments of at most 1,480; 40 more headers of 20 bytes.
        (1, 60028, False, 60028 + 40 * 20 + 41 * 14),
        # One TCP packet of 65,160 bytes in 44 segments, as many network cards cut it.
        (1, 65160 + 52, True, 65212 + 43 * 52 + 44 * 14),
    ],
)
def test_packets_that_are_cut_on_their_way_count_with_the_headers_of_their_frames(
    packets: int, count: int, tcp: bool, expected: int
) -> None:
    assert counters.estimate_wire_bytes(packets, count, (1500, 14), "10.0.0.5", tcp=tcp) == expected


def test_rules_only_count_and_names_need_no_quotes() -> None:
    found = {"robot1": ["10.0.0.5"], "robot2": ["fd00::5"], "robot3": []}
    rules = counters_rules.build_rules("my-lab.1", found, tasks=True)
    assert not re.search(r"\b(drop|reject|accept(?!;)|queue|jump|goto|dnat|snat|masquerade|mark)\b", rules)
    assert rules.count("policy accept;") == rules.count("type filter hook") == 4
    assert rules.startswith("table inet edgectl_my-lab.1 { }\ndelete table inet edgectl_my-lab.1\n")
    assert "'" not in counters_rules.build_install_script("my-lab.1", found, "/usr/sbin/nft", 1000)


class Site:
    """An edge whose agent is of a user without rights, and a robot."""

    def __init__(self, edge: NetworkHost, robot: NetworkHost, agent: AgentHost) -> None:
        self.edge, self.robot, self.agent = edge, robot, agent
        self.links = [{"robot": "robot1", "address": robot.address}]

    def counters(self, action: str) -> dict[str, Any]:
        return self.agent.ask("counters", action=action, links=self.links)

    def install(self) -> dict[str, Any]:
        """As an operator does who has to type a password for sudo."""
        facts = self.counters("facts")
        script = counters_rules.build_install_script("lab", facts["addresses"], facts["nft"], facts["uid"])
        self.edge.run("sh", "-c", script)
        return self.counters("show")

    def remove(self) -> None:
        script = counters_rules.build_remove_script("lab", "/usr/sbin/nft", network_hosts.USER_ID)
        self.edge.run("sh", "-c", script)

    def probe(self, window_s: float = 2.0) -> dict[str, Any]:
        return self.agent.ask("probe", window_s=window_s, links=self.links)

    @contextlib.contextmanager
    def sending(self, size: int, rate: float) -> Iterator[None]:
        words = [sys.executable, "-I", "-S", "-c", _SEND, self.robot.address, str(size), str(rate)]
        with subprocess.Popen(self.edge.enter(*words)) as process:
            yield
            process.kill()


@pytest.fixture
def tmp_path() -> Iterator[Path]:
    """Outside /dev/shm, where the directory of pytest may be: the computers have one of their own there."""
    with tempfile.TemporaryDirectory(prefix="edgectl-counters-", dir="/var/tmp") as folder:
        yield Path(folder)


@pytest.fixture
def site(monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    # Not below the directory of pytest, which other users may not enter.
    folder = Path(tempfile.mkdtemp(prefix="edgectl-counters-"))
    folder.chmod(0o755)
    state = folder / "state"
    state.mkdir(mode=0o700)
    os.chown(state, network_hosts.USER_ID, network_hosts.USER_ID)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(state))
    try:
        with pair_of_hosts(folder / "net") as (edge, robot):
            agent = AgentHost("edge1", state, edge.write_python(user=True))
            yield Site(edge, robot, agent)
            agent.ask("profiler-stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@real_only
def test_an_installation_serves_a_user_without_rights_and_is_removed_without_a_trace(site: Site) -> None:
    assert site.counters("show")["state"] == ""
    with pytest.raises(RefusedError, match="sudo asks for a password"):
        site.counters("install")
    assert site.probe(0.05)["counters"] == ""
    site.edge.run("nft", "add table inet another { chain c { } ; }")
    for _ in range(2):
        assert site.install()["state"] == "installed"
    assert site.probe(0.05)["counters"] == "installed"
    assert oct((Path(f"/proc/{site.edge.pid}/root/etc/sudoers.d") / "edgectl-lab-4711").stat().st_mode) == (
        "0o100440"
    )
    allowed = " ".join(site.edge.run("sudo", "-l", "-U", "edge").split()).partition("NOPASSWD: ")[2]
    assert (
        allowed == "/usr/sbin/nft list table inet edgectl_lab, /usr/sbin/nft -f /etc/edgectl/counters_lab.nft"
    )
    for refused in (["list", "ruleset"], ["flush", "table", "inet", "edgectl_lab"], ["-f", "-"]):
        words = ["sudo", "-n", "/usr/sbin/nft", *refused]
        assert subprocess.run(site.edge.enter(*words, user=True), capture_output=True, check=False).returncode
    site.remove()
    assert site.counters("show")["state"] == ""
    assert site.edge.run("nft", "list", "tables") == "table inet another\n"
    assert "edgectl" not in site.edge.run("ls", "/etc", "/etc/sudoers.d")
    site.remove()


@real_only
@pytest.mark.parametrize(("size", "rate"), [(100, 200.0), (60_000, 20.0)])
def test_datagrams_count_as_on_the_interface(site: Site, size: int, rate: float) -> None:
    site.install()
    with site.sending(size, rate):
        time.sleep(0.3)
        began, before = time.monotonic(), site.edge.read_interface()
        link = site.probe()["links"]["robot1"]
        seconds, after = time.monotonic() - began, site.edge.read_interface()
    assert (link["source"], link["partial"]) == ("counters", "")
    wire = (after[1] - before[1]) / seconds
    # The two windows are not the same one: the sender's pace and start-up of the agent lie between.
    assert link["tx_bytes_per_s"] == pytest.approx(wire, rel=0.2)
    assert link["other_bytes_per_s"] >= link["tx_bytes_per_s"]


@real_only
def test_totals_are_those_of_the_interface(site: Site) -> None:
    """Whole runs instead of windows: nothing but the traffic itself is compared."""
    site.install()
    before = site.edge.read_interface()[1]
    words = "import socket; s = socket.socket(type=socket.SOCK_DGRAM)\nfor _ in range(200): s.sendto(bytes(40000), ('%s', 9))"
    site.edge.run(sys.executable, "-I", "-S", "-c", words % site.robot.address)
    sent = site.edge.read_interface()[1] - before
    counts = counters.parse_table(site.edge.run("nft", "list", "table", "inet", "edgectl_lab"))
    packets, count = counts[("other_out", site.robot.address)]
    wire = counters.estimate_wire_bytes(packets, count, (1500, 14), site.robot.address, tcp=False)
    assert wire == pytest.approx(sent, rel=0.005)
    assert wire > 1.02 * count, "40 kB are cut into 28 frames, whose headers the counters do not see"


_SINK = "import socket; p, _ = socket.create_server(('%s', 20002)).accept()\nwhile p.recv(1 << 20): pass"
_STREAM = """
import socket, time
for _ in range(1000):
    try:
        s = socket.create_connection(('%s', 20002))
        break
    except OSError:
        time.sleep(0.05)
s.sendall(bytes(10_000_000))
"""


@real_only
def test_a_stream_that_is_cut_into_segments_after_it_was_counted_has_their_headers(site: Site) -> None:
    shape = "qdisc replace dev eth0 root tbf rate 80mbit burst 5kb latency 400ms"
    site.edge.run("tc", *shape.split())
    site.install()
    before = site.edge.read_interface()[1]
    python = [sys.executable, "-I", "-S", "-c"]
    with subprocess.Popen(site.robot.enter(*python, _SINK % site.robot.address)):
        site.edge.run(*python, _STREAM % site.robot.address)
    sent = site.edge.read_interface()[1] - before
    counts = counters.parse_table(site.edge.run("nft", "list", "table", "inet", "edgectl_lab"))
    packets, count = counts[("tcp_out", site.robot.address)]
    wire = counters.estimate_wire_bytes(packets, count, (1500, 14), site.robot.address, tcp=True)
    assert wire == pytest.approx(sent, rel=0.01)
    assert wire > 1.02 * count, f"{packets} packets of {count} bytes were not cut"


@real_only
def test_rules_that_the_kernel_lost_are_loaded_again_and_a_new_address_is_not_counted(site: Site) -> None:
    site.install()
    site.edge.run("nft", "flush", "ruleset")
    assert site.probe(0.05)["counters"] == "installed"
    site.links[0]["address"] = "10.233.0.3"
    link = site.probe(0.05)["links"]["robot1"]
    assert link["source"] == "tcp"
    assert not site.counters("show")["robots"]["robot1"]["counted"]
    site.edge.run("rm", "/etc/sudoers.d/edgectl-lab-4711")
    assert site.probe(0.05)["counters"].startswith("sudo: a password is required")


@real_only
def test_a_profiler_reads_counters_and_keeps_its_cost(site: Site) -> None:
    site.install()
    site.agent.ask("profiler-start", every_s=0.2, ttl_s=600.0, links=site.links, peers=[], detect=[])
    with site.sending(1000, 100.0):

        def read() -> dict[str, Any] | None:
            found = site.probe(0.05)
            link: dict[str, Any] = found["links"]["robot1"]
            return link if found.get("resident") and link["tx_bytes_per_s"] > 50_000 else None

        link = eventually(read, seconds=60.0)
    assert (link["source"], link["partial"]) == ("counters", "")
    assert link["other_bytes_per_s"] > 50_000


_INVENTORY = """
version: 1
fleet: lab
edges: {edge1: {host: localhost, connection: local}}
robots: {robot1: {host: 10.233.0.2, probe: false}}
"""
_TASKS = "version: 1\ntasks: {slam: {command: sleep 600, robots: [robot1]}}"


@real_only
def test_the_commands_install_show_and_remove_on_a_login_of_root(site: Site, tmp_path: Path) -> None:
    (tmp_path / "inventory.yaml").write_text(_INVENTORY)
    (tmp_path / "tasks.yaml").write_text(_TASKS)

    def run(*words: str, codes: tuple[int, ...] = (0,)) -> str:
        files = ["-i", str(tmp_path / "inventory.yaml"), "-t", str(tmp_path / "tasks.yaml")]
        env = [f"EDGECTL_STATE_DIR={tmp_path / 'manager'}", "COLUMNS=200"]
        command = site.edge.enter("env", *env, sys.executable, "-m", "edgectl", *words, *files)
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode in codes, done.stderr
        return done.stdout

    assert run("counters", "install", "edge1", "-o", "name") == "edge/edge1\n"
    site.edge.run("bash", "-c", f"echo hello > /dev/udp/{site.robot.address}/9")
    item = json.loads(run("counters", "show", "-o", "json"))["items"][0]
    assert (item["counters"], item["tasks_counted"]) == ("installed", True)
    assert item["robot_counters"]["robot1"]["tx_bytes"] == 20 + 8 + 6
    assert "by counters" in run("probe", "-o", "wide", "--window", "50ms")
    doctor = json.loads(run("doctor", "-o", "json", codes=(0, 1)))["items"]
    assert [each["message"] for each in doctor if each["check"] == "traffic"] == ["byte counters of robot1"]
    assert run("counters", "install", "edge1", "--script").startswith("set -eu\n")
    run("counters", "remove")
    assert site.edge.run("nft", "list", "ruleset") == ""
    assert json.loads(run("counters", "show", "-o", "json"))["items"] == [{"host": "edge1"}]


class _OneSession:
    """A transport to the one session of a test."""

    def __init__(self, agent: AgentHost) -> None:
        self.agent = agent

    def connect(self, _host: Host, *, timeout: float) -> Session:
        del timeout
        return self.agent.session

    def address(self, host: Host) -> str:
        return host.host


@real_only
def test_where_sudo_wants_a_password_the_hint_is_a_command_that_asks_for_it(
    site: Site, tmp_path: Path
) -> None:
    inventory = an_inventory(an_edge("edge1", user="ana"), a_robot("robot1", host=site.robot.address))
    transport = cast("Transport", _OneSession(site.agent))
    fleet = Fleet(inventory=inventory, tasks=some_tasks(), transport=transport, state=tmp_path)
    (found,) = ask_counters(fleet, (), "install")
    assert (found.error, found.hint) == (
        "sudo asks for a password",
        f"ssh -t ana@{inventory.hosts['edge1'].host} \"sudo sh -c '$(edgectl counters install edge1 --script)'\"",
    )
    assert build_script(fleet, "edge1", "install").count(site.robot.address) > 4
    assert "rm -f /etc/edgectl/counters_" in build_script(fleet, "edge1", "remove")


@real_only
@pytest.mark.skipif(not can_be_real(), reason="needs systemd and control groups that can be written")
def test_a_task_in_a_scope_is_counted_by_its_control_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    with (
        user_systemd(tmp_path / "systemd", real=True) as systemd,
        pair_of_hosts(tmp_path / "net", mounts_of=systemd.pid) as (edge, robot),
    ):
        agent = AgentHost("edge1", tmp_path / "state", edge.write_python())
        site = Site(edge, robot, agent)
        site.counters("install")
        assert site.counters("show")["tasks"]
        script = tmp_path / "send.py"
        script.write_text(_SEND)
        for name, runtime, rate in (("camera", "systemd", 200), ("slam", "process", 50)):
            words = f"exec {sys.executable} -I -S {script} {robot.address} 1000 {rate}"
            agent.start(name, words, runtime=runtime)

        def read() -> dict[str, Any] | None:
            found = site.probe(3.0)
            camera = found["tasks"]["camera"]["links"].get("robot1", 0.0)
            total = found["links"]["robot1"]["tx_bytes_per_s"]
            return found if camera > 100_000 and total > camera * 1.1 else None

        found = eventually(read, seconds=60.0)
        camera, slam = found["tasks"]["camera"], found["tasks"]["slam"]
        print(
            json.dumps({"link": found["links"]["robot1"], "camera": camera["links"], "slam": slam["links"]})
        )
        assert (camera["partial"], slam["partial"]) == ("", "udp counted by link only")
        # 1,042 bytes a frame, and what the robot refuses: 500 bytes each.
        assert camera["tx_bytes_per_s"] == pytest.approx(200 * 1042, rel=0.25)
        for name in ("camera", "slam"):
            agent.stop(name)
        site.counters("remove")
        agent.end()
