# SPDX-License-Identifier: Apache-2.0
"""Two computers in network namespaces and their manager, with a slow line between them (root)."""

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from edgectl.model.ros import RosSettings
from tests.builders import an_edge, an_inventory
from tests.e2e.bench import Bench, a_slice, open_bench
from tests.faults.hosts import Host
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.namespace_host import USER, start_namespace_hosts
from tests.faults.network import ManagerNetwork
from tests.faults.relay import Relay

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


@dataclass(frozen=True)
class Computers:
    """``address``: of the manager's network. ``bench``: the manager, who reaches the computers over slow lines."""

    address: str
    hosts: Mapping[str, Host]
    bench: Bench


@contextmanager
def open_computers(
    folder: Path,
    delay_ms: float,
    *,
    ros: RosSettings | None = None,
    shared: Mapping[str, Path] | None = None,
) -> Iterator[Computers]:
    """Start both and join their network. ``shared``: directories of this machine that they have too."""
    with ExitStack() as stack:
        site, hosts = stack.enter_context(start_namespace_hosts(folder, list(NAMES), shared=shared))
        enter_network(site)
        lines = {
            name: stack.enter_context(slow_line(host.login[:2], delay_ms)) for name, host in hosts.items()
        }
        write_ssh_config(folder, hosts, lines)
        edges = (a_slice(replace(an_edge(name), host=name, ros=ros)) for name in NAMES)
        bench = stack.enter_context(open_bench(an_inventory(*edges), folder / "manager", folder / "none"))
        yield Computers(f"{site.network}.1", hosts, bench)


def copy_program(host: Host, program: str, name: str) -> None:
    """Give a computer a program of the tests, as ``name`` in the home of its user."""
    place = host.home / name
    place.write_text(Path(program).read_text())
    place.chmod(0o644)
