# SPDX-License-Identifier: Apache-2.0
"""Questions to a graph of ROS 1, the supervisor that asks them, set-up files and addresses.

Master and nodes are small ones of our own that speak the APIs of ROS (`tests/ros1_peer.py`); ``make ros`` runs
the same against Debian's ROS.
"""

import os
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link.errors import RefusalError
from edgectl.agent.measure import detection, proc
from edgectl.agent.ros import local
from edgectl.agent.supervise.checks import AliveCheck
from edgectl.errors import RefusedError
from tests import ros1_peer
from tests.agent.conftest import AgentHost, eventually, is_running
from tests.pace import patience
from tests.ros1_peer import Master

NODE = f"exec {shlex.quote(sys.executable)} -S {shlex.quote(ros1_peer.__file__)} $ROS_MASTER_URI"


@pytest.fixture
def master() -> Iterator[Master]:
    with ros1_peer.serve_master() as found:
        yield found


@pytest.fixture
def node(master: Master) -> Iterator[subprocess.Popen[bytes]]:
    """A node /talker that nobody supervises."""
    argv = [sys.executable, "-S", ros1_peer.__file__, master.uri, "/talker"]
    with subprocess.Popen(argv) as process:
        eventually(lambda: "/talker/ask" in master.services)
        yield process
        process.kill()


def a_question(**asked: Any) -> dict[str, Any]:
    return {"version": 1, "node": None, "topic": None, "service": None, "lifecycle": None, **asked}


def ask_graph(host: AgentHost, master: Master, **asked: Any) -> dict[str, Any]:
    return host.ask(
        "check",
        command="",
        graph=a_question(**asked),
        prelude="",
        ros=None,
        env={"ROS_MASTER_URI": master.uri},
        timeout_s=10.0,
    )


def test_the_graph_answers(host: AgentHost, master: Master, node: subprocess.Popen[bytes]) -> None:
    topic = {"name": "/chatter", "within_s": 2.0}
    asked = ask_graph(host, master, node="/talker", topic=topic, service="/talker/ask")
    assert asked["exit"] == 0, asked
    assert ask_graph(host, master, topic={"name": "/scan", "within_s": 2.0})["output"] == (
        "topic /scan has no publisher"
    )
    # The master goes on naming a node that was killed.
    node.kill()
    node.wait()
    dead = ask_graph(host, master, node="/talker")
    assert dead["exit"] == 1
    assert dead["output"].startswith("node /talker is registered at http://127.0.0.1:")
    assert "does not answer: Connection refused" in dead["output"]
    assert "does not answer" in ask_graph(host, master, service="/talker/ask")["output"]


def test_a_node_that_hangs_is_not_alive(
    host: AgentHost, master: Master, node: subprocess.Popen[bytes]
) -> None:
    """Its kernel still accepts connections."""
    node.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    hung = host.ask(
        "check",
        command="",
        graph=a_question(node="/talker"),
        prelude="",
        ros=None,
        env={"ROS_MASTER_URI": master.uri},
        timeout_s=0.5,
    )
    assert hung["exit"] != 0
    assert time.monotonic() - began < patience(5.0)


