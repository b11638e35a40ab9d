# SPDX-License-Identifier: Apache-2.0
"""Latency and gap by real messages of ROS 1 and ROS 2: against the sender's record and another subscriber's."""

import json
import math
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link import sketch
from edgectl.agent.measure import proc
from tests.agent.conftest import AgentHost, eventually
from tests.pace import patience
from tests.views.fixtures import ROOT

NODE = Path(__file__).with_name("latency_node.py")
PYTHON = {"1": "/usr/bin/python3", "2": str(ROOT / ".venv-ros2" / "bin" / "python3")}
TOPIC = "/cmd_age"


@dataclass
class Graph:
    """A graph of its own, and the host that listens to it."""

    version: str
    host: AgentHost
    surroundings: dict[str, Any]
    run: Callable[..., "subprocess.Popen[bytes]"]


def end_group(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture(params=["1", "2"])
def graph(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    version = request.param
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    env = {"ROS_DOMAIN_ID": str(1 + os.getpid() % 200)}
    if version == "1":
        env = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_HOSTNAME": "127.0.0.1"}
    setup = tmp_path / "setup.bash"
    setup.write_text(f"export PATH={Path(PYTHON[version]).parent}:$PATH\n")
    ros = {"version": int(version), "setup": [str(setup)], "peers": [], "values": {}}
    started: list[subprocess.Popen[bytes]] = []

    def run(*words: str) -> "subprocess.Popen[bytes]":
        command = [PYTHON[version], str(NODE), version, *words] if words[0] != "roscore" else list(words)
        started.append(
            subprocess.Popen(
                command, env={**os.environ, **env}, start_new_session=True, stdout=subprocess.DEVNULL
            )
        )
        return started[-1]

    host = AgentHost("robot1", tmp_path / "state")
    try:
        if version == "1":
            run("roscore", "-p", str(port))
        yield Graph(version, host, {"ros": ros, "env": env}, run)
    finally:
        for process in started:
            end_group(process)
        end_counter(host)


def end_counter(host: AgentHost) -> None:
    """End the process that counts: it ends with its directory, and its listener with it."""
    folder = host.home / "latency-topics"
    if folder.exists():
        lock = (folder / "lock").stat()
        (folder / "rules").unlink(missing_ok=True)
        eventually(lambda: not list_holders(lock.st_ino), seconds=20.0)


def list_holders(inode: int) -> list[int]:
    found = []
    for pid in proc.read_process_table():
        try:
            fds = list(Path(f"/proc/{pid}/fd").iterdir())
            if pid != os.getpid() and any(fd.stat().st_ino == inode for fd in fds):
                found.append(pid)
        except OSError:
            continue
    return found


def ask_latency(graph: Graph, **fields: Any) -> dict[str, Any]:
    rule = {"task": "nav", "topic": TOPIC, "bound_ms": 1000.0, "instance": "", "here": False}
    latencies = graph.host.ask("probe", window_s=0.05, latency=[{**rule, **graph.surroundings, **fields}])
    found: dict[str, Any] = latencies["latencies"]["nav"]
    return found


def test_percentiles_of_a_topic_are_those_of_the_sender(graph: Graph, tmp_path: Path) -> None:
    ask_latency(graph)
    graph.run("send", TOPIC, str(tmp_path / "sent.json"))
    assert eventually((tmp_path / "sent.json").exists, seconds=60.0)
    ages = json.loads((tmp_path / "sent.json").read_text())
    assert eventually(lambda: ask_latency(graph)["count"] == len(ages), seconds=30.0), ask_latency(graph)
    found = ask_latency(graph)
    assert found["error"] == ""
    late_ms = patience(20.0)
    buckets = {int(bucket): count for bucket, count in found["buckets"].items()}
    for share in (0.5, 0.95, 0.99):
        exact = sorted(ages)[math.ceil(share * len(ages)) - 1]
        measured = sketch.find_quantile(buckets, share)
        assert measured is not None
        assert exact * (1 - sketch.ERROR) <= measured <= (exact + late_ms) * (1 + sketch.ERROR)
    misses = [sum(age > bound for age in ages) for bound in (1000.0, 1000.0 - late_ms)]
    assert misses[0] <= found["misses"] <= misses[1]
    again = ask_latency(graph, instance="i2")
    assert again["count"] == 0, "a new instance begins at zero"


def test_without_a_graph_the_reason_is_said(graph: Graph) -> None:
    broken = {**graph.surroundings["ros"], "setup": []}
    env = {**graph.surroundings["env"], "PATH": "/nonexistent"}
    assert eventually(lambda: ask_latency(graph, ros=broken, env=env)["error"], seconds=30.0) == (
        f"the listener ended: python3 of the set-up files may have no {'rospy' if graph.version == '1' else 'rclpy'}"
    )


def read_times(path: Path) -> list[float]:
    return [float(line) for line in path.read_text().splitlines()] if path.exists() else []


def check_gap(graph: Graph, tmp_path: Path, interrupt: Callable[["subprocess.Popen[bytes]"], None]) -> None:
    """Compare the silence of a topic while ``interrupt`` acts on its sender with that of another subscriber."""
    body = {"task": "nav", "watch": "w1", "topic": TOPIC, "command": "", "prelude": "", **graph.surroundings}
    heard = tmp_path / "heard"
    graph.run("hear", TOPIC, str(heard))
    old = graph.run("beat", TOPIC, str(tmp_path / "old"))
    assert eventually(lambda: len(read_times(heard)) > 10, seconds=60.0)
    begun = graph.host.ask("hear", **body, action="begin", after_s=0.0, timeout_s=patience(20.0))
    assert begun["heard"], begun
    stopped = time.monotonic()
    interrupt(old)
    after_s = time.monotonic() - stopped
    found = graph.host.ask("hear", **body, action="end", after_s=after_s, timeout_s=patience(30.0))
    assert found["heard"], found
    assert eventually(lambda: read_times(heard)[-1] > stopped + after_s, seconds=30.0)
    gap = max(after - before for before, after in pairwise(read_times(heard)) if after > stopped)
    assert found["silence_s"] == pytest.approx(gap, abs=patience(0.03)), (found, gap)
    print(f"ROS {graph.version}: gap {found['silence_s']:.4f} s, the subscriber's {gap:.4f} s")


def test_the_gap_of_a_topic_is_what_another_subscriber_counted(graph: Graph, tmp_path: Path) -> None:
    """The same sender pauses: in ROS 2 each subscriber discovers a new one by itself, at another time."""

    def pause(sender: "subprocess.Popen[bytes]") -> None:
        os.killpg(sender.pid, signal.SIGSTOP)
        time.sleep(0.5)
        os.killpg(sender.pid, signal.SIGCONT)

    check_gap(graph, tmp_path, pause)


@pytest.mark.parametrize("graph", ["1"], indirect=True)
def test_a_new_sender_ends_the_gap(graph: Graph, tmp_path: Path) -> None:
    def replace(sender: "subprocess.Popen[bytes]") -> None:
        end_group(sender)
        graph.run("beat", TOPIC, str(tmp_path / "new"))

    check_gap(graph, tmp_path, replace)
