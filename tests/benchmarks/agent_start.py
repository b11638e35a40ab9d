# SPDX-License-Identifier: Apache-2.0
"""CPU of one request on a host: ``python -m tests.benchmarks.agent_start [PYTHON ..]``.

The agent's operations and a bare ``python3 -I -S -c pass`` run in turns, each as a process of its own with the
agent's code compiled already; user and system time of the whole process as the kernel states it. What a start
leaves behind (supervisor and command) counts beside it.
"""

import contextlib
import ctypes
import os
import socket
import statistics
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from edgectl.transport import agent_client
from edgectl.transport.agent_archive import build_agent_zipapp
from tests.benchmarks.ratios import note_ratio

RUNS = 100
# A multiple of the bare start.
GOAL = 1.6
SPEC = {
    "command": "true", "kind": "job", "restart": "never", "runtime": "process",
    "stop": {"signal": "TERM", "grace_s": 2.0}, "log": {"max_bytes": 100_000, "files": 2},
}  # fmt: skip
LINKS = [{"robot": f"robot{number}", "address": f"127.16.98.{number}"} for number in range(1, 4)]
# These have a connection each.
CONNECTED_LINKS = [{**link, "address": link["address"].replace(".98.", ".99.")} for link in LINKS]
REQUESTS: dict[str, dict[str, object]] = {
    "status": {"op": "status", "task": None},
    "logs": {"op": "logs", "task": "none", "tail": 10},
    "lease": {"op": "lease", "action": "renew", "lease": {"holder": "a", "session": "s", "epoch": 1}},
    "stop": {"op": "stop", "task": "none", "instance": None, "generation": None, "stop": None},
    "probe": {"op": "probe", "window_s": 0.0},
    "probe of three links": {"op": "probe", "window_s": 0.0, "links": LINKS},
    "probe of connected links": {"op": "probe", "window_s": 0.0, "links": CONNECTED_LINKS},
    "start": {"op": "start", "task": "done", "generation": 1, "spec": SPEC},
}
_PR_SET_CHILD_SUBREAPER = 36


def build_packet(request: Mapping[str, object], agent: bytes = b"") -> bytes:
    return agent_client.build_packet({"fleet": "lab", "host": "edge1", **request}, "m" * 32, 60.0, agent)


def measure_cpu_s(argv: list[str], data: bytes, environment: Mapping[str, str]) -> tuple[float, float, bytes]:
    """Return the CPU seconds of a process, those of what it leaves behind, and its output."""
    with tempfile.TemporaryFile() as source, tempfile.TemporaryFile() as sink:
        source.write(data)
        source.seek(0)
        moves = [(os.POSIX_SPAWN_DUP2, source.fileno(), 0), (os.POSIX_SPAWN_DUP2, sink.fileno(), 1)]
        pid = os.posix_spawn(argv[0], argv, environment, file_actions=moves)
        _, _, usage = os.wait4(pid, 0)
        left = 0.0
        while True:
            try:
                _, _, late = os.wait3(0)
            except ChildProcessError:
                break
            left += late.ru_utime + late.ru_stime
        sink.seek(0)
        return usage.ru_utime + usage.ru_stime, left, sink.read()


def measure_python(python: str, state: Path) -> bool:
    """Print the table of one interpreter; return whether the goal is met."""
    command = [python, "-I", "-S", "-c", agent_client._BOOTSTRAP]
    spent: dict[str, list[tuple[float, float]]] = {"bare": [], **{name: [] for name in REQUESTS}}
    for number in range(-2, RUNS):
        runs = {"bare": measure_cpu_s([python, "-I", "-S", "-c", "pass"], b"", os.environ)}
        for name, request in REQUESTS.items():
            # A host that has no more tasks than the request is about.
            environment = {**os.environ, "EDGECTL_STATE_DIR": str(state / name)}
            packet = build_packet({"instance": f"i{number}", **request})
            runs[name] = measure_cpu_s(command, packet, environment)
            if b'"missing": true' in runs[name][2]:
                packet = build_packet({"instance": f"i{number}", **request}, build_agent_zipapp())
                runs[name] = measure_cpu_s(command, packet, environment)
            assert b"edgectl-frame" in runs[name][2], runs[name][2]
        for name, (own, left, _) in runs.items():
            if number >= 0:
                spent[name].append((own * 1000, left * 1000))
    return print_table(spent)


@contextlib.contextmanager
def connect_links() -> Iterator[None]:
    """Hold one connection to each robot of ``CONNECTED_LINKS``."""
    with contextlib.ExitStack() as stack:
        for link in CONNECTED_LINKS:
            server = stack.enter_context(socket.create_server((link["address"], 0)))
            stack.enter_context(socket.create_connection(server.getsockname()))
            stack.enter_context(server.accept()[0])
        yield


def print_table(spent: Mapping[str, Sequence[tuple[float, float]]]) -> bool:
    """Print the least and the median CPU (ms) of each request and what of a bare start it is."""
    print(f"{'what':<25}{'min ms':>8}{'median ms':>11}{'of a bare start':>17}{'left behind':>13}")
    bare, worst = statistics.median(own for own, _ in spent["bare"]), 0.0
    for name, times in spent.items():
        own, left = [each for each, _ in times], [each for _, each in times]
        ratio = statistics.median(own) / bare
        has_goal = "links" not in name and name not in ("start", "bare")
        worst = max(worst, ratio if has_goal else 0.0)
        if name != "bare":
            note_ratio(f"CPU of a host: {name}", ratio, of="python3 -I -S", most=GOAL if has_goal else None)
        behind = f"{statistics.median(left):.1f} ms" if max(left) else ""
        print(f"{name:<25}{min(own):>8.2f}{statistics.median(own):>11.2f}{ratio:>17.2f}{behind:>13}")
    print(f"goal {GOAL}, without the work of links and starts: at most {worst:.2f}")
    return worst <= GOAL


def main() -> int:
    """Return 1 where the goal is missed by an interpreter."""
    # What a start leaves behind becomes a child of this process.
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    met = True
    for python in sys.argv[1:] or [os.path.realpath(sys.executable)]:
        with tempfile.TemporaryDirectory(prefix="edgectl-") as state:
            print(python)
            with connect_links():
                met = measure_python(python, Path(state)) and met
    return int(not met)


if __name__ == "__main__":
    sys.exit(main())
