# SPDX-License-Identifier: Apache-2.0
"""Profilers on this machine: known work, known bytes, one document with and without psutil and on every Python."""

import contextlib
import os
import select
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.measure import device, network, proc, sockets
from edgectl.agent.measure.task import TaskProcesses, collect_cpu_s
from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost, eventually
from tests.pace import patience

# Addresses that nothing else on this machine uses, not even a parallel run of these tests.
NET = f"127.{100 + os.getpid() // 250 % 100}.{os.getpid() % 250}"


def build_links(first: int) -> list[dict[str, str]]:
    """Two links whose addresses end with ``first`` and the number after: files of tests may run at the same time."""
    return [{"robot": f"robot{number}", "address": f"{NET}.{first + number - 1}"} for number in (1, 2)]


LINKS = build_links(21)
ROBOT = LINKS[0]["address"]


@cache
def interpreters() -> list[str]:
    """Every Python 3.6 or later installed beside this one or on the path."""
    found = {version: shutil.which(f"python3.{version}") for version in range(6, 15)}
    for path in sorted(Path(sys.base_prefix).parent.glob("3.*/bin/python3")):
        minor = path.parent.parent.name.split(".")[1]
        if minor.isdigit() and int(minor) >= 6:
            found[int(minor)] = str(path)
    usable = [
        path
        for path in found.values()
        if path and subprocess.run([path, "-c", "0"], capture_output=True, check=False).returncode == 0
    ]
    return [sys.executable, *usable]


@contextlib.contextmanager
def connected(address: str = ROBOT) -> Iterator[tuple[socket.socket, socket.socket]]:
    """A connection of which only the first end's remote address is the robot's."""
    with socket.create_server((address, 0)) as server, socket.create_connection(server.getsockname()) as near:
        far, _ = server.accept()
        with far:
            yield near, far


def sent(near: socket.socket, far: socket.socket, size: int) -> None:
    """Move exactly ``size`` bytes from ``near`` to ``far``, acknowledged."""
    sender = threading.Thread(target=near.sendall, args=(bytes(size),))
    sender.start()
    while size:
        size -= len(far.recv(min(size, 1 << 16)))
    sender.join()


def test_counters_of_a_connection_are_exact() -> None:
    with connected() as (near, far):
        sent(near, far, 5_000)
        with contextlib.closing(network.TrafficMeter({"robot1": [ROBOT]})) as traffic:
            sent(near, far, 1_000_000)
            sent(far, near, 30_000)
            time.sleep(0.1)
            flows = [flow for flow in traffic.flows() if flow.remote == ROBOT]
    assert [(flow.tx, flow.rx) for flow in flows] == [(1_000_000, 30_000)]
    assert 0 < flows[0].rtt_ms < 1000


def test_connection_that_appears_in_the_window_counts_in_full() -> None:
    # A separate address: the kernel reports closed connections with a delay, those of other tests too.
    robot = f"{NET}.31"
    with (
        contextlib.closing(network.TrafficMeter({"robot1": [robot]})) as traffic,
        connected(robot) as (near, far),
    ):
        sent(near, far, 70_000)
        time.sleep(0.1)
        flows = [flow for flow in traffic.flows() if flow.remote == robot]
    # The kernel counts the handshake as one acknowledged byte.
    assert [(flow.tx - 1, flow.rx) for flow in flows] == [(70_000, 0)]


