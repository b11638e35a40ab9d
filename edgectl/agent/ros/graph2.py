# SPDX-License-Identifier: Apache-2.0
"""Questions to the graph of ROS 2, asked of a helper that stays while tasks of this host live.

Who joins a graph of ROS 2 needs a second or two until it knows the others. So one helper per host and domain
does it once, in the environment of the set-up files, and every question takes milliseconds.
"""

import _signal as signal
import os
import struct
import sys
import time

from ..link import boot, fast_json, protocol
from ..link.fast_json import Document
from ..measure.sockets import socket
from ..supervise import shell, spawn, state_dir, status
from . import participants
from .participants import Owners

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, Mapping, NoReturn

# What a node's discovery depends on.
_VARIABLES = (
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "ROS_DISCOVERY_SERVER",
    "ROS_LOCALHOST_ONLY",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "CYCLONEDDS_URI",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
)
# Part of the name of a helper: another number for each change of what it can be asked, for one of an edgectl
# before an update lives on.
_QUESTIONS = "2"
# How long a helper that was just started may take to be there.
CONNECT_S, _RETRY_S = 8.0, 0.05
# So often the keeper looks for living tasks; without any twice in a row, and without a question for as long,
# it ends the helper: a task may live between two looks, and a stop waits for the names of its nodes.
_LOOK_S, _POLL_S, _REST_S = 10.0, 0.5, 2.0
OLD_HELPER = "the helper for ROS 2 is of another edgectl; try again in a minute"
NO_HELPER = "the helper for ROS 2 is not there: python3 of the set-up files may have no rclpy"


class NoHelperError(Exception):
    """Nothing is known of the graph: there is no helper."""


def build_helper_name(env: "Mapping[str, str]", setup: "list[str]") -> str:
    """Build the name of the socket of the helper for this environment; another for each host of an
    inventory.
    """
    parts = [_QUESTIONS, state_dir.get_fleet(), env.get("EDGECTL_HOST", ""), *setup]
    parts += [env.get(name, os.environ.get(name, "")) for name in _VARIABLES]
    return "edgectl-ros2-%d-%s" % (os.geteuid(), boot.compute_sha256("\0".join(parts).encode())[:16])


def find_fault(
    asked: Document, env: "Mapping[str, str]", deadline: float, setup: "list[str]"
) -> "tuple[str, str]":
    """Find (the first condition of ``asked`` that does not hold, the process of the node where it is known).

    The fault is empty where all hold. ``env`` is that of the task: its domain, and the mark of its processes.
    ``replaces`` in ``asked``: another instance of the task lives, and its answers do not count.

    Raises:
        NoHelperError: there is no helper, or none that answers.
    """
    name, process = build_helper_name(env, setup), ""
    folder = env.get("EDGECTL_TASK_DIR")
    if folder:
        fault, process = _check_owners(name, asked, folder, deadline)
        if fault:
            return fault, process
    if folder and asked.get("replaces") is not None:
        fault, asked = _exclude_replaced(name, asked, folder, deadline)
        if fault:
            return fault, process
    return ask_helper(name, asked, deadline, CONNECT_S), process


def list_lingering(name: str, nodes: "list[str]", deadline: float) -> "list[str]":
    """List those of ``nodes`` that are in the graph, and neither as living processes nor of other hosts.

    Raises:
        NoHelperError: there is no helper, or none that answers.
    """
    found = []
    for node in ask_helper(name, {"present": nodes}, deadline).split():
        owners, _ = _ask_owners(name, {"node": node}, set(), deadline)
        if owners.gone or owners.unknown or not (owners.foreign or owners.distant):
            found.append(node)
    return found


def _ask_owners(name: str, of: "dict[str, str]", pids: "set[int]", deadline: float) -> "tuple[Owners, int]":
    """Ask who has a name: (the owners, how many nodes have it). ``pids``: the processes of the task."""
    answer = ask_helper(name, {"ends": of}, deadline, CONNECT_S)
    if not answer.startswith("{"):
        raise NoHelperError(answer or OLD_HELPER)
    seen = fast_json.loads(answer)
    return Owners(seen, pids), int(seen["nodes"])


def _check_owners(name: str, asked: Document, folder: str, deadline: float) -> "tuple[str, str]":
    """Check that the node is one of the task, and but for ``ready`` no other one has its name: (fault,
    process).
    """
    node = asked.get("node")
    if not node:
        return "", ""
    owners, count = _ask_owners(name, {"node": node}, participants.find_pids(folder), deadline)
    if not count:
        return "node %s is not in the graph" % node, ""
    if owners.others:
        return participants.describe_foreign(node, owners), ""
    process = str(min(owners.ours.values())) if owners.ours else ""
    return "" if asked.get("starting") else participants.describe_twice(node, owners), process


