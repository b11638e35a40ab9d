# SPDX-License-Identifier: Apache-2.0
"""Measure jobs on an edge with a shaped link and loaded cores, and predict them as a plan does."""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist

from edgectl.model.policy import Policy
from edgectl.model.predicted_latency import JobSize, PredictedLatency, ServiceTime
from edgectl.model.resource import Usage
from edgectl.model.snapshot import LinkSample, Snapshot
from edgectl.model.task import Task
from edgectl.scheduler.profile import compute_percentile
from tests.builders import a_robot, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.faults.network import run_tc
from tests.latency.worker import ANSWER_BYTES
from tests.network_hosts import NetworkHost, pair_of_hosts
from tests.scheduler.fleets import run_assign

ROOT = Path(__file__).parents[2]
# Programs that make the load of a host: as many others' tasks.
OTHERS = 4
# Data in a packet of 1514 bytes.
_PAYLOAD = 1448 / 1514
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_SHARES = Path("/sys/fs/cgroup/cpu")
# Weight of the measured processes against all others on this machine: 256 to 1.
_WEIGHT = 262_144
# The bucket of a shaped link: one packet, or what passes while a timer is late (s); more would pass unshaped.
_PACKET_BYTES = 1600
_TIMER_S = 250e-6
_Z975 = NormalDist().inv_cdf(0.975)


@dataclass(frozen=True, kw_only=True)
class Link:
    """``rate`` in bit/s of the shaped interfaces, of which headers of TCP take a part."""

    rate: float

    @property
    def bytes_per_s(self) -> float:
        """What is left for data: what `edgectl probe --bandwidth` measures."""
        return self.rate / 8.0 * _PAYLOAD

    @property
    def bucket_bytes(self) -> int:
        """What the shaper lets pass at once."""
        return max(_PACKET_BYTES, round(self.rate / 8.0 * _TIMER_S))


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Size of the pictures of a task."""

    width: int
    height: int

    @property
    def job(self) -> JobSize:
        return JobSize(received=float(self.width * self.height + 8), sent=float(ANSWER_BYTES))


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Sorted latencies at the robot and service times on the host (s), and the cores that others used.

    ``foreign``: the share of the core that went to processes that are no part of the measurement. ``rtt_ms``: of the
    idle link.
    """

    latencies: Sequence[float]
    services: Sequence[float]
    used: float
    foreign: float
    rtt_ms: float

    def percentile_ms(self, share: float) -> float:
        return 1000.0 * compute_percentile(self.latencies, share)

    def bound_percentile_ms(self, share: float) -> tuple[float, float]:
        """The interval that holds the percentile with 95 % confidence: order statistics of independent jobs."""
        count = len(self.latencies)
        reach = _Z975 * (count * share * (1.0 - share)) ** 0.5
        ranks = (max(0, int(count * share - reach)), min(count - 1, int(count * share + reach)))
        return 1000.0 * self.latencies[ranks[0]], 1000.0 * self.latencies[ranks[1]]

    def count_misses(self, deadline: float) -> int:
        return sum(latency > deadline for latency in self.latencies)


@dataclass(frozen=True, kw_only=True)
class Bench:
    """An edge and a robot; ``core``: of the edge, ``other``: of the robot."""

    edge: NetworkHost
    robot: NetworkHost
    core: int
    other: int

    def shape(self, link: Link) -> None:
        """Shape both directions."""
        for host in (self.edge, self.robot):
            words = f"qdisc replace dev eth0 root tbf rate {link.rate:.0f}bit burst {link.bucket_bytes} latency 1s"
            error = run_tc(*words.split(), netns=host.pid)
            assert not error, error

    def measure(self, frame: Frame, load: float, service: float, *, jobs: int, think: float) -> Measured:
        """Measure ``jobs`` jobs while others use ``load`` of the core with jobs of ``service`` s."""
        size = (str(frame.width), str(frame.height))
        with ExitStack() as stack:
            others = [
                stack.enter_context(
                    self._start("load", self.core, str(load / OTHERS / service), str(seed), *size)
                )
                for seed in range(OTHERS if load else 0)
            ]
            server = stack.enter_context(self._start("serve", self.core))
            for process in (*others, server):
                assert process.stdout is not None
                assert process.stdout.readline() == "ready\n"
            before, whole, began = (
                [read_cpu_s(each.pid) for each in others],
                read_core_s(self.core),
                time.monotonic(),
            )
            own = read_cpu_s(server.pid)
            words = (self.edge.address, str(jobs), *size, str(think))
            robot = self._build_command(self.robot, "robot", self.other, *words)
            done = subprocess.run(robot, cwd=ROOT, capture_output=True, text=True, check=False)
            assert not done.returncode, done.stderr
            took = time.monotonic() - began
            used = sum(read_cpu_s(each.pid) - was for each, was in zip(others, before, strict=True))
            own = read_cpu_s(server.pid) - own
            foreign = read_core_s(self.core) - whole - used - own
        found = json.loads(done.stdout)
        return Measured(
            latencies=sorted(found["latencies"]),
            services=sorted(found["services"]),
            used=used / took,
            foreign=max(0.0, foreign) / took,
            rtt_ms=1000.0 * found["rtt"],
        )

    @contextmanager
    def _start(self, role: str, core: int, *words: str) -> Iterator["subprocess.Popen[str]"]:
        command = self._build_command(self.edge, role, core, *words)
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        try:
            yield process
        finally:
            process.kill()
            process.communicate()

    def _build_command(self, host: NetworkHost, role: str, core: int, *words: str) -> list[str]:
        """Only the network of ``host``: its own mounts lack nothing that the work needs, but hide cgroups."""
        program = [sys.executable, "-m", "tests.latency.worker", role, str(core), *words]
        return ["nsenter", f"--net=/proc/{host.pid}/ns/net", *program]