def test_connections_that_end_in_the_window_count_up_to_their_end() -> None:
    # A separate address, and no fixed time: the kernel reports closed connections with a delay, a busy one with a long one.
    robot, found = f"{NET}.32", list[int]()
    with connected(robot) as (near, far):
        traffic = network.TrafficMeter({"robot1": [robot]})
        sent(near, far, 60_000)
    with connected(robot) as (near, far):
        sent(near, far, 90_000)

    def have_ended() -> bool:
        # The kernel counts opening and closing as one acknowledged byte each.
        found.extend(flow.tx // 1000 for flow in traffic.flows() if flow.remote == robot and flow.tx > 10)
        return len(found) >= 2

    with contextlib.closing(traffic):
        eventually(have_ended)
        time.sleep(0.1)
        have_ended()
    assert sorted(found) == [60, 90]


def test_what_was_closed_is_collected_at_once_and_not_in_the_next_window() -> None:
    """Else the end of a connection before a probe would bring all of its bytes into the window of the probe."""
    robot = f"{NET}.34"
    with contextlib.closing(sockets.CloseListener({sockets.pack_address(robot)})) as listener:
        for _ in range(50):
            with connected(robot) as (near, far):
                sent(near, far, 1_000)
                # Both ends are gone at once, without a handshake.
                for each in (near, far):
                    each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            found = [each.tx for each in listener.collect() if each.remote[0] == robot]
            assert [tx // 1000 for tx in found] == [1]


def test_what_was_closed_before_the_window_is_forgotten() -> None:
    """Also where the kernel reports it later, and nothing that is closed after that."""
    robot = f"{NET}.35"
    with contextlib.closing(sockets.CloseListener({sockets.pack_address(robot)})) as listener:
        for number in range(20):
            for size, act in ((2_000, listener.forget), (1_000, lambda: None)):
                with connected(robot) as (near, far):
                    sent(near, far, size)
                    for each in (near, far):
                        each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                act()
            found = [each.tx // 1000 for each in listener.collect() if each.remote[0] == robot]
            assert found == [1], number


def test_a_connection_that_ends_while_connections_are_listed_counts_once() -> None:
    """The kernel says so after the closed ones were collected, so the listing lacks it and the report is late."""
    robot = f"{NET}.33"
    with connected(robot) as (near, far):
        sent(near, far, 60_000)
        with contextlib.closing(network.TrafficMeter({"robot1": [robot]})) as traffic:
            collect = traffic._closed.collect

            def collect_and_close() -> list[sockets.TcpConnection]:
                found = collect()
                near.close()
                far.close()
                eventually(lambda: not sockets.list_connections({sockets.pack_address(robot)}))
                return found

            traffic._closed.collect = collect_and_close  # type: ignore[method-assign]
            assert [flow for flow in traffic.flows() if flow.remote == robot] == []
            traffic._closed.collect = collect  # type: ignore[method-assign]
            link = traffic._closed._link
            assert link is not None
            assert select.select([link], [], [], patience(30.0))[0], "the kernel did not report it"
            late = [flow.tx for flow in traffic.flows() if flow.remote == robot]
            # Its end alone, as one byte.
            assert len(late) == 1
            assert late[0] <= 1
            assert [flow for flow in traffic.flows() if flow.remote == robot] == []


def test_traffic_inside_the_host_does_not_count() -> None:
    with (
        connected() as (near, far),
        contextlib.closing(network.TrafficMeter({"robot1": [f"{NET}.22"]})) as traffic,
    ):
        sent(near, far, 60_000)
        assert not [flow for flow in traffic.flows() if flow.remote in (ROBOT, "127.0.0.1")]


def has_v6() -> bool:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        return False
    return True


@pytest.mark.skipif(not has_v6(), reason="this machine has no IPv6")
def test_v6_connections_count() -> None:
    with (
        contextlib.closing(network.TrafficMeter({"robot1": ["::1"]})) as traffic,
        socket.create_server(("::1", 0), family=socket.AF_INET6) as server,
        socket.create_connection(server.getsockname()[:2]) as near,
    ):
        far, _ = server.accept()
        with far:
            sent(near, far, 40_000)
            time.sleep(0.1)
            assert any(flow.remote == "::1" and flow.tx >= 40_000 for flow in traffic.flows())


def test_probe_splits_links_by_remote_address(host: AgentHost) -> None:
    stop = threading.Event()
    with connected() as (near, far):

        def pour() -> None:
            while not stop.wait(0.02):
                sent(near, far, 40_000)

        pouring = threading.Thread(target=pour)
        pouring.start()
        document = host.ask("probe", window_s=1.0, links=LINKS)
        stop.set()
        pouring.join()
    link, other = document["links"]["robot1"], document["links"]["robot2"]
    assert 0.02e6 < link["tx_bytes_per_s"] < 6e6
    assert link["rx_bytes_per_s"] == 0
    assert (link["reachable"], link["interface"]) == (True, "lo")
    assert other["tx_bytes_per_s"] == 0
    assert (other["reachable"], other["interface"]) == (True, "lo")
    assert other["rtt_ms"] >= 0
    lo = document["interfaces"]["lo"]
    assert lo["tx_bytes_per_s"] >= link["tx_bytes_per_s"] * 0.5
    assert lo["speed_bytes_per_s"] is None


def test_robot_names_are_resolved_and_unknown_ones_cost_little(host: AgentHost) -> None:
    began = time.monotonic()
    links = [
        {"robot": "robot1", "address": "localhost"},
        {"robot": "robot2", "address": "no-such-robot.invalid"},
    ]
    document = host.ask("probe", window_s=0.1, links=links)
    assert time.monotonic() - began < patience(20)
    assert document["links"]["robot1"]["interface"] == "lo"
    unknown = document["links"]["robot2"]
    assert (unknown["rtt_ms"], unknown["interface"], unknown["reachable"]) == (None, None, None)


TASK = """
import socket, sys, time
robot = socket.create_connection((sys.argv[1], int(sys.argv[2])))
held = bytearray(40_000_000)
print("up", flush=True)
while True:
    end = time.monotonic() + 0.02
    while time.monotonic() < end:
        pass
    robot.sendall(bytes(10_000))
    time.sleep(0.02)
"""


def test_task_is_measured_with_its_whole_tree(host: AgentHost, tmp_path: Path) -> None:
    (tmp_path / "task.py").write_text(TASK)
    with socket.create_server((ROBOT, 0)) as server:
        command = (
            f"{sys.executable} {tmp_path}/task.py {ROBOT} {server.getsockname()[1]} & setsid sleep 600; true"
        )
        host.start("slam-robot1", command)
        peer, _ = server.accept()
        drain = threading.Thread(target=lambda: [None for _ in iter(lambda: peer.recv(1 << 16), b"")])
        drain.start()
        eventually(lambda: "up" in host.ask("logs", task="slam-robot1", tail=3)["text"])
        document = host.ask("probe", window_s=1.0, links=LINKS)
        host.stop("slam-robot1")
        drain.join()
        peer.close()
    entry = document["tasks"]["slam-robot1"]
    assert (entry["state"], entry["managed"], entry["instance"]) == ("running", True, "i1")
    assert 0.01 < entry["used_cores"] < 0.8
    assert 40e6 < entry["used_bytes"] < 80e6
    assert set(entry["links"]) == {"robot1"}
    assert entry["links"]["robot1"] == pytest.approx(entry["tx_bytes_per_s"], rel=0.01)
    assert 5_000 < entry["tx_bytes_per_s"] < 1_000_000
    assert document["cpu"]["used_cores"] >= entry["used_cores"] * 0.5


def test_cpu_of_children_that_come_and_go_is_counted(host: AgentHost) -> None:
    host.start("work", f"while :; do {sys.executable} -I -S -c 'for i in range(300000): pass'; done")
    document = host.ask("probe", window_s=1.0)
    host.stop("work")
    assert document["tasks"]["work"]["used_cores"] > 0.1


_NODE = """
import threading, time
def work():
    while time.thread_time() < 0.004: pass
thread = threading.Thread(target=work)
thread.start()
thread.join()
print(time.process_time(), flush=True)
input()
"""


def test_the_cpu_of_a_small_node_is_read_finer_than_in_ticks_and_of_all_its_threads() -> None:
    with subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _NODE], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as node:
        assert node.stdin is not None
        assert node.stdout is not None
        used_s = float(node.stdout.readline())
        table = proc.read_process_table()
        found = collect_cpu_s(TaskProcesses({node.pid}, 0, {}), table)
        node.stdin.close()
    # What it used after its own look is the print, well below a tick; the main thread alone used 4 ms less.
    assert found == {node.pid: pytest.approx(used_s + 0.001, abs=0.002)}


def test_used_cores_are_the_machine_s_without_the_agent(host: AgentHost) -> None:
    busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        cpu = eventually(
            lambda: found if (found := host.ask("probe", window_s=0.5)["cpu"])["used_cores"] >= 0.4 else None
        )
    finally:
        busy.kill()
        busy.wait()
    assert cpu["cores"] <= len(os.sched_getaffinity(0))
    assert cpu["used_cores"] <= cpu["cores"]


def test_checks_run_beside_the_window(host: AgentHost) -> None:
    host.start("alive", "exec sleep 600")
    checks = [
        {"task": "alive", "command": "echo $WHAT; exit 3", "timeout_s": 25, "env": {"WHAT": "done"}},
        {"task": "dead", "command": "exit 0", "timeout_s": 25},
        {"task": "slow", "command": "sleep 600 & sleep 600", "timeout_s": 0.4, "always": True},
        {
            "task": "prelude",
            "command": "f",
            "prelude": "f() { echo from bash; }",
            "timeout_s": 25,
            "always": True,
        },
    ]
    found = host.ask("probe", window_s=0.1, checks=checks)["checks"]
    host.stop("alive")
    assert found == {
        "alive": {"exit": 3, "timed_out": False, "output": "done\n"},
        "slow": {"exit": None, "timed_out": True, "output": ""},
        "prelude": {"exit": 0, "timed_out": False, "output": "from bash\n"},
    }


def test_check_keeps_the_end_of_long_output(host: AgentHost) -> None:
    found = host.ask("check", command="seq 100000; exit 1", prelude="", env={}, timeout_s=10)
    assert (found["exit"], found["timed_out"], len(found["output"])) == (1, False, 2048)
    assert found["output"].endswith("99999\n100000\n")


def test_detect_finds_unmanaged_tasks(host: AgentHost) -> None:
    host.start("own", "exec sleep 6543.2")
    neighbour = AgentHost("edge2", host.state)
    neighbour.start("theirs", "exec sleep 6543.3")
    other = subprocess.Popen(["sleep", "6543.1"])
    node = subprocess.Popen(["bash", "-c", "sleep 600; true", "talker", "__name:=talker"])
    try:
        detect = [
            {"task": "found", "cmdline": r"sleep 6543\.\d"},
            {"task": "ros", "ros_node": "/talker"},
            {"task": "none", "cmdline": "no-such-thing"},
        ]
        tasks = host.ask("probe", window_s=0.2, detect=detect)["tasks"]
    finally:
        for process in (other, node):
            process.kill()
            process.wait()
    host.stop("own")
    neighbour.stop("theirs")
    neighbour.end()
    assert set(tasks) == {"own", "found", "ros"}
    assert (tasks["found"]["pid"], tasks["found"]["managed"], tasks["found"]["state"]) == (
        other.pid,
        False,
        "running",
    )
    assert tasks["ros"]["pid"] == node.pid
    assert tasks["own"]["managed"] is True


def shape(value: Any) -> Any:
    """The names and types in a document, without its numbers."""
    if isinstance(value, dict):
        return {name: shape(inner) for name, inner in value.items()}
    return (
        "number" if isinstance(value, int | float) and not isinstance(value, bool) else type(value).__name__
    )


@pytest.mark.parametrize("python", interpreters(), ids=lambda path: "-".join(Path(path).parts[-3::2]))
def test_every_python_gives_the_same_document_and_supervises(host: AgentHost, python: str) -> None:
    reference = host.ask("probe", window_s=0.1, links=LINKS)
    host.session.python = python
    document = host.ask("probe", window_s=0.1, links=LINKS)
    assert shape(document) | {"temperature_c": 0, "gpu_share": 0} == shape(reference) | {
        "temperature_c": 0,
        "gpu_share": 0,
    }
    started = host.start("slam", "echo hello; exec sleep 600", instance="i2")
    assert started["state"] == "started"
    assert host.ask("wait", task="slam", instance="i2", timeout_s=30)["state"] == "running"
    assert host.ask("logs", task="slam", tail=1)["text"] == "hello\n"
    assert host.stop("slam")["state"] == "stopped"


def test_memory_is_what_psutil_reads(tmp_path: Path) -> None:
    psutil = device.import_psutil()
    assert psutil is not None
    seen, (total, used) = psutil.virtual_memory(), device.read_machine_memory()
    assert total == seen.total
    assert abs(used - (seen.total - seen.available)) < 200e6
    # Linux before 3.14 does not say what is available.
    (tmp_path / "meminfo").write_text("MemTotal: 4 kB\nMemFree: 1 kB\nBuffers: 1 kB\nCached: 1 kB\n")
    assert device.read_machine_memory(str(tmp_path / "meminfo"))[0] == seen.total


def test_a_probe_says_that_there_is_psutil_without_its_import(host: AgentHost, tmp_path: Path) -> None:
    folder = f"lib/python{sys.version_info[0]}.{sys.version_info[1]}/site-packages/psutil"
    (tmp_path / folder).mkdir(parents=True)
    (tmp_path / folder / "__init__.py").write_text("raise SystemExit('imported')\n")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python3").symlink_to(Path(sys.executable).resolve())
    host.session.python = str(tmp_path / "bin" / "python3")
    assert host.ask("probe", window_s=0.1, links=LINKS)["psutil"] is True


def test_temperature_is_plausible_or_missing() -> None:
    found = device.read_temperature_c()
    assert found is None or 0 < found < 150


def test_bandwidth_is_measured_by_sending(host: AgentHost) -> None:
    door = host.ask("sink", seconds=1)
    result = host.ask("send", address="127.0.0.1", port=door["port"], token=door["token"], seconds=0.5)
    assert result["bytes"] > 1_000_000
    assert 0.4 < result["seconds"] < 15
    with pytest.raises(RefusedError, match=r"cannot send to 127\.0\.0\.1"):
        host.ask("send", address="127.0.0.1", port=door["port"], token=door["token"], seconds=0.2)


def test_sink_serves_only_senders_with_the_token(host: AgentHost) -> None:
    door = host.ask("sink", seconds=1)
    with socket.create_connection(("127.0.0.1", door["port"]), timeout=30) as stranger:
        stranger.sendall(b"x" * 32 + b"\n")
        assert stranger.recv(10) == b""
    assert (
        host.ask("send", address="127.0.0.1", port=door["port"], token=door["token"], seconds=0.2)["bytes"]
        > 0
    )


def test_unknown_operation_is_refused(host: AgentHost) -> None:
    with pytest.raises(RefusedError, match="no operation 'dance'"):
        host.ask("dance")


def test_bug_in_the_agent_is_reported_in_one_line(host: AgentHost) -> None:
    with pytest.raises(RefusedError, match=r"^ValueError: .* \(probe.py:\d+\)$"):
        host.ask("probe", window_s="soon")
