# SPDX-License-Identifier: Apache-2.0
"""How often a probe of an idle link of the lab reads it, near and far, for ``probes_read:`` of docs/scenarios/patrol.yaml.

    python -m tests.experiments.lab.probes [--probes 60]

On computers in namespaces (root), which run no task; half of the probes beside a process that computes on each of both hosts.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from edgectl.config.load import load_inventory_and_tasks
from edgectl.gateway.bandwidth import probe_idle_links
from edgectl.transport.connections import SessionPool
from edgectl.usecases.open_fleet import open_fleet
from tests.experiments.lab.hosts import Lab, lab
from tests.experiments.lab.patrol import PATROL
from tests.faults.namespace_host import NamespaceHost
from tests.pace import patience

PAIR = ("edge1", "robot1")
# bytes/s: what the inventory says, and what a link far from an edge carries.
NOMINAL, FAR = 2e6, 2e5
HOG = "while :; do :; done"


def probe(site: Path, state: Path, count: int) -> Iterator[str]:
    """What each of so many probes reads, in bytes/s; "-": nothing. Called where the manager is."""
    inventory, tasks, _ = load_inventory_and_tasks(site / "fleet.yaml", site / "tasks.yaml")
    fleet = open_fleet(inventory, tasks, state, warn=lambda text: print(text, file=sys.stderr))
    with SessionPool(fleet.transport) as pool:
        for _ in range(count):
            found = probe_idle_links(inventory, pool, {PAIR: NOMINAL})[PAIR]
            yield f"{found.bytes_per_s:.0f}" if found.bytes_per_s and found.full else "-"


def measure(made: Lab, near: str, count: int) -> list[float | None]:
    """The readings of so many probes from edge1 to robot1, whose near edge is ``near``; None: no reading."""
    shape = [*made.prefix, sys.executable, str(PATROL / "radio.py"), f"robot1={near}"]
    subprocess.run(shape, env=made.environment, check=True, timeout=patience(30))
    words = [*made.prefix, sys.executable, "-m", "tests.experiments.lab.probes", "--site", str(made.site)]
    read = subprocess.run(
        [*words, "--probes", str(count)],
        env=made.environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=patience(60 + 5 * count),
    )
    return [None if word == "-" else float(word) for word in read.stdout.split()]


@contextmanager
def hogs(made: Lab) -> Iterator[None]:
    """A process that computes on each of both hosts, within its control group."""
    with ExitStack() as stack:
        for name in PAIR:
            host = made.hosts[name]
            assert isinstance(host, NamespaceHost)
            hog = subprocess.Popen(["sh", "-c", HOG])
            stack.callback(hog.wait, patience(30))
            stack.callback(hog.kill)
            for file in host.group.procs_files:
                Path(file).write_text(str(hog.pid))
        yield


def describe(readings: Sequence[float | None], carries: float) -> str:
    """How many are there, and quartiles as shares of what the link carries."""
    read = sorted(each / carries for each in readings if each is not None)
    if len(read) < 2:
        return f"{len(read)} of {len(readings)} read it"
    low, middle, high = statistics.quantiles(read, n=4)
    return f"{len(read)} of {len(readings)} read it: {middle:.2f} of it ({low:.2f} to {high:.2f})"


def main() -> int:
    """Measure and print; with ``--site`` only probe."""
    parser = argparse.ArgumentParser(description="How often a probe of an idle link reads it.")
    parser.add_argument("--probes", type=int, default=60, help="of each kind of link")
    parser.add_argument("--site", type=Path, help="of a lab, whose manager this is")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="edgectl-probes-") as name:
        directory = Path(name)
        if options.site is not None:
            for line in probe(options.site, directory, options.probes):
                print(line, flush=True)
            return 0
        with lab(directory) as made:
            if not made.prefix:
                sys.exit(f"no shaped links here: {made.wanting}")
            for near, carries in (("edge2", FAR), ("edge1", NOMINAL)):
                for busy in (False, True):
                    with hogs(made) if busy else ExitStack():
                        read = measure(made, near, options.probes // 2)
                    where = "busy hosts" if busy else "idle hosts"
                    print(f"{carries / 1e6:g} MB/s, {where}: {describe(read, carries)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
