# SPDX-License-Identifier: Apache-2.0
"""CPU of a watch over N hosts: ``python -m tests.benchmarks.watched_fleet [N] [SECONDS] [profilers] [loopback]``.

Real SSH servers, each in a network of its own where root runs this, a fifth of them robots, and one task for each of
these. ``edgectl watch --every 1s`` runs as a process of its own; its CPU is that of all its threads, and a host's that of
its server, the login shells and the agents: root counts both by control groups, others by the table of processes. With ``profilers``
a profiler runs on each host; it counts as well. With ``loopback`` the hosts have no networks of their own, so each counts
the packets of all. They always share CPU, memory and the table of processes.
"""

import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from tests.benchmarks.ratios import note_ratio
from tests.faults.cgroup import CpuGroup, create_cgroup
from tests.faults.hosts import wait_for
from tests.faults.network import ManagerNetwork, plug_in_card
from tests.sshd import Lab, running_lab

WARM_UP_S = 15.0
# Each host has two heartbeats in it.
WINDOW_S = 75.0
# Shares of a core: of the manager, and of a host.
MOST_MANAGER, MOST_HOST = 0.03, 0.005
# A view of its own network in /sys, with the control groups that are there already.
_MOUNT = """
mount --bind /sys/fs/cgroup "$0" && mount -t sysfs sysfs /sys && mount --bind "$0" /sys/fs/cgroup && umount "$0" && exec cat
"""
Networks = dict[str, tuple[str, list[str]]]
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def write_files(folder: Path, names: Sequence[str]) -> None:
    """Write the inventory and the tasks of the fleet."""
    edges = "".join(
        f"  {name}: {{host: {name}, capacity: {{cpu: 2, memory: 4Gi}}}}\n"
        for name in names
        if name.startswith("edge")
    )
    robots = "".join(
        f"  {name}: {{host: {name}, capacity: {{cpu: 2, memory: 4Gi}}}}\n"
        for name in names
        if name.startswith("robot")
    )
    (folder / "inventories").mkdir()
    (folder / "inventories" / "lab.yaml").write_text(
        f"version: 1\nfleet: watched\nprobe_links: false\nedges:\n{edges}robots:\n{robots}"
    )
    tasks = "".join(
        f"  task{number}: {{command: sleep 600, robot: {name}, demand: {{cpu: 0.01, memory: 10Mi, throughput: 1kB/s}}}}\n"
        for number, name in enumerate(name for name in names if name.startswith("robot"))
    )
    (folder / "tasks").mkdir()
    (folder / "tasks" / "lab.yaml").write_text(f"version: 1\ntasks:\n{tasks}")


def read_tree_cpu_s(roots: Sequence[int]) -> dict[int, float]:
    """CPU s by root of all that descends from it, with what has ended there."""
    parents, spent = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        pid = int(stat.parent.name)
        parents[pid], spent[pid] = int(fields[1]), sum(int(field) for field in fields[11:15]) / _TICKS_PER_S
    found = dict.fromkeys(roots, 0.0)
    for pid in spent:
        above: int | None = pid
        while above is not None and above not in found:
            above = parents.get(above)
        if above is not None:
            found[above] += spent[pid]
    return found


@contextmanager
def making_groups(count: int) -> Iterator[list[CpuGroup]]:
    """Make as many control groups, which limit nothing; none where this user cannot."""
    with ExitStack() as stack:
        groups = []
        for number in range(count):
            group = create_cgroup(f"edgectl-watched-{os.getpid()}-{number}", float(os.cpu_count() or 1))
            stack.callback(group.remove)
            groups.append(group)
        yield groups if all(group.directories for group in groups) else []


def count_cpu_s(pids: Sequence[int], groups: Sequence[CpuGroup]) -> list[float]:
    """CPU s of all that descends from each process."""
    if groups:
        return [group.read_cpu_s() for group in groups]
    found = read_tree_cpu_s(pids)
    return [found[pid] for pid in pids]


