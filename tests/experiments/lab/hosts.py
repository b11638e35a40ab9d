# SPDX-License-Identifier: Apache-2.0
"""Hosts for the shipped experiment: computers in namespaces with CPU limits and shaped links, or plain SSH servers on this machine."""

import json
import os
import shlex
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from edgectl.units import parse_bytes
from tests import sshd
from tests.experiments.lab.patrol import PATROL, radio
from tests.faults import cgroup, scan
from tests.faults.hosts import Host, start_loopback_hosts
from tests.faults.namespace_host import NamespaceHost, find_missing_for_namespaces, start_namespace_hosts
from tests.faults.network import ManagerNetwork, run_ip, run_tc

FLEET = yaml.safe_load((PATROL / "fleet.yaml").read_text())
CORES = {
    name: float(entry["capacity"]["cpu"])
    for kind in ("edges", "robots")
    for name, entry in FLEET[kind].items()
}
MEMORY = {
    name: parse_bytes(entry["capacity"]["memory"])
    for kind in ("edges", "robots")
    for name, entry in FLEET[kind].items()
}

# Of a link: the kernel's default. A picture is 53 frames, and a queue that is shorter loses some of each.
QUEUE_FRAMES = 1000


@dataclass(frozen=True, kw_only=True)
class Lab:
    """``site``: the directory with the experiment's files for these hosts. ``prefix``: puts a command where the manager is.

    ``real``: what is as on real hosts; ``wanting``: what could not be had, and why. ``groups``: control groups of the computers and
    of the manager, which come before other processes of this machine.
    """

    site: Path
    hosts: dict[str, Host]
    prefix: list[str] = field(default_factory=list)
    environment: dict[str, str]
    real: str
    wanting: str
    groups: list[cgroup.CpuGroup] = field(default_factory=list)

    def read_cpu_s(self) -> float:
        """CPU seconds of the computers and of the manager so far."""
        return sum(group.read_cpu_s() for group in self.groups)


def missing() -> str:
    """Why there can be no computers with CPU limits here; empty if there can."""
    if why := find_missing_for_namespaces():
        return why
    group = cgroup.create_cgroup(f"edgectl-experiment-{os.getpid()}", 0.5)
    group.remove()
    return group.why


@contextmanager
def lab(directory: Path, *, plain: bool = False) -> Iterator[Lab]:
    """Hosts that are ready for the experiment, and gone afterwards. ``plain``: SSH servers even where computers could be had."""
    why = "asked for plain servers" if plain else missing()
    with ExitStack() as stack:
        if why:
            hosts = stack.enter_context(start_loopback_hosts(directory / "hosts", list(CORES)))
            yield _lab(directory, hosts, [], "SSH servers", f"no CPU limits, no shaped links: {why}")
            return
        network, hosts = stack.enter_context(
            start_namespace_hosts(directory / "hosts", list(CORES), cores=CORES, memory=MEMORY)
        )
        computers = {name: host for name, host in hosts.items() if isinstance(host, NamespaceHost)}
        classes, unshaped = _shape_links(network, computers)
        manager = cgroup.create_cgroup(f"edgectl-experiment-{os.getpid()}", float(os.cpu_count() or 1))
        stack.callback(manager.remove)
        groups = [*(host.group for host in computers.values()), manager]
        for group in groups:
            group.prefer()
        limits = ", ".join(f"{name} {cores:g}" for name, cores in CORES.items())
        links = f"{radio.NEAR} near an edge, else {radio.FAR}" if not unshaped else "any"
        made = _lab(
            directory,
            hosts,
            [*network.prefix, *_enter(manager)],
            f"computers in namespaces, cores: {limits}; links: {links}",
            f"links as they are: {unshaped}" if unshaped else "",
            groups,
        )
        if not unshaped:
            (directory / "radio.json").write_text(json.dumps(classes))
            made.environment["EDGECTL_PATROL_RADIO"] = str(directory / "radio.json")
        yield made


