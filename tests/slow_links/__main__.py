# SPDX-License-Identifier: Apache-2.0
"""Commands over slow and lossy lines, beside ``ssh`` doing the same: ``python -m tests.slow_links [RUNS]`` (root).

Three hosts, each behind a cable of its own (`cable.py`). ``ssh`` runs the agent of edgectl with the input of a probe, on
all hosts at once: once for a probe and for a plan; for an apply three times, one after the other, for it asks what runs,
starts, and waits; for a cycle of a watch over a connection that is open (ControlMaster). A plan, an apply and a cycle measure
for 0.5 s, a start takes 0.3 s, and a watch pauses for 1 s.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from edgectl.model.inventory import Inventory
from edgectl.transport import agent_client
from tests.benchmarks.probe_fanout import record_request
from tests.benchmarks.ratios import note_ratio
from tests.slow_links.cable import Cables, Line, run_cables, run_in_netns
from tests.sshd import PRIVSEP, Lab, make_key

HOSTS = ("edge3", "edge2", "edge1")
CYCLES = 6
LINES: Mapping[str, Line] = {
    "no delay": Line(),
    "20 ms each way": Line(delay_s=0.02),
    "100 ms each way": Line(delay_s=0.1),
    "300 ms each way": Line(delay_s=0.3),
    "20 ms, 1 % lost": Line(delay_s=0.02, loss=0.01),
    "20 ms, 5 % lost": Line(delay_s=0.02, loss=0.05),
    "20 ms, 256 kbit/s": Line(delay_s=0.02, bits_per_s=256e3),
}
# So far that the line takes most of the time, and without loss, so that each run takes the same.
EVEN_LINES = ("100 ms each way", "300 ms each way")
SSH = "ssh -o BatchMode=yes -o KexAlgorithms=curve25519-sha256 -o LogLevel=ERROR"
COLUMNS = ("ssh", "probe", "plan", "ssh, 3 times", "apply", "ssh, open", "cycle of watch")


class FarHosts:
    """Servers in one network namespace, and commands in that of a manager."""

    def __init__(self, folder: Path, manager: Path, hosts: Path) -> None:
        PRIVSEP.mkdir(mode=0o755, exist_ok=True)
        self.folder, self.manager, self.lab = folder, manager, Lab(directory=folder / "lab")
        self.lab.directory.mkdir()
        self.lab.authorized_keys.write_text(make_key(self.lab.user_key) + "\n")
        run_in_netns(hosts, self._start_servers)
        os.environ.update(self.lab.environment)
        self.environment = os.environ | self.lab.environment | {"EDGECTL_STATE_DIR": str(folder / "state")}
        self._write_files()

    def _start_servers(self) -> None:
        for number, name in enumerate(HOSTS):
            self.lab.add(name, address=f"10.234.{number}.2")
        self.lab.write_files()
        for server in self.lab.servers.values():
            server.start()
        for server in self.lab.servers.values():
            server.wait()

    def _write_files(self) -> None:
        for name in ("inventories", "tasks", "masters"):
            (self.folder / name).mkdir()
        edges = "".join(f"  {name}: {{host: {name}, capacity: {{cpu: 2, memory: 1GB}}}}\n" for name in HOSTS)
        inventory = (
            f"version: 1\nfleet: far\nedges:\n{edges}robots:\n  robot1: {{host: 127.0.0.1, probe: false}}\n"
        )
        (self.folder / "inventories" / "far.yaml").write_text(inventory)
        demand = "demand: {cpu: 0, memory: 0, throughput: 0}"
        tasks = "".join(
            f"  task{number}: {{robot: robot1, command: exec sleep 900, up: 300ms, hosts: {{only: [{name}]}}, {demand}}}\n"
            for number, name in enumerate(HOSTS)
        )
        (self.folder / "tasks" / "far.yaml").write_text(f"version: 1\ntasks:\n{tasks}")
        (self.folder / "none.yaml").write_text("version: 1\ntasks: {}\n")
        known = Inventory(hosts={name: self.lab.host(name) for name in HOSTS})
        (self.folder / "stdin").write_bytes(record_request(known))

    def run(self, *command: str, text: str = "", codes: Sequence[int] = (0,)) -> float:
        """Run a command of the manager; the seconds that it took."""
        began = time.perf_counter()
        done = subprocess.run(
            ["nsenter", f"--net={self.manager}", *command],
            cwd=self.folder,
            env=self.environment,
            input=text,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode in codes, (command, done.stdout[-2000:], done.stderr[-2000:])
        return time.perf_counter() - began

    def edgectl(self, *words: str, codes: Sequence[int] = (0,)) -> float:
        return self.run(sys.executable, "-m", "edgectl", *words, codes=codes)

    def ssh(self, options: str = "", *, command: str = "", source: str = "stdin") -> float:
        agent = command or agent_client.build_agent_command("python3").replace('"', '\\"')
        script = f'exec {SSH} {options} -F {self.lab.ssh_config} "$1" "{agent}" < {source} > "out-$1"'
        return self.run("xargs", "-P", "9", "-n", "1", "sh", "-c", script, "sh", text="\n".join(HOSTS))

    @contextmanager
    def open_connections(self) -> Iterator[str]:
        """Connections of ``ssh`` that stay; the options by which others use them."""
        shared = f"-o ControlPath={self.folder}/masters/%h"
        self.ssh(f"{shared} -o ControlMaster=yes -o ControlPersist=600", command="true", source="/dev/null")
        try:
            yield shared
        finally:
            for name in HOSTS:
                self.run(
                    *SSH.split(),
                    *shared.split(),
                    "-F",
                    str(self.lab.ssh_config),
                    "-O",
                    "exit",
                    name,
                    codes=(0, 255),
                )

    def close(self) -> None:
        for server in self.lab.servers.values():
            server.stop()


def measure_line(far: FarHosts, runs: int) -> dict[str, float]:
    """Medians (s) of each column."""
    took: dict[str, list[float]] = {column: [] for column in COLUMNS}

    def note(column: str, measure: Callable[[], float]) -> None:
        took[column].append(measure())

    for _ in range(runs):
        note("ssh", far.ssh)
        note("probe", lambda: far.edgectl("probe", "--window", "0"))
        note("plan", lambda: far.edgectl("plan"))
        note("ssh, 3 times", lambda: far.ssh() + far.ssh() + far.ssh())
        note("apply", lambda: far.edgectl("apply", "-y"))
        with far.open_connections() as shared:
            note("ssh, open", lambda shared=shared: far.ssh(shared))  # type: ignore[misc]
        note("cycle of watch", lambda: measure_cycle_s(far))
        far.edgectl("stop", "--all", "-y")
    return {column: statistics.median(times) for column, times in took.items()}


def measure_cycle_s(far: FarHosts) -> float:
    """Seconds of one more cycle of a watch, its pause of a second included."""
    watch = ("watch", "--every", "1s", "--cycles")
    once = far.edgectl(*watch, "1")
    return (far.edgectl(*watch, str(CYCLES)) - once) / (CYCLES - 1)


def count_bytes(cables: Cables, work: Callable[[], object]) -> int:
    """Bytes of packets, both ways, that ``work`` sends."""
    before = sum(way.passed_bytes for way in cables.ways)
    work()
    return sum(way.passed_bytes for way in cables.ways) - before


def note_ratios(line: str, found: Mapping[str, float], pairs: Sequence[tuple[str, str]]) -> None:
    """Note commands over a line as multiples of ``ssh``; at most 1 is asked of those whose
    time the line takes: of others one run says little.
    """
    for mine, other in (*pairs, ("cycle of watch", "ssh, open")):
        most = 1.0 if line in EVEN_LINES and mine in ("probe", "apply") else None
        note_ratio(f"{mine}, {line}", found[mine] / found[other], of=other, most=most)


def main(words: Sequence[str]) -> int:
    """Print the tables; return 1 where a command takes longer than ``ssh`` by more than a fifth and a second."""
    runs, met = int(words[0]) if words else 3, True
    with tempfile.TemporaryDirectory(prefix="edgectl-") as directory, run_cables(len(HOSTS)) as site:
        manager, hosts, cables = site
        Path(directory).chmod(0o755)
        far = FarHosts(Path(directory), manager, hosts)
        try:
            far.edgectl("apply", "-y")
            far.edgectl("stop", "--all", "-y")
            sent = {
                "ssh": count_bytes(cables, far.ssh),
                "probe": count_bytes(cables, lambda: far.edgectl("probe", "--window", "0")),
            }
            print(f"{len(HOSTS)} hosts, whole commands, s: medians of {runs}")
            print("| line | " + " | ".join(COLUMNS) + " |\n" + "|---" * (len(COLUMNS) + 1) + "|")
            for name, line in LINES.items():
                cables.line = line
                found = measure_line(far, runs)
                print(
                    f"| {name} | " + " | ".join(f"{seconds:.2f}" for seconds in found.values()) + " |",
                    flush=True,
                )
                pairs = (("probe", "ssh"), ("plan", "ssh"), ("apply", "ssh, 3 times"))
                met = met and all(found[mine] <= 1.2 * found[other] + 1.0 for mine, other in pairs)
                note_ratios(name, found, pairs)
            cables.line = Line()
            print(
                "bytes of one probe of all hosts: "
                + ", ".join(f"{what} {each:,}" for what, each in sent.items())
            )
        finally:
            far.close()
    return int(not met)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