def read_cpu_s(pid: int) -> float:
    """Read the CPU seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S


def read_core_s(core: int) -> float:
    """Read the seconds that a core was busy."""
    line = next(
        line for line in Path("/proc/stat").read_text().splitlines() if line.startswith(f"cpu{core} ")
    )
    user, nice, system, _idle, _wait, *rest = (int(word) for word in line.split()[1:])
    return (user + nice + system + sum(rest[:2])) / _TICKS_PER_S


@contextmanager
def preferred_processes() -> Iterator[bool]:
    """Let this process and its children go before others on this machine, where control groups v1 allow it."""
    group = _SHARES / f"latency-{os.getpid()}"
    try:
        group.mkdir()
        (group / "cpu.shares").write_text(str(_WEIGHT))
        (group / "cgroup.procs").write_text(str(os.getpid()))
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        (_SHARES / "cgroup.procs").write_text(str(os.getpid()))
        with contextlib.suppress(OSError):
            group.rmdir()


@contextmanager
def make_benches(count: int) -> Iterator[list[Bench]]:
    """Make ``count`` edges, each with its own way to the robot; all on the last core of this machine."""
    core, other = max(os.sched_getaffinity(0)), min(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        pairs = [stack.enter_context(pair_of_hosts(Path(folder) / str(number))) for number in range(count)]
        yield [Bench(edge=edge, robot=robot, core=core, other=other) for edge, robot in pairs]


def measure_service(bench: Bench, frame: Frame, *, jobs: int = 40) -> ServiceTime:
    """Measure the service time of a frame on the idle host, over the link as it is shaped."""
    return compute_service(bench.measure(frame, 0.0, 1.0, jobs=jobs, think=0.03).services)


def compute_service(services: Sequence[float]) -> ServiceTime:
    """The service time as `edgectl profile` states it, of sorted times on an idle host."""
    p50, p95 = (compute_percentile(services, share) for share in (0.50, 0.95))
    return ServiceTime(p50=p50, p95=p95)


@dataclass(frozen=True, kw_only=True)
class Site:
    """What a probe knows of one edge: its link, and the cores that others use."""

    link: Link
    used: float
    rtt_ms: float


def build_snapshot(sites: Sequence[Site]) -> Snapshot:
    """The fleet as a probe sees it: edges of one core with one link each to robot1."""
    return a_snapshot(
        {
            f"edge{number}": a_sample(
                cores=1.0,
                used=site.used,
                tasks={
                    f"other{each}": a_run(file="others.yaml", used=Usage(cpu=site.used / OTHERS))
                    for each in range(OTHERS)
                }
                if site.used
                else {},
                links={
                    "robot1": LinkSample(
                        capacity_bytes_per_s=site.link.bytes_per_s, used_bytes_per_s=0.0, rtt_ms=site.rtt_ms
                    )
                },
            )
            for number, site in enumerate(sites, 1)
        }
    )


def build_task(frame: Frame, service: ServiceTime, deadline: float, *, period: float = 0.1) -> Task:
    """The detection of robot1, with its demands at one frame per ``period`` s."""
    return a_task(
        "detection",
        cpu=service.p50 / period,
        throughput=(frame.job.received + frame.job.sent) / period,
        robots=["robot1"],
        deadline=deadline,
        service_time={"": service},
        job=frame.job,
    )


def decide(task: Task, sites: Sequence[Site], policy: Policy) -> tuple[int, dict[int, PredictedLatency]]:
    """The edge (from 0) that a plan chooses, and the predictions of all."""
    edges = [an_edge(f"edge{number}") for number in range(1, len(sites) + 1)]
    fleet = an_inventory(*edges, a_robot("robot1"))
    decision = run_assign(fleet, some_tasks(task), build_snapshot(sites), policy=policy).decisions[0]
    assert decision.host is not None
    predictions = {
        int(entry.host.removeprefix("edge")) - 1: entry.predicted_latency
        for entry in decision.ranking
        if entry.predicted_latency is not None
    }
    return int(decision.host.removeprefix("edge")) - 1, predictions