def _exclude_replaced(name: str, asked: Document, folder: str, deadline: float) -> "tuple[str, Document]":
    """Leave out of a question what the instance that is replaced could answer: (fault, question)."""
    pids = participants.find_pids(folder)
    if asked.get("lifecycle"):
        _, count = _ask_owners(name, {"node": asked["node"]}, pids, deadline)
        if count > 1:
            return "node %s is in the graph %d times, and any of them may answer" % (
                asked["node"],
                count,
            ), asked
    topic = asked.get("topic")
    for kind, wanted in (("topic", topic and topic["name"]), ("service", asked.get("service"))):
        owners = _ask_owners(name, {kind: wanted}, pids, deadline)[0] if wanted else None
        if owners is not None and owners.others:
            return "%s %s is not yet one of this instance" % (kind, wanted), asked
        if owners is not None and kind == "topic":
            of = participants.list_participants(owners)
            asked = dict(asked, topic=dict(asked["topic"], of=of))
    return "", asked


def ask_helper(name: str, asked: Document, deadline: float, patience_s: float = 0.0) -> str:
    """Ask the helper; its answer, empty for a condition that holds. ``patience_s``: it was just started.

    Raises:
        NoHelperError: there is no helper, or none that answers.
    """
    made = _connect(name, min(deadline, time.monotonic() + patience_s))
    try:
        made.sendall(fast_json.dumps(asked).encode("utf-8"))
        answer = b""
        while True:
            made.settimeout(max(0.01, deadline - time.monotonic()))
            part = made.recv(1 << 16)
            if not part:
                break
            answer += part
    except OSError as error:
        raise NoHelperError("the helper for ROS 2 does not answer in time") from error
    finally:
        made.close()
    if not answer.startswith(b"="):
        raise NoHelperError("the helper for ROS 2 ended")
    return answer[1:].decode("utf-8", "replace")


def _connect(name: str, deadline: float) -> "socket.socket":
    """Connect to the helper of this user. Raises NoHelperError."""
    while True:
        made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            made.connect("\0" + name)
            credentials = made.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
            if struct.unpack("3i", credentials)[1] == os.geteuid():
                return made
        except OSError:
            pass
        made.close()
        if time.monotonic() >= deadline:
            raise NoHelperError(NO_HELPER)
        time.sleep(_RETRY_S)


def ensure_helper(host: str, env: "Mapping[str, str]", setup: "list[str]") -> None:
    """Start the helper where it is not there, in a session of its own; it is not waited for."""
    name = build_helper_name(env, setup)
    if _is_there(name):
        return
    loader: "Any" = sys.modules[__name__].__loader__
    program = loader.read_sources()["edgectl_agent/ros/helper2.py"]
    child = os.fork()
    if child == 0:
        _detach_keeper(host, env, setup, name, program)
    os.waitpid(child, 0)


def _is_there(name: str) -> bool:
    try:
        _connect(name, 0.0).close()
    except NoHelperError:
        return False
    return True


def _detach_keeper(
    host: str, env: "Mapping[str, str]", setup: "list[str]", name: str, program: bytes
) -> "NoReturn":
    """In the first child: a second one in a session of its own, which no supervisor and no login ends."""
    try:
        os.setsid()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if os.fork() == 0:
            spawn.clean_process(())
            _keep_helper(host, env, setup, name, program)
    finally:
        os._exit(0)


def _keep_helper(host: str, env: "Mapping[str, str]", setup: "list[str]", name: str, program: bytes) -> None:
    """Run the helper while tasks live; start it again where it fails."""
    begun, unused, next_look = time.monotonic(), 0, time.monotonic() + _LOOK_S
    pid = _start_helper(env, setup, name, program)
    while unused < 2 or _read_idle_s(name) < _LOOK_S:
        time.sleep(_POLL_S)
        ended, code = os.waitpid(pid, os.WNOHANG)
        if ended and (code == 0 or time.monotonic() - begun < _LOOK_S):
            # Another one has the name, or this one cannot live.
            return
        if ended:
            time.sleep(_REST_S)
            begun, pid = time.monotonic(), _start_helper(env, setup, name, program)
        if time.monotonic() >= next_look:
            next_look = time.monotonic() + _LOOK_S
            entries = status.list_entries(host, None).values()
            lives = any(entry["state"] in protocol.ALIVE_STATES for entry in entries)
            unused = 0 if lives else unused + 1
    os.kill(pid, signal.SIGKILL)


def _read_idle_s(name: str) -> float:
    """Read for how long the helper was not asked; for ever where it does not answer."""
    try:
        return float(ask_helper(name, {"idle": True}, time.monotonic() + _REST_S))
    except (NoHelperError, ValueError):
        return 2 * _LOOK_S


def _start_helper(env: "Mapping[str, str]", setup: "list[str]", name: str, program: bytes) -> int:
    """Start the helper without the marks of any task; it gets its program on standard input."""
    source, source_end = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.dup2(source, 0)
        spawn.close_other_fds({0, 1, 2})
        clean = {key: text for key, text in shell.build_environment(env).items() if key[:8] != "EDGECTL_"}
        argv = protocol.build_sourced_argv(setup, ["python3", "-", name])
        try:
            os.execve(argv[0], argv, clean)  # noqa: S606 - the program is a constant
        finally:
            os._exit(127)
    os.close(source)
    with open(source_end, "wb") as pipe:
        pipe.write(program)
    return pid
