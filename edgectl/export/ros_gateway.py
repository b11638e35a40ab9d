# SPDX-License-Identifier: Apache-2.0
"""Process of the node that publishes the state of the fleet in ROS: its environment, its input, its end.

Nothing of ROS is imported here: ``ros_node.py`` is sent as text to the ``python3`` of the set-up files
([ADR 94](docs/adr/0094-publish-in-ros-from-a-child-process.md)).
"""

import contextlib
import json
import os
import re
import select
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from io import FileIO
from pathlib import Path

from edgectl.agent.link.protocol import build_sourced_argv
from edgectl.errors import EdgectlError, FileError, RosGraphError
from edgectl.formats.document import Document
from edgectl.model.ros import HOST_ADDRESS, RosSettings

STATUS_TOPIC = "/edgectl/status"
# How long a node may take to be there, its master to answer, one line to be read, and a goodbye.
_READY_S, _MASTER_S, _SEND_S, _END_S = 40.0, 10.0, 10.0, 5.0
_ADDRESS_VARIABLES = ("ROS_IP", "ROS_HOSTNAME")


class RosNode:
    """The node, as its parent sees it."""

    def __init__(self, process: "subprocess.Popen[bytes]", source: int, reports: int) -> None:
        self._process, self._input, self._reports = process, source, reports

    def send(self, document: Document) -> None:
        """Have this published from now on.

        Raises:
            RosGraphError: its master does not answer, or was restarted.
            EdgectlError: the node has ended, or does not read.
        """
        target, left = self._input, memoryview(json.dumps(document).encode() + b"\n")
        until = time.monotonic() + _SEND_S
        while left:
            readable, writable, _ = select.select(
                [self._reports], [target], [], max(0.0, until - time.monotonic())
            )
            if readable:
                self._raise_fault(self._read_report())
            if not writable:
                raise EdgectlError(f"the ROS node has read nothing for {_SEND_S:g} s", hint=_AGAIN)
            with contextlib.suppress(BlockingIOError, BrokenPipeError):
                left = left[os.write(target, left) :]

    def wait(self, seconds: float) -> None:
        """Wait, and raise what ``send`` raises as soon as the node fails."""
        if select.select([self._reports], [], [], max(0.0, seconds))[0]:
            self._raise_fault(self._read_report())

    def wait_until_ready(self) -> None:
        """Wait until it is in the graph; raises what ``send`` raises."""
        if not select.select([self._reports], [], [], _READY_S)[0]:
            raise EdgectlError(
                f"the ROS node is not there within {_READY_S:g} s",
                hint="look at what it and its set-up files print",
            )
        report = self._read_report()
        if report[0] != "ready":
            self._raise_fault(report)

    def _read_report(self) -> Sequence[str]:
        try:
            kind, text = json.loads(os.read(self._reports, 1 << 16).splitlines()[0])
        except (ValueError, IndexError):
            return "", ""
        return str(kind), str(text)

    def _raise_fault(self, report: Sequence[str]) -> None:
        kind, text = report
        if kind == "no-ros":
            raise EdgectlError(
                f"no ROS for the gateway: {text}",
                hint="state the set-up files of this machine: --setup /opt/ros/DISTRO/setup.bash; "
                "it needs the packages std_msgs and diagnostic_msgs",
            )
        if kind == "no-master":
            raise RosGraphError(
                f"the ROS master at {text} has not answered for {_MASTER_S:g} s",
                hint="start roscore, or state ros: {master: ..} in the inventory",
            )
        if kind == "forgotten":
            raise RosGraphError(
                f"the ROS master at {text} was restarted: it does not know the gateway", hint=_AGAIN
            )
        if kind == "failed":
            raise EdgectlError(f"the ROS node failed: {text}", hint=_AGAIN)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        raise EdgectlError(
            f"the ROS node ended with exit code {self._process.returncode}",
            hint="look at what it printed above",
        )


_AGAIN = "run edgectl export ros again"


