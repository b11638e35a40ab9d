"""Measure warm moves over real SSH between two computers in network namespaces, with a line of 2 ms each way (root).

    .venv/bin/python -m tests.handoffs --moves 200

Prints the gap at the subscriber, which is where the manager is, and how often two instances were active at once.
"""

import argparse
import ctypes
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from edgectl.model.task import Task
from tests.builders import an_edge, an_inventory
from tests.e2e.bench import a_slice, open_bench
from tests.faults.hosts import Host
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.namespace_host import (
    USER,
    find_missing_for_namespaces,
    start_namespace_hosts,
)
from tests.faults.network import ManagerNetwork
from tests.faults.relay import Relay
from tests.handoffs import node
from tests.handoffs.scene import Scene, a_node_task
from tests.handoffs.subscriber import Message, count_overlaps, list_gaps_ms, listen

NAMES = ("edge1", "edge2")
_CLONE_NEWNET = 0x40000000


def enter_network(site: ManagerNetwork) -> None:
    """Join the network of the manager; threads that are started from now on are in it too."""
    with site.netns.open() as file:
        failed = ctypes.CDLL(None, use_errno=True).setns(file.fileno(), _CLONE_NEWNET)
    assert not failed, os.strerror(ctypes.get_errno())


@contextmanager
def slow_line(target: tuple[str, int], delay_ms: float) -> Iterator[tuple[str, int]]:
    """A line to ``target`` that takes ``delay_ms`` each way. A relay: few kernels have netem."""
    relay = Relay(target, address="0.0.0.0")
    relay.start()
    try:
        relay.set(LinkFault(kind=LinkFaultKind.DELAY, seconds=delay_ms / 1e3))
        yield "127.0.0.1", relay.port
    finally:
        relay.stop()


def write_ssh_config(folder: Path, hosts: Mapping[str, Host], lines: Mapping[str, tuple[str, int]]) -> None:
    """Let this process find the hosts over ``lines``, and put its own files into ``folder``."""
    known, blocks = "", ""
    for name, host in hosts.items():
        address, port = lines[name]
        known += f"[{address}]:{port} {host.login[3]}\n"
        blocks += f"Host {name}\n  HostName {address}\n  Port {port}\n  User {USER}\n"
    (folder / "known_hosts").write_text(known)
    common = f"  IdentityFile {folder / 'user_key'}\n  IdentitiesOnly yes\n  IdentityAgent none\n"
    files = f"  UserKnownHostsFile {folder / 'known_hosts'}\n  GlobalKnownHostsFile none\n"
    (folder / "ssh_config").write_text(f"{blocks}Host *\n{common}{files}")
    os.environ["EDGECTL_SSH_CONFIG"] = str(folder / "ssh_config")
    os.environ["HOME"] = str(folder)
    for kind in ("STATE", "CACHE", "CONFIG", "DATA"):
        os.environ[f"XDG_{kind}_HOME"] = str(folder / kind.lower())


@contextmanager
def open_scene(folder: Path, delay_ms: float) -> Iterator[Scene]:
    """Two computers, a manager, and a subscriber beside it; each computer has a line to both."""
    with ExitStack() as stack:
        site, hosts = stack.enter_context(start_namespace_hosts(folder, list(NAMES)))
        enter_network(site)
        subscriber = stack.enter_context(listen("127.0.0.1"))
        lines = {
            name: stack.enter_context(slow_line(host.login[:2], delay_ms)) for name, host in hosts.items()
        }
        far = stack.enter_context(slow_line((subscriber.address, subscriber.port), delay_ms))
        write_ssh_config(folder, hosts, lines)
        inventory = an_inventory(*(a_slice(replace(an_edge(name), host=name)) for name in NAMES))
        bench = stack.enter_context(open_bench(inventory, folder / "manager", folder / "none"))
        for host in hosts.values():
            shutil.copy(node.__file__, host.home / "node.py")
            (host.home / "node.py").chmod(0o644)
        yield Scene(bench, NAMES, place_node((f"{site.network}.1", far[1])), subscriber)


def place_node(subscriber: tuple[str, int]) -> Task:
    """The task as it is on computers that do not have this repository."""
    task = a_node_task(Path(f"/home/{USER}/handoff"), *subscriber)
    return replace(task, command=task.command.replace(node.__file__, f"/home/{USER}/node.py"))


def measure_moves(scene: Scene, moves: int) -> tuple[list[float], list[float]]:
    """Make ``moves`` warm moves; each gap at the subscriber and each downtime by the manager's clock, in ms."""
    scene.start()
    downtimes = []
    for number in range(moves):
        (action,) = scene.move().actions
        downtimes.append(1e3 * (action.downtime_s or 0.0))
        if number % 20 == 19:
            print(f"{number + 1} moves, {describe_spread(downtimes)} by the manager", flush=True)
    return list_gaps_ms(scene.subscriber.take()), downtimes


def describe_spread(values_ms: Sequence[float]) -> str:
    ranked = sorted(values_ms)
    picks = {name: ranked[min(len(ranked) - 1, int(share * len(ranked)))] for name, share in _SHARES.items()}
    return ", ".join(f"{name} {value:.1f} ms" for name, value in picks.items())


_SHARES = {"p50": 0.5, "p95": 0.95, "p99": 0.99, "most": 1.0}


def describe_messages(messages: Sequence[Message], moves: int) -> str:
    return f"{len(messages)} messages, {count_overlaps(messages, moves)} times two active"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moves", type=int, default=200)
    parser.add_argument("--delay", type=float, default=2.0, help="of a line, in ms, each way")
    options = parser.parse_args()
    if why := find_missing_for_namespaces():
        raise SystemExit(f"cannot measure here: {why}")
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="edgectl-handoffs-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        with open_scene(folder, options.delay) as scene:
            gaps, downtimes = measure_moves(scene, options.moves)
            messages = scene.subscriber.take()
    print(f"{options.moves} warm moves of a TCP task, lines of {options.delay:g} ms each way")
    print(f"gap at the subscriber: {describe_spread(gaps)}")
    print(f"downtime by the manager: {describe_spread(downtimes)}")
    print(f"{describe_messages(messages, options.moves)}; {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
