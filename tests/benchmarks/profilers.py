# SPDX-License-Identifier: Apache-2.0
"""Cost of a profiler on a host: ``python -m tests.benchmarks.profilers [SECONDS]``.

The profiler at 1 Hz and at 5 Hz, with ten tasks of three processes each and three links, against the method
of the paper's profilers: psutil at 5 and 10 Hz, for the host alone and for every process. All run at once, so
that other load affects all alike. CPU is the kernel's own count (schedstat) after a first second; memory is
the resident size at the end. Then CPU and time of a probe that measures over a window of 0.5 s, and of one
that reads the profiler. Goal: under 1 % of a core and 20 MiB at 1 Hz.
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from edgectl.transport.agent_client import call_agent
from edgectl.transport.local import LocalSession

SECONDS = 60.0
TASKS, PROBES = 10, 15
MOST_SHARE, MOST_BYTES = 0.01, 20 << 20
LINKS = [{"robot": f"robot{n}", "address": f"127.77.0.{n}"} for n in range(1, 4)]
HOST_ONLY = "psutil.cpu_percent(); psutil.virtual_memory(); psutil.net_io_counters(pernic=True); psutil.sensors_temperatures()"
EVERY_PROCESS = (
    HOST_ONLY
    + "; [each.info for each in psutil.process_iter(['pid', 'name', 'cmdline', 'cpu_percent', 'memory_info'])]"
)
HABIT = "import psutil, time\nwhile True:\n    {work}\n    time.sleep({pause})"


def ask_agent(host: str, op: str, **fields: object) -> dict[str, object]:
    return call_agent(LocalSession(host), {"op": op, "fleet": "lab", "host": host, **fields}, timeout=60.0)


def start_profiler(host: str, every: float) -> int:
    """Start a profiler on a host with its tasks; return its pid."""
    for number in range(TASKS):
        spec = {
            "command": "sleep 6000 & sleep 6000 & wait", "kind": "service", "restart": "never", "runtime": "process",
            "stop": {"signal": "TERM", "grace_s": 2.0}, "log": {"max_bytes": 100_000, "files": 2},
        }  # fmt: skip
        ask_agent(host, "start", task=f"task{number}", instance="i1", generation=1, spec=spec)
    pid = ask_agent(host, "profiler-start", every_s=every, ttl_s=3600.0, links=LINKS)["pid"]
    assert isinstance(pid, int)
    return pid


def stop_profiler(host: str) -> None:
    ask_agent(host, "profiler-stop")
    for number in range(TASKS):
        ask_agent(host, "stop", task=f"task{number}", instance=None, generation=None, stop=None)


def read_cpu_s(pid: int) -> float:
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) / 1e9


def read_resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()


def measure_shares(pids: dict[str, int], seconds: float) -> dict[str, tuple[float, int]]:
    """Return (share of a core, resident bytes) by name."""
    time.sleep(1.0)
    before, began = {name: read_cpu_s(pid) for name, pid in pids.items()}, time.monotonic()
    time.sleep(seconds)
    took = time.monotonic() - began
    return {
        name: ((read_cpu_s(pid) - before[name]) / took, read_resident_bytes(pid))
        for name, pid in pids.items()
    }


def measure_probes(host: str) -> tuple[float, float]:
    """Return the medians of one probe: agent's CPU in ms, time in ms."""
    cpu, wall = [], []
    for _ in range(PROBES):
        used, began = read_children_cpu_s(), time.monotonic()
        ask_agent(host, "probe", window_s=0.5, links=LINKS)
        wall.append((time.monotonic() - began) * 1000.0)
        cpu.append((read_children_cpu_s() - used) * 1000.0)
    return statistics.median(cpu), statistics.median(wall)


def read_children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def print_measurements(seconds: float, ends: list[Callable[[], object]]) -> int:
    pids: dict[str, int] = {}
    for name, every in (("profiler, 1 Hz", 1.0), ("profiler, 5 Hz", 0.2)):
        host = f"edge{len(pids) + 1}"
        ends.append(lambda host=host: stop_profiler(host))  # type: ignore[misc]
        pids[name] = start_profiler(host, every)
    for name, work, pause in (
        ("psutil, host only, 10 Hz", HOST_ONLY, 0.1),
        ("psutil, every process, 5 Hz", EVERY_PROCESS, 0.2),
        ("psutil, every process, 10 Hz", EVERY_PROCESS, 0.1),
    ):
        process = subprocess.Popen([sys.executable, "-c", HABIT.format(work=work, pause=pause)])
        ends += [process.wait, process.kill]
        pids[name] = process.pid
    found = measure_shares(pids, seconds)
    processes = sum(name.isdigit() for name in os.listdir("/proc"))  # noqa: PTH208
    print(
        f"{seconds:.0f} s, {processes} processes on this machine\n{'what':<32}{'% of a core':>12}{'MiB':>8}"
    )
    for name, (share, size) in found.items():
        print(f"{name:<32}{share:>12.2%}{size / 2**20:>8.1f}")
    with_it = measure_probes("edge1")
    ask_agent("edge1", "profiler-stop")
    without = measure_probes("edge1")
    print(f"{'one probe':<32}{'agent ms CPU':>14}{'ms':>8}")
    for name, (cpu, wall) in (("over a window of 0.5 s", without), ("from the profiler", with_it)):
        print(f"{name:<32}{cpu:>14.1f}{wall:>8.0f}")
    share, size = found["profiler, 1 Hz"]
    return int(share > MOST_SHARE or size > MOST_BYTES)


def main() -> int:
    """Print the table; return 1 if the goal is missed."""
    ends: list[Callable[[], object]] = []
    with tempfile.TemporaryDirectory() as name:
        os.environ["EDGECTL_STATE_DIR"] = name
        try:
            return print_measurements(float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS, ends)
        finally:
            for end in reversed(ends):
                end()


if __name__ == "__main__":
    sys.exit(main())