@contextlib.contextmanager
def run_ros_node(
    fleet: str,
    ros: RosSettings | None,
    *,
    setup: Sequence[str] | None = None,
    peers: Sequence[str] = (),
    stale_s: float,
) -> Iterator[RosNode]:
    """Run the node within the block; it publishes what it is sent once a second, for ``stale_s`` at most.

    ``ros``: set-up files and graph; None: those of this environment. ``setup``: files in place of those.
    ``peers``: addresses that it must reach.

    Raises:
        FileError: a set-up file cannot be read.
        RosGraphError: no master answers.
        EdgectlError: there is no ROS, or the node failed.
    """
    if not setup:
        setup = ros.setup if ros is not None else ()
    files = [_check_setup_file(path) for path in setup]
    with contextlib.ExitStack() as stack:
        reports, reports_end = map(stack.enter_context, _open_pipe())
        source_end, source = map(stack.enter_context, _open_pipe())
        os.set_blocking(source.fileno(), False)
        asked = {
            "report_fd": reports_end.fileno(),
            "name": "edgectl_" + re.sub(r"[^A-Za-z0-9_]", "_", fleet),
            "version": ros.version if ros is not None else None,
            "topic": STATUS_TOPIC,
            "master_s": _MASTER_S,
            "stale_s": stale_s,
        }
        argv, env = build_node_argv(files, asked), build_node_environment(ros, peers)
        process = _start_node(argv, env, source_end.fileno(), reports_end.fileno())
        # In reverse order: its input is closed, then its end is waited for.
        stack.callback(_end_node, process)
        stack.callback(source.close)
        source_end.close()
        reports_end.close()
        node = RosNode(process, source.fileno(), reports.fileno())
        node.wait_until_ready()
        yield node


def _open_pipe() -> tuple[FileIO, FileIO]:
    """The end to read from, and the one to write to."""
    reader, writer = os.pipe()
    return FileIO(reader, "r"), FileIO(writer, "w")


def build_node_argv(setup: Sequence[str], asked: Document) -> list[str]:
    """The command of the node; only bash can source set-up files."""
    program = Path(__file__).with_name("ros_node.py").read_text(encoding="utf-8")
    command = ["python3", "-c", program, json.dumps(asked)]
    return build_sourced_argv(list(setup), command) if setup else command


def build_node_environment(ros: RosSettings | None, peers: Sequence[str]) -> dict[str, str]:
    """The environment of edgectl with what follows from ``ros``; an address that it states is kept."""
    derived = dict(ros.derive_variables()) if ros is not None else {}
    if any(name in os.environ for name in _ADDRESS_VARIABLES):
        derived = {name: value for name, value in derived.items() if name not in _ADDRESS_VARIABLES}
    if any(f"{{{HOST_ADDRESS}}}" in value for value in derived.values()):
        derived = _fill_own_address(derived, find_own_address(peers))
    return {**os.environ, **derived}


def _fill_own_address(derived: Mapping[str, str], own: str | None) -> dict[str, str]:
    """Variables that need an address which is not known are left out."""
    place = f"{{{HOST_ADDRESS}}}"
    known = {name: value for name, value in derived.items() if own is not None or place not in value}
    return {name: value.replace(place, own or "") for name, value in known.items()}


def find_own_address(peers: Sequence[str]) -> str | None:
    """The address from which packets to the first of ``peers`` leave that has an address; none are sent."""
    for peer in peers:
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
            made.connect((peer, 9))
            return str(made.getsockname()[0])
    return None


def _check_setup_file(path: str) -> str:
    found = str(Path(path).expanduser().absolute())
    if not os.access(found, os.R_OK):
        raise FileError(
            f"set-up file {path} cannot be read on this machine",
            hint="state the files of this machine: --setup /opt/ros/DISTRO/setup.bash",
        )
    return found


def _start_node(
    argv: Sequence[str], env: Mapping[str, str], source: int, reports: int
) -> "subprocess.Popen[bytes]":
    """Start it in a session of its own: Ctrl-C is for edgectl, which ends it."""
    try:
        return subprocess.Popen(
            argv, stdin=source, stdout=2, env=env, pass_fds=[reports], start_new_session=True
        )
    except OSError as error:
        raise EdgectlError(
            f"cannot run {argv[0]}: {error.strerror}", hint="install it on this machine"
        ) from error


def _end_node(process: "subprocess.Popen[bytes]") -> None:
    """Wait for its end, as its input has ended; kill what is left of it."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_END_S)
    with contextlib.suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
