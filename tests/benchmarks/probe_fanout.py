# SPDX-License-Identifier: Apache-2.0
"""Probe of N real hosts against parallel ssh processes that run the same agent: ``python -m
tests.benchmarks.probe_fanout [N ..]``.

Every host is an OpenSSH server with its own key and home on this machine. Both sides check host keys, log in
with the same key, run the same command line with the same standard input, at most 32 hosts at a time. Imports
are measured separately; the agent is on the hosts already, and what ssh says of its configuration is kept as every
command keeps it. Runs of the two sides alternate, and each pair
gives one ratio, so that other load on the machine affects both.
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

IMPORTS_FROM = time.perf_counter()
from edgectl.errors import ConnectError  # noqa: E402
from edgectl.gateway.host_probe import ProbeOptions, probe_hosts  # noqa: E402
from edgectl.model.inventory import Connection, Host, Inventory, Role  # noqa: E402
from edgectl.model.snapshot import HostStatus, Snapshot  # noqa: E402
from edgectl.model.task import Tasks  # noqa: E402
from edgectl.transport import agent_client as protocol  # noqa: E402
from edgectl.transport.base import Reply, Transport  # noqa: E402
from edgectl.transport.connections import SessionPool  # noqa: E402
from edgectl.transport.fake import FakeSession, FakeTransport  # noqa: E402
from edgectl.transport.local import LocalTransport  # noqa: E402
from edgectl.transport.ssh import SshTransport  # noqa: E402
from edgectl.transport.ssh_config import SshConfigResolver  # noqa: E402
from edgectl.transport.ssh_session import SshSession  # noqa: E402

IMPORTS_S = time.perf_counter() - IMPORTS_FROM

from tests.benchmarks.ratios import note_ratio  # noqa: E402
from tests.sshd import Lab, running_lab  # noqa: E402

SIZES = (3, 16, 64, 256)
WARM = 64
AT_ONCE = 32
COLD_GOAL, WARM_GOAL = 1.15, 1.3
OPTIONS = ProbeOptions(timeout=60.0, window=0.0, workers=AT_ONCE)
SSH = ("ssh", "-o", "BatchMode=yes", "-o", "KexAlgorithms=curve25519-sha256", "-o", "LogLevel=ERROR")


class _Recorder(FakeTransport):
    """Records the requests of a probe."""

    def __init__(self) -> None:
        super().__init__({})
        self.packets: list[bytes] = []

    def connect(self, host: Host, *, timeout: float) -> FakeSession:
        recorder = self

        class Session(FakeSession):
            def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
                recorder.packets.append(stdin)
                raise ConnectError("recorded")

        return Session(host.name, dict, lambda *_: None)


def record_request(inventory: Inventory) -> bytes:
    """Return the standard input that a probe sends to the first host of ``inventory``; only the host's name
    differs between hosts.
    """
    recorder = _Recorder()
    probe_hosts(inventory, Tasks(tasks={}), recorder, options=OPTIONS)
    return recorder.packets[0]


def run_edgectl_probe(inventory: Inventory, transport: Transport) -> Snapshot:
    snapshot = probe_hosts(inventory, Tasks(tasks={}), transport, options=OPTIONS)
    silent = [
        f"{name}: {sample.error}"
        for name, sample in snapshot.hosts.items()
        if sample.status is not HostStatus.OK
    ]
    assert not silent, silent[:3]
    return snapshot


def run_plain_ssh(lab: Lab, names: Sequence[str], stdin: Path, out: Path) -> None:
    """Run ``ssh`` for each host, 32 at a time, through xargs: the lower bound for any tool on top of OpenSSH."""
    command = protocol.build_agent_command("python3")
    script = f'exec {" ".join(SSH)} -F {lab.ssh_config} "$1" "$COMMAND" < {stdin} > {out}/"$1"'
    arguments = ["xargs", "-P", str(AT_ONCE), "-n", "1", "sh", "-c", script, "sh"]
    subprocess.run(
        arguments, input="\n".join(names), text=True, env=os.environ | {"COMMAND": command}, check=True
    )
    assert all(b"edgectl-frame" in (out / name).read_bytes() for name in names)


def run_bare_channels(sessions: Sequence[SshSession], stdin: bytes) -> None:
    """Run the same commands on paramiko channels of the same connections, without any other work."""

    def one(session: SshSession) -> bytes:
        channel = session.transport.open_session()
        channel.exec_command(protocol.build_agent_command("python3"))
        channel.sendall(stdin)
        channel.shutdown_write()
        data = b""
        while piece := channel.recv(65536):
            data += piece
        channel.close()
        return data

    with ThreadPoolExecutor(AT_ONCE) as pool:
        assert all(b"edgectl-frame" in data for data in pool.map(one, sessions))


def measure_pairs(
    ours: Callable[[], object], theirs: Callable[[], object], rounds: int
) -> tuple[float, float, float]:
    """Return the median seconds of both and the median ratio of ``rounds`` alternating pairs."""
    times = []
    for turn in range(rounds):
        first, second = (ours, theirs) if turn % 2 else (theirs, ours)
        seconds = {first: measure_time(first), second: measure_time(second)}
        times.append((seconds[ours], seconds[theirs]))
    middle = [statistics.median(column) for column in zip(*times, strict=True)]
    return middle[0], middle[1], statistics.median(mine / other for mine, other in times)


def measure_time(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def measure_agent_cost() -> float:
    """Return the CPU seconds of the agent per probe, interpreter included (the least of eight)."""
    host = Host(name="here", role=Role.EDGE, host="localhost", connection=Connection.LOCAL)
    fleet = Inventory(hosts={host.name: host})
    spent = []
    for _ in range(8):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        run_edgectl_probe(fleet, LocalTransport())
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(spent)


def measure_cold(lab: Lab, sizes: Sequence[int], out: Path) -> bool:
    print("probe of N hosts, new connections")
    print(
        f"{'N':>5} {'edgectl s':>10} {'ssh s':>8} {'ratio':>6} {'goal':>5} {'ms/host':>8} {'client CPU ms/host':>19}"
    )
    met = [print_cold_row(lab, list(lab.servers)[:size], out) for size in sizes]
    return all(met)


def print_cold_row(lab: Lab, names: Sequence[str], out: Path) -> bool:
    """Measure and print one N; return whether its goal is met."""
    size = len(names)
    fleet = Inventory(hosts={name: lab.host(name) for name in names})
    stdin = out / "stdin"
    stdin.write_bytes(record_request(fleet))
    resolver = partial(SshConfigResolver, out / "ssh-config.json")
    run_edgectl_probe(fleet, SshTransport(resolver=resolver()))  # installs the agent on hosts that lack it
    rounds = 7 if size <= 16 else 5 if size <= 64 else 3
    cpu = time.process_time()
    ours, theirs, ratio = measure_pairs(
        lambda: run_edgectl_probe(fleet, SshTransport(resolver=resolver())),
        lambda: run_plain_ssh(lab, names, stdin, out),
        rounds,
    )
    cpu = (time.process_time() - cpu) / rounds / size
    print(
        f"{size:>5} {ours:>10.3f} {theirs:>8.3f} {ratio:>6.2f} {COLD_GOAL:>5} {ours / size * 1000:>8.1f} {cpu * 1000:>19.1f}",
        flush=True,
    )
    note_ratio(f"probe of {size} hosts, new connections", ratio, of="ssh with the same agent", most=COLD_GOAL)
    return ratio <= COLD_GOAL


def measure_warm(lab: Lab, out: Path) -> bool:
    names = list(lab.servers)[:WARM]
    fleet = Inventory(hosts={name: lab.host(name) for name in names})
    transport = SshTransport()
    with SessionPool(transport) as pool:
        run_edgectl_probe(fleet, pool)
        sessions = [transport.connect(host, timeout=30) for host in fleet.hosts.values()]
        try:
            stdin = record_request(fleet)
            ours, theirs, ratio = measure_pairs(
                lambda: run_edgectl_probe(fleet, pool), lambda: run_bare_channels(sessions, stdin), 9
            )
        finally:
            for session in sessions:
                session.close()
    print(
        f"probe of {len(names)} hosts on open connections: {ours:.3f} s, bare channels {theirs:.3f} s, ratio {ratio:.2f} (goal {WARM_GOAL})"
    )
    note_ratio(f"probe of {len(names)} hosts, open connections", ratio, of="bare channels", most=WARM_GOAL)
    return ratio <= WARM_GOAL


def main(arguments: Sequence[str]) -> int:
    sizes = [int(text) for text in arguments] or list(SIZES)
    print(f"imports (edgectl, fabric, paramiko): {IMPORTS_S * 1000:.0f} ms")
    with tempfile.TemporaryDirectory() as directory:
        out = Path(directory) / "out"
        out.mkdir()
        count = max(*sizes, WARM)
        with running_lab(Path(directory) / "lab", [f"edge{n}" for n in range(1, count + 1)]) as lab:
            os.environ.update(lab.environment)
            good = measure_cold(lab, sizes, out)
            good &= measure_warm(lab, out)
        os.environ["EDGECTL_STATE_DIR"] = str(out / "state")
        print(f"the agent, per host and probe: {measure_agent_cost() * 1000:.0f} ms CPU of the host")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