@pytest.mark.parametrize("reply", [b"", b"HTTP/1.1 200 OK\r\n\r\nno xml", b"\0" * 200_000])
def test_a_master_that_is_none(host: AgentHost, master: Master, reply: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        master.uri = f"http://127.0.0.1:{server.getsockname()[1]}"
        pid = os.fork()
        if pid == 0:
            peer, _ = server.accept()
            peer.sendall(reply)
            peer.close()
            os._exit(0)
        try:
            answer = ask_graph(host, master, node="/talker")
        finally:
            os.waitpid(pid, 0)
    assert answer["exit"] == 1
    assert answer["output"].startswith("node /talker is not registered: master http://")


def start_talker(host: AgentHost, master: Master, *, restart: bool, name: str = "talker") -> dict[str, Any]:
    check = {"command": "", "graph": a_question(node="/talker"), "timeout_s": 20.0}
    return host.start(
        name,
        f"{NODE} /talker",
        env={"ROS_MASTER_URI": master.uri},
        ready=check,
        alive={**check, "after_s": 0.1, "restart": restart},
        restart="on-failure",
    )


def test_a_restarted_master_makes_its_nodes_unhealthy(host: AgentHost, master: Master) -> None:
    """They live, and nobody can find them any more; where the spec says so they are restarted."""
    start_talker(host, master, restart=False)
    assert host.until("talker", "ready")["detail"] == ""
    master.forget()
    sick = host.until("talker", "unhealthy")
    assert sick["detail"].startswith("node /talker is not registered: master ")
    assert sick["pid"] > 0
    host.stop("talker")
    start_talker(host, master, restart=True)
    before = host.until("talker", "ready")
    master.forget()
    after = eventually(lambda: e if (e := host.entry("talker")) and e["restarts"] == 1 else None)
    assert after["instance"] == before["instance"]
    assert host.until("talker", "ready")["pid"] != before["pid"]
    assert "not alive: node /talker is not registered" in str(host.ask("logs", task="talker", tail=9))
    host.stop("talker")


def test_a_stop_does_not_wait_for_a_question(host: AgentHost, master: Master) -> None:
    """The node hangs, so the question that is under way would end seconds later."""
    pid = start_talker(host, master, restart=False)["pid"]
    host.until("talker", "ready")
    os.kill(pid, signal.SIGSTOP)
    assert "does not answer" in host.until("talker", "unhealthy")["detail"]
    began = time.monotonic()
    assert host.stop("talker")["state"] == "stopped"
    assert time.monotonic() - began < patience(2.5)


def test_a_name_that_is_used_twice(host: AgentHost, master: Master) -> None:
    """The answer of another node of that name is no proof that the task lives."""
    start_talker(host, master, restart=False)
    host.until("talker", "ready")
    with subprocess.Popen([sys.executable, "-S", ros1_peer.__file__, master.uri, "/talker"]) as thief:
        sick = host.until("talker", "unhealthy")
        thief.kill()
    host.stop("talker")
    assert sick["detail"] == (
        f"node /talker is process {thief.pid} of this host, and not of this task: its name is used twice"
    )


def test_set_up_files_are_sourced(host: AgentHost, tmp_path: Path) -> None:
    """In order, without arguments, before the prelude; the command is still the main process."""
    first, second, seen = tmp_path / "a b.bash", tmp_path / "$(x).bash", tmp_path / "seen"
    first.write_text('export ARGUMENTS="$#:$*" ORDER=first\n')
    second.write_text("export ORDER=$ORDER-second\nfalse\n")
    ros = {"setup": [str(first), str(second)], "peers": [], "values": {}}
    command = f'echo "$ARGUMENTS $ORDER $PRELUDE" > {seen}; exec sleep 600'
    pid = host.start("t", command, prelude="PRELUDE=$ORDER", ros=ros)["pid"]
    eventually(lambda: seen.exists() and seen.read_text())
    assert seen.read_text() == "0: first-second first-second\n"
    assert is_running(pid)
    host.stop("t")
    host.start("t", "sleep 600", instance="i2", ros={**ros, "setup": [str(tmp_path / "none.bash")]})
    failed = host.until("t", "failed")
    assert failed["exit_code"] == 126
    assert failed["log_tail"] == [f"edgectl: set-up file {tmp_path}/none.bash cannot be read"]


def test_the_host_fills_in_addresses(host: AgentHost, tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    ros = {
        "setup": [],
        "peers": ["127.0.0.9"],
        "values": {"robot_address": "127.0.0.9", "master": "http://m:1"},
    }
    command = f"echo {{host_address}} {{robot_address}} {{master}} $ROS_IP ${{robot_address}} > {seen}"
    host.start("t", command, env={"ROS_IP": "{host_address}"}, ros=ros)
    eventually(lambda: seen.exists() and seen.read_text())
    assert seen.read_text() == "127.0.0.1 127.0.0.9 http://m:1 127.0.0.1\n"
    with pytest.raises(RefusalError, match=r"\{master\} has no value"):
        local.fill_request(
            {"command": "x {master}", "env": {}, "ros": {"setup": [], "peers": [], "values": {}}}
        )


def test_the_address_towards_a_robot_is_not_the_loopback_one() -> None:
    """Unless the robot is on this machine too."""
    assert local.find_own_address(["127.0.0.1"]) == "127.0.0.1"
    outside = local.find_address_towards("192.0.2.1")
    assert local.find_own_address(["192.0.2.7", "127.0.0.1"]) == (outside or "127.0.0.1")


def test_a_node_that_is_started_again_and_again_is_not_alive() -> None:
    """A launcher that respawns it hides that somebody else throws it out each time."""
    check = AliveCheck({"alive": {"command": "", "graph": a_question(node="/slam"), "after_s": 10.0}}, {})
    answers = [{"exit": 0, "timed_out": False, "output": str(pid)} for pid in (1, 1, 2, 3, 3, 4)]
    judged = [check._judge(answer) for answer in answers]
    assert judged[:5] == [""] * 5
    assert judged[5] == "node /slam was started 3 times within 60 s: is its name used twice?"


def test_the_nodes_of_a_graph_are_listed_with_their_processes(
    host: AgentHost, master: Master, node: subprocess.Popen[bytes]
) -> None:
    """One that was killed is still registered; one at another address is not asked; one of a task says so."""
    host.start("own", f"{NODE} /own /data", env={"ROS_MASTER_URI": master.uri})
    eventually(lambda: "/own/ask" in master.services)
    master.nodes["/far"] = "http://192.0.2.7:1/"
    master.publishers["/far_data"] = ["/far"]
    with subprocess.Popen([sys.executable, "-S", ros1_peer.__file__, master.uri, "/dead"]) as dead:
        eventually(lambda: "/dead/ask" in master.services)
        dead.kill()
    answer = host.ask("graph", version=1, ros=None, env={"ROS_MASTER_URI": master.uri}, timeout_s=10.0)
    seen = {each["name"]: each for each in answer["nodes"]}
    assert sorted(seen) == ["", "/dead", "/far", "/own", "/talker"]
    talker = seen["/talker"]
    assert (talker["pid"], talker["here"], talker["task"]) == (node.pid, True, "")
    assert talker["words"] == [sys.executable, "-S", ros1_peer.__file__, master.uri, "/talker"]
    assert (talker["named"], talker["alike"], talker["publishes"]) == (False, 0, ["/chatter"])
    assert seen["/own"]["task"] == f"{host.fleet}/{host.name}/own"
    assert (seen["/far"]["here"], seen["/far"]["address"], seen["/far"]["pid"]) == (False, "192.0.2.7", 0)
    assert (seen["/dead"]["pid"], seen["/dead"]["fault"]) == (0, "does not answer: Connection refused")


def test_a_graph_without_a_master_is_refused(host: AgentHost) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        gone = f"http://127.0.0.1:{server.getsockname()[1]}"
    with pytest.raises(RefusedError, match=f"master {gone}: Connection refused"):
        host.ask("graph", version=1, ros=None, env={"ROS_MASTER_URI": gone}, timeout_s=10.0)


@pytest.mark.parametrize(
    ("rule", "words", "namespace", "matches"),
    [
        ("slam", ["__name:=slam"], None, True),
        ("slam", ["__name:=slam"], "robot1", True),
        ("/slam", ["__name:=slam"], None, True),
        ("/slam", ["__name:=slam"], "robot1", False),
        ("/robot1/slam", ["__name:=slam"], "robot1", True),
        ("/robot1/slam", ["__name:=slam"], "/robot1/", True),
        ("/robot1/slam", ["__name:=slam"], None, False),
        ("/robot1/slam", ["__name:=slam", "__ns:=/robot1"], "robot2", True),
        ("/robot1/slam", ["--ros-args", "-r", "__node:=slam", "-r", "__ns:=/robot1"], None, True),
        ("/slam", ["__name:=slammer"], None, False),
        ("/sleeper", [], None, True),
        ("/sleeper", ["__name:=other"], None, False),
    ],
)
def test_a_rule_for_a_node_compares_name_and_namespace(
    tmp_path: Path,
    rule: str,
    words: list[str],
    namespace: "str | None",
    matches: bool,
) -> None:
    program = tmp_path / "sleeper.py"
    program.write_text("import time; time.sleep(1000)")
    env = {name: value for name, value in os.environ.items() if name != "ROS_NAMESPACE"}
    env |= {"ROS_NAMESPACE": namespace} if namespace else {}
    with subprocess.Popen([sys.executable, str(program), *words], env=env) as process:
        try:
            argv = eventually(
                lambda: (
                    found
                    if (found := proc.read_cmdline(process.pid))[-1:] == [str(program), *words][-1:]
                    else None
                )
            )
            assert detection.is_match({"ros_node": rule}, process.pid, argv) is matches
        finally:
            process.kill()
