# SPDX-License-Identifier: Apache-2.0
"""Errors of the byte counters against the counters of the interface, for mixes of traffic between a robot and an edge:
``python -m tests.ros.throughput [--window S]`` prints the table of docs/performance.md.

Both are readings of the same probe, so of one window. Publishers are on the robot; what receives on the edge is a task
of edgectl, in a systemd scope where one can be had.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests import network_hosts
from tests.agent.conftest import AgentHost
from tests.agent.user_systemd import can_be_real, user_systemd
from tests.network_hosts import NetworkHost, pair_of_hosts
from tests.pace import patience

ROOT = Path(__file__).parents[2]
PYTHONS = {
    "tcp": sys.executable,
    "fastdds": str(ROOT / ".venv-ros2" / "bin" / "python3"),
    "cyclone": str(ROOT / ".venv-cyclone" / "bin" / "python3"),
}
SHAPE = "qdisc replace dev eth0 root tbf rate 80mbit burst 5kb latency 400ms"
LOOPBACK = "127.0.77.5"
# Until discovery is over, and little of a mix is left to begin.
_SETTLED_S = 60.0


@dataclass(frozen=True)
class Stream:
    """``kind`` of ``traffic.py``; messages of ``size`` bytes at ``rate`` bytes/s."""

    kind: str
    size: int
    rate: float

    def __str__(self) -> str:
        name = {"tcp": "TCP", "fastdds": "Fast DDS", "cyclone": "Cyclone DDS"}[self.kind]
        rate = f"{self.rate / 1e6:g} MB/s" if self.rate >= 1e6 else f"{self.rate / 1e3:g} kB/s"
        return f"{name}, {self.size // 1000} kB, {rate}"


@dataclass(frozen=True)
class Mix:
    """``way``: link, shaped (a link of 80 Mbit/s, which cuts packets as a network card does) or loopback."""

    way: str
    streams: tuple[Stream, ...]

    def __str__(self) -> str:
        return f"{' + '.join(map(str, self.streams))} | {self.way}"


MIXES = (
    Mix("link", (Stream("tcp", 1000, 20e3),)),
    Mix("shaped", (Stream("tcp", 1000, 500e3),)),
    Mix("shaped", (Stream("tcp", 200_000, 5e6),)),
    Mix("loopback", (Stream("tcp", 200_000, 5e6),)),
    Mix("link", (Stream("fastdds", 1000, 20e3),)),
    Mix("shaped", (Stream("fastdds", 1000, 200e3),)),
    Mix("shaped", (Stream("fastdds", 200_000, 5e6),)),
    Mix("link", (Stream("cyclone", 1000, 20e3),)),
    Mix("shaped", (Stream("cyclone", 200_000, 5e6),)),
    Mix(
        "shaped",
        (Stream("tcp", 1000, 200e3), Stream("fastdds", 200_000, 1e6), Stream("cyclone", 1000, 100e3)),
    ),
)
# For make ros.
SHORT = (MIXES[2], MIXES[6], MIXES[7])


@dataclass(frozen=True)
class Result:
    """Bytes/s: of the interface, both ways; of the link as counted; of the tasks in scopes, None without."""

    wire: float
    link: float
    tasks: float | None

    @property
    def error(self) -> float:
        return self.link / self.wire - 1.0

    @property
    def task_error(self) -> float | None:
        return None if self.tasks is None else self.tasks / self.wire - 1.0


def measure_mix(mix: Mix, window_s: float) -> Result:
    """Run ``mix`` between hosts of its own and probe the edge for ``window_s``."""
    folder = Path(tempfile.mkdtemp(prefix="edgectl-throughput-"))
    folder.chmod(0o755)
    os.environ["EDGECTL_STATE_DIR"] = str(folder / "state")
    try:
        with ExitStack() as stack:
            real = can_be_real()
            systemd = stack.enter_context(user_systemd(folder / "systemd", real=True)) if real else None
            edge, robot = stack.enter_context(
                pair_of_hosts(folder / "net", mounts_of=systemd.pid if systemd else 0)
            )
            if mix.way == "shaped":
                for host in (edge, robot):
                    host.run("tc", *SHAPE.split())
            agent = AgentHost("edge1", folder / "state", edge.write_python())
            stack.callback(agent.end)
            address = LOOPBACK if mix.way == "loopback" else robot.address
            return _measure(mix, (edge, robot), agent, address, window_s, scopes=real)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _measure(
    mix: Mix,
    hosts: tuple[NetworkHost, NetworkHost],
    agent: AgentHost,
    address: str,
    window_s: float,
    *,
    scopes: bool,
) -> Result:
    edge, robot = hosts
    links = [{"robot": "robot1", "address": address}]
    agent.ask("counters", action="install", links=links)
    local = mix.way == "loopback"
    sender = edge if local else robot
    # The end of the robot listens on its address only where both ends are on one host.
    target = LOOPBACK if local else edge.address
    with ExitStack() as stack:
        stack.callback(_end_tasks, agent, mix)
        for number, stream in enumerate(mix.streams):
            command = _build_command(stream, "receive", target)
            agent.start(f"sink{number}", f"exec {command}", runtime="systemd" if scopes else "process")
            stack.enter_context(_running(sender, _build_command(stream, "send", target).split()))
        probe = _wait_for_traffic(mix, agent, links)
        probe = agent.ask("probe", window_s=window_s, links=links, timeout=patience(window_s + 30.0))
    name = "lo" if local else "eth0"
    interface, link = probe["interfaces"][name], probe["links"]["robot1"]
    assert (link["source"], link["partial"]) == ("counters", "")
    # What enters lo has left it before: it has every byte twice.
    wire = interface["rx_bytes_per_s"] + (0.0 if local else interface["tx_bytes_per_s"])
    tasks = sum(sum(task["links"].values()) for task in probe["tasks"].values())
    return Result(
        wire, link["rx_bytes_per_s"] + link["tx_bytes_per_s"], tasks if scopes and not local else None
    )


def _build_command(stream: Stream, role: str, address: str) -> str:
    words = [PYTHONS[stream.kind], str(ROOT / "tests" / "ros" / "traffic.py"), stream.kind, role, address]
    return " ".join(["env", "FASTDDS_BUILTIN_TRANSPORTS=UDPv4", *words, str(stream.size), str(stream.rate)])


@contextmanager
def _running(host: NetworkHost, words: Sequence[str]) -> Iterator[None]:
    with subprocess.Popen(host.enter(*words), stdout=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.kill()


def _wait_for_traffic(mix: Mix, agent: AgentHost, links: list[dict[str, str]]) -> dict[str, Any]:
    """Wait until everything that the mix sends is received."""
    expected = 0.8 * sum(stream.rate for stream in mix.streams)
    deadline = time.monotonic() + patience(_SETTLED_S)
    while True:
        probe = agent.ask("probe", window_s=2.0, links=links)
        link = probe["links"]["robot1"]
        if link["rx_bytes_per_s"] + link["tx_bytes_per_s"] >= expected:
            return probe
        assert time.monotonic() < deadline, f"{mix}: only {link}"


def _end_tasks(agent: AgentHost, mix: Mix) -> None:
    for number in range(len(mix.streams)):
        agent.stop(f"sink{number}")


def main() -> int:
    """Print the table; 1 where an error is above 3 %."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--window", type=float, default=10.0, help="of each reading, in s")
    parser.add_argument("--only", type=int, help="number of a mix, from 1")
    options = parser.parse_args()
    if missing := network_hosts.find_missing_for_counters():
        print(f"throughput: {missing}", file=sys.stderr)
        return 1
    print("| mix | way | interface, kB/s | link, kB/s | error | error of the task |")
    print("|---|---|---|---|---|---|")
    worst = 0.0
    for number, mix in enumerate(MIXES, 1):
        if options.only not in (None, number):
            continue
        found = measure_mix(mix, options.window)
        task = "-" if found.task_error is None else f"{found.task_error:+.1%}"
        print(
            f"| {mix} | {found.wire / 1e3:.1f} | {found.link / 1e3:.1f} | {found.error:+.1%} | {task} |",
            flush=True,
        )
        worst = max(worst, abs(found.error), abs(found.task_error or 0.0))
    return 1 if worst > 0.03 else 0


if __name__ == "__main__":
    sys.exit(main())