def spent(host: NamespaceHost) -> float:
    """CPU seconds of everything that ever ran on the computer since it was switched on; PID 1 buries the dead and adds theirs."""
    inside = scan.list_processes_in_namespace("pid", Path(f"/proc/{host.pid}/ns/pid").stat().st_ino)
    ticks = 0
    for process in inside:
        with suppress(OSError):
            stat = Path(f"/proc/{process.pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
            ticks += sum(map(int, stat[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


def _shape_links(
    network: ManagerNetwork, computers: dict[str, NamespaceHost]
) -> tuple[dict[str, dict[str, list[list[str]]]], str]:
    """A class of its own for each link and direction, on the cables of both ends; why not, where that cannot be.

    What the manager sends is in the class of the rest, which carries what it is given. Hosts send frames, as over a radio: a
    queue that gets packets of 64 kB carries a tenth of a second of a slow link at once, and its rate cannot be read.
    """
    for computer in computers.values():
        run_ip("link", "set", "eth0", "gso_max_segs", "1", netns=computer.pid)
    classes: dict[str, dict[str, list[list[str]]]] = {robot: {} for robot in FLEET["robots"]}
    for kind, others in (("edges", "robots"), ("robots", "edges")):
        for name in FLEET[kind]:
            device = computers[name].cable
            rest = f"class add dev {device} parent 1: classid 1:1 htb rate 1gbit quantum 60000"
            rules = [f"qdisc add dev {device} root handle 1: htb default 1", rest]
            for number, other in enumerate(FLEET[others], start=0x10):
                place = f"1:{number:x}"
                edge, robot = (name, other) if kind == "edges" else (other, name)
                classes[robot].setdefault(edge, []).append([device, place])
                rules += [
                    f"class add dev {device} parent 1: classid {place} htb rate {radio.NEAR} burst 16k",
                    f"qdisc add dev {device} parent {place} pfifo limit {QUEUE_FRAMES}",
                    f"filter add dev {device} parent 1: protocol ip u32 match ip src {computers[other].address}/32 flowid {place}",
                ]
            for rule in rules:
                if why := run_tc(*rule.split(), netns=network.process.pid):
                    return {}, why
    return classes, ""


def _enter(group: cgroup.CpuGroup) -> list[str]:
    """Prefix of a command that runs it in the control group."""
    orders = "".join(f"echo $$ >{shlex.quote(file)}; " for file in group.procs_files)
    return ["sh", "-c", f'{orders}exec "$@"', "manager"]


def _lab(
    directory: Path,
    hosts: dict[str, Host],
    prefix: list[str],
    real: str,
    wanting: str,
    groups: Sequence[cgroup.CpuGroup] = (),
) -> Lab:
    for host in hosts.values():
        _copy_programs(host.home)
    site = directory / "site"
    site.mkdir()
    for name in ("experiment.yaml", "tasks.yaml", "world.pgm", "world.yaml"):
        shutil.copy(PATROL / name, site / name)
    (site / "fleet.yaml").write_text(json.dumps(_fleet(hosts, whole=bool(prefix)), indent=1))
    return Lab(
        site=site,
        hosts=hosts,
        prefix=prefix,
        environment=_environment(directory, hosts),
        real=real,
        wanting=wanting,
        groups=list(groups),
    )


def _copy_programs(home: Path) -> None:
    """To where the prelude of these hosts leads, as their user's own."""
    target, owner = home / "experiment" / "tasks" / "patrol", home.stat()
    target.mkdir(parents=True)
    for program in PATROL.glob("*.py"):
        shutil.copy(program, target / program.name)
    for path in (home / "experiment", *(home / "experiment").rglob("*")):
        os.chown(path, owner.st_uid, owner.st_gid)


def _fleet(hosts: dict[str, Host], *, whole: bool) -> dict[str, Any]:
    """The shipped fleet at the addresses of these hosts; a ``whole`` computer shows itself how much it has."""
    found = {**FLEET, "defaults": {"prelude": 'cd "$HOME/experiment"'}}
    for kind in ("edges", "robots"):
        found[kind] = {name: {**entry, **_way(hosts[name])} for name, entry in FLEET[kind].items()}
        for entry in found[kind].values() if whole else ():
            del entry["capacity"]
    return found


def _way(host: Host) -> dict[str, object]:
    address, port, user, _ = host.login
    return {"host": address, "port": port, "user": user}


def _environment(directory: Path, hosts: dict[str, Host]) -> dict[str, str]:
    """What edgectl needs to find and to know the hosts, with a home and a state of its own."""
    known = []
    for host in hosts.values():
        address, port, _, key = host.login
        known.append(f"{address if port == 22 else f'[{address}]:{port}'} {key}\n")
    (directory / "known_hosts").write_text("".join(known))
    options = {
        "IdentityFile": directory / "hosts" / "user_key",
        "IdentitiesOnly": "yes",
        "IdentityAgent": "none",
        "GlobalKnownHostsFile": "none",
        "UserKnownHostsFile": directory / "known_hosts",
    }
    (directory / "ssh_config").write_text(
        "Host *\n" + "".join(f"  {name} {value}\n" for name, value in options.items())
    )
    (directory / "home").mkdir()
    own = {name: value for name, value in os.environ.items() if not name.startswith("EDGECTL_")}
    return own | {
        "PATH": f"{own.get('PATH', os.defpath)}:{sshd.PATH}",
        "HOME": str(directory / "home"),
        "EDGECTL_STATE_DIR": str(directory / "state"),
        "EDGECTL_SSH_CONFIG": str(directory / "ssh_config"),
    }
