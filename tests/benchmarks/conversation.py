# SPDX-License-Identifier: Apache-2.0
"""Requests by an agent that stays against calls: ``python -m tests.benchmarks.conversation [REQUESTS]``.

Real SSH servers on loopback. Both ways take turns; CPU of this process, and of the hosts' side: the servers, the
login shells and the agents. The cost of the pulses is that of a while without requests, less the same without
a conversation.
"""

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from edgectl.agent.link import frames
from edgectl.model.inventory import Connection
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Session
from edgectl.transport.conversation import ConversingSession
from edgectl.transport.fleet_transport import FleetTransport
from tests.benchmarks.ratios import note_ratio
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.relay import Relay
from tests.sshd import Server, _list_descendants, running_lab

REQUESTS: dict[str, dict[str, object]] = {
    "status": {"op": "status", "task": None},
    "probe, without a sample window": {"op": "probe", "window_s": 0.0},
}
# Of the line to a far host, each way.
FAR_S = 0.1
IDLE_S, PULSED_HOSTS = 5.0, 32
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def read_server_cpu_s(server: Server) -> float:
    """CPU of all that runs below a server, with what has ended there."""
    assert server.process is not None
    total = 0
    for pid in _list_descendants(server.process.pid):
        try:
            fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        except OSError:
            continue
        total += sum(int(field) for field in fields[11:15])
    return total / _TICKS_PER_S


def ask(session: Session, request: Mapping[str, object]) -> None:
    call_agent(session, {"fleet": "lab", "host": "edge1", **request}, timeout=60.0)


def converse(session: ConversingSession) -> None:
    """Ask until the agent that stays answers."""
    while session._conversation is None or not session._conversation._open:
        ask(session, REQUESTS["status"])
        time.sleep(0.05)


def measure_requests(count: int) -> None:
    print("| connection | request | call, ms | shared, ms | CPU here, ms | on the host, ms |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder, running_lab(Path(folder), ["edge1"]) as lab:
        os.environ.update(lab.environment)
        server = lab["edge1"]
        for connection in (Connection.SSH, Connection.OPENSSH):
            transport = FleetTransport()
            plain = transport.connect(lab.host("edge1", connection=connection), timeout=30)
            within = transport.connect(lab.host("edge1", connection=connection), timeout=30)
            with plain, ConversingSession(within) as shared:  # type: ignore[arg-type]
                converse(shared)
                for name, request in REQUESTS.items():
                    times: dict[str, list[float]] = {"call": [], "shared": []}
                    here, there = dict.fromkeys(times, 0.0), dict.fromkeys(times, 0.0)
                    for session in (plain, shared):
                        ask(session, request)
                    for _ in range(count // 5):
                        for way, session in (("call", plain), ("shared", shared)):
                            cpu, host = time.process_time(), read_server_cpu_s(server)
                            for _ in range(5):
                                began = time.monotonic()
                                ask(session, request)
                                times[way].append(time.monotonic() - began)
                            here[way] += time.process_time() - cpu
                            there[way] += read_server_cpu_s(server) - host
                    assert shared._conversation is not None
                    assert not shared._conversation.is_over
                    medians = [f"{1000 * statistics.median(each):.1f}" for each in times.values()]
                    spent = [
                        f"{1000 * each['call'] / count:.1f}, {1000 * each['shared'] / count:.1f}"
                        for each in (here, there)
                    ]
                    print(f"| `{connection}` | {name} | {' | '.join([*medians, *spent])} |", flush=True)
                    note_costs(f"{name}, by an agent that stays, {connection}", times, here, there)


def note_costs(
    what: str, times: Mapping[str, list[float]], here: Mapping[str, float], there: Mapping[str, float]
) -> None:
    """Note what of a call a shared request takes: it must be less."""
    wall = statistics.median(times["shared"]) / statistics.median(times["call"])
    note_ratio(f"{what}: time", wall, of="a call", most=1.0)
    note_ratio(f"{what}: CPU of the manager", here["shared"] / here["call"], of="a call", most=1.0)
    if there["call"] > there["shared"]:
        # Servers of calls that end with each connection are not seen.
        note_ratio(f"{what}: CPU of the host", there["shared"] / there["call"], of="a call", most=1.0)


def measure_far_host() -> None:
    """Time of a request over a line with a delay."""
    with tempfile.TemporaryDirectory() as folder, running_lab(Path(folder), ["edge1"]) as lab:
        os.environ.update(lab.environment)
        server = lab["edge1"]
        relay = Relay((server.address, server.port))
        relay.start()
        try:
            lab.known_hosts.write_text(f"[127.0.0.1]:{relay.port} {server.key}\n")
            host, transport = lab.host("edge1", host="127.0.0.1", port=relay.port), FleetTransport()
            plain, within = transport.connect(host, timeout=30), transport.connect(host, timeout=30)
            with plain, ConversingSession(within) as shared:  # type: ignore[arg-type]
                converse(shared)
                relay.set(LinkFault(kind=LinkFaultKind.DELAY, seconds=FAR_S))
                medians = []
                # The shared one first: an agent that nobody asks ends.
                for session in (shared, plain):
                    times = []
                    for _ in range(10):
                        began = time.monotonic()
                        ask(session, REQUESTS["status"])
                        times.append(time.monotonic() - began)
                    medians.append(1000 * statistics.median(times))
        finally:
            relay.stop()
    note_ratio(f"status over {1000 * FAR_S:.0f} ms each way", medians[0] / medians[1], of="a call", most=0.5)
    print(f"\nA status over {1000 * FAR_S:.0f} ms each way: {medians[1]:.0f} ms, shared {medians[0]:.0f} ms.")


def measure_pulses() -> None:
    """CPU of one pulse, here and on a host."""
    names = [f"edge{number}" for number in range(PULSED_HOSTS)]
    with tempfile.TemporaryDirectory() as folder, running_lab(Path(folder), names) as lab:
        os.environ.update(lab.environment)
        transport = FleetTransport()
        found = [transport.connect(lab.host(name), timeout=30) for name in names]
        shared = [ConversingSession(each) for each in found]  # type: ignore[arg-type]
        spent = []
        for conversing in (False, True):
            for each in shared if conversing else ():
                converse(each)
            cpu, host = time.process_time(), sum(read_server_cpu_s(each) for each in lab.servers.values())
            time.sleep(IDLE_S)
            spent.append(
                (
                    time.process_time() - cpu,
                    sum(read_server_cpu_s(each) for each in lab.servers.values()) - host,
                )
            )
        for each in shared:
            each.close()
    pulses = PULSED_HOSTS * IDLE_S / frames.PULSE_S
    here, there = (1e6 * (after - before) / pulses for before, after in zip(*spent, strict=True))
    print(f"\nOne pulse: {here:.0f} us of CPU here, {there:.0f} us on the host.")


if __name__ == "__main__":
    measure_requests(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
    measure_far_host()
    measure_pulses()
