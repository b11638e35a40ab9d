# SPDX-License-Identifier: Apache-2.0
"""Cost of application metrics on a host: ``python -m tests.benchmarks.app_metrics [SECONDS]``.

CPU of reading one task's file, for typical and worst content; and of a supervisor that checks the file while
its task sleeps (the kernel's own count, schedstat).
"""

import os
import sys
import tempfile
import time
from pathlib import Path

from edgectl.agent.measure import metrics
from edgectl.agent.supervise import liveness, state_dir, task_dirs
from edgectl.transport.agent_client import call_agent
from edgectl.transport.local import LocalSession
from tests.benchmarks.profilers import read_cpu_s

SECONDS, TASKS, TIMES = 30.0, 20, 5
WRITTEN = {
    "nothing": b"",
    "two values": b"fps 29.97\nloss 0.25\n",
    "64 KiB of two values": b"".join(b"fps %d\nloss %f\n" % (number, number / 7) for number in range(5000)),
    "worst case: no numbers": b"a x\n" * 20_000,
    "worst case: too large numbers": b"a 1e999999999\n" * 8_000,
    "worst case: newlines": b"\n" * 70_000,
    "worst case: one line": b"a " + b"1" * 70_000 + b"\n",
}


def measure_reading_s(written: bytes) -> float:
    """Return the CPU seconds per task of reading this content, with all overhead."""
    entries = {f"task{number}": {"managed": True, "instance": "i1"} for number in range(TASKS)}
    for name in entries:
        Path(metrics.get_metrics_path(task_dirs.make_task_dir("edge1", name))).write_bytes(written)
    began = time.process_time()
    for _ in range(TIMES):
        metrics.read_tasks_metrics("edge1", entries)
    return (time.process_time() - began) / TIMES / TASKS


def measure_idle_share(base: Path, seconds: float) -> float:
    """Return the share of one core used by a supervisor of a sleeping task."""
    spec = {
        "command": "exec sleep 6000", "kind": "service", "restart": "never", "runtime": "process",
        "stop": {"signal": "TERM", "grace_s": 2.0}, "log": {"max_bytes": 100_000, "files": 2},
    }  # fmt: skip
    session, names = LocalSession("edge2"), [f"task{number}" for number in range(TASKS)]
    for name in names:
        call_agent(
            session,
            {
                "op": "start",
                "fleet": "lab",
                "host": "edge2",
                "task": name,
                "instance": "i1",
                "generation": 1,
                "spec": spec,
            },
            timeout=60.0,
        )
    try:
        pids = [
            liveness.read_instance(
                str(base / "agent-state" / "lab" / "hosts" / "edge2" / "tasks" / name)
            ).instance["supervisor"]
            for name in names
        ]
        time.sleep(2.0)
        began = sum(map(read_cpu_s, pids))
        time.sleep(seconds)
        return (sum(map(read_cpu_s, pids)) - began) / seconds / TASKS
    finally:
        for name in names:
            call_agent(
                session,
                {
                    "op": "stop",
                    "fleet": "lab",
                    "host": "edge2",
                    "task": name,
                    "instance": None,
                    "generation": None,
                    "stop": None,
                },
                timeout=60.0,
            )


def main() -> int:
    """Print the table; return 0."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    with tempfile.TemporaryDirectory(prefix="edgectl-bench-") as name:
        base = Path(name) / "state"
        os.environ["EDGECTL_STATE_DIR"] = str(base)
        os.umask(0o077)
        state_dir.BASES[:] = [str(base)]
        for what, written in WRITTEN.items():
            print(f"{what:32}{measure_reading_s(written) * 1e3:8.3f} ms per task")
        print(f"{'an idle supervisor':32}{measure_idle_share(base, seconds):8.4%} of a core")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