@contextmanager
def making_networks(folder: Path, names: Sequence[str]) -> Iterator[tuple[list[str], Networks]]:
    """Give the manager a network with a bridge, and each host one at that bridge; return the words that enter the
    first, and the address and the words of each host.
    """
    site = ManagerNetwork.make("10.232.0")
    with ExitStack() as stack:
        stack.callback(site.close)
        (folder / "groups").mkdir()
        made: Networks = {}
        for number, name in enumerate(names, start=2):
            command = ["unshare", "--net", "--mount", "sh", "-c", _MOUNT, str(folder / "groups")]
            process = stack.enter_context(
                subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
            )
            wait_for(lambda pid=process.pid: Path(f"/proc/{pid}/comm").read_text() == "cat\n", "a network")  # type: ignore[misc]
            address = f"10.232.0.{number}"
            plug_in_card(f"card{number}", site=site.process.pid, inside=process.pid, address=address)
            made[name] = address, ["nsenter", f"--target={process.pid}", "--net", "--mount"]
        yield site.prefix, made


@contextmanager
def watching(
    folder: Path, enter: Sequence[str], environment: Mapping[str, str] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a watch, after the words that enter its network; it is ended by the signal that an operator would send."""
    with (folder / "output").open("wb") as output:
        command = [*enter, sys.executable, "-m", "edgectl", "watch", "--every", "1s"]
        process = subprocess.Popen(command, cwd=folder, stdout=output, stderr=output, env=environment)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(30)


def count_cycles(folder: Path) -> int:
    """Return the number of cycles, each of which is in the history: a busy machine skips some."""
    (path,) = (folder / "state").rglob("history.db")
    with closing(sqlite3.connect(path)) as connection:
        return int(connection.execute("SELECT count(DISTINCT at) FROM host_samples").fetchone()[0])


def measure(
    lab: Lab, folder: Path, enter: Sequence[str], groups: Sequence[CpuGroup], seconds: float
) -> tuple[float, list[float], float]:
    """Return shares of a core: of the manager, and of each host; and cycles per second."""
    servers = [server.process.pid for server in lab.servers.values() if server.process is not None]
    with watching(folder, enter) as process:
        pids = [process.pid, *servers]
        for pid, group in zip(pids, groups, strict=False):
            for file in group.procs_files:
                Path(file).write_text(str(pid))
        time.sleep(WARM_UP_S)
        cycles = count_cycles(folder)
        before, began = count_cpu_s(pids, groups), time.monotonic()
        time.sleep(seconds)
        after, took = count_cpu_s(pids, groups), time.monotonic() - began
        rate = (count_cycles(folder) - cycles) / took
        said = (folder / "output").read_text()
        assert process.poll() is None, said
        assert "host-lost" not in said, said
    manager, *hosts = [(late - early) / took for early, late in zip(before, after, strict=True)]
    return manager, hosts, rate


def main(words: Sequence[str]) -> int:
    """Print the shares; return 1 if a goal is missed."""
    numbers = [float(word) for word in words if word not in ("profilers", "loopback")]
    count, seconds = int(numbers[0]) if numbers else 64, numbers[1] if len(numbers) > 1 else WINDOW_S
    names = [f"robot{n}" if n % 5 == 0 else f"edge{n}" for n in range(count, 0, -1)]
    with tempfile.TemporaryDirectory(prefix="edgectl-") as directory:
        folder = Path(directory)
        write_files(folder, names)
        with ExitStack() as stack:
            groups = stack.enter_context(making_groups(count + 1))
            enter: list[str] = []
            networks: Networks | None = None
            if os.geteuid() == 0 and "loopback" not in words:
                enter, networks = stack.enter_context(making_networks(folder, names))
            lab = stack.enter_context(running_lab(folder / "lab", names, networks=networks))
            os.environ.update(lab.environment | {"EDGECTL_STATE_DIR": str(folder / "state")})
            if "profilers" in words:
                ask = [*enter, sys.executable, "-m", "edgectl", "profilers", "start", "--every", "1s"]
                subprocess.run(ask, cwd=folder, check=True, capture_output=True)
            manager, hosts, rate = measure(lab, folder, enter, groups, seconds)
    mean = sum(hosts) / len(hosts)
    print(
        f"{count} hosts, {seconds:.0f} s, {rate:.2f} cycles/s: {manager:.2%} of a core here, {1000 * manager / rate:.1f} ms"
        f" a cycle; {mean:.2%} on a host (most {max(hosts):.2%}); by {'control groups' if groups else 'processes'}"
    )
    what = f"watch of {count} hosts each second"
    note_ratio(f"{what}: the manager", manager / MOST_MANAGER, of=f"{MOST_MANAGER:.0%} of a core", most=1.0)
    note_ratio(f"{what}: a host", mean / MOST_HOST, of=f"{MOST_HOST:.1%} of a core", most=1.0)
    return int(manager > MOST_MANAGER or mean > MOST_HOST)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
