# SPDX-License-Identifier: Apache-2.0
"""CPU of two versions of a watch beside each other: ``python -m tests.benchmarks.watched_pair FOLDER [N] [WINDOWS]``.

``FOLDER`` has the sources of the other version, as a worktree of git does. Both watch the same N hosts (64) each second and at the
same time, so whatever else the machine does slows down both: figures of the one and then the other vary by more than versions
differ. Each is begun first in one of two rounds, of so many windows (5) of 30 s. Needs root, for the networks of the hosts.
"""

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from tests.benchmarks.watched_fleet import WARM_UP_S, making_networks, read_tree_cpu_s, watching, write_files
from tests.sshd import running_lab

WINDOW_S = 30.0
HERE = Path(__file__).parents[2]
# The later one is begun in the midst of a cycle of the other.
_STAGGER_S = 5.5


def measure_round(
    folder: Path, trees: Sequence[Path], names: Sequence[str], windows: int
) -> list[list[float]]:
    """The ms of CPU per s of each version, which are begun in this order, in each window."""
    found = []
    with ExitStack() as stack:
        write_files(folder, names)
        enter, networks = stack.enter_context(making_networks(folder, names))
        lab = stack.enter_context(running_lab(folder / "lab", names, networks=networks))
        pids = []
        for number, tree in enumerate(trees):
            own = folder / f"manager{number}"
            own.mkdir()
            write_files(own, names)
            environment = {"EDGECTL_STATE_DIR": str(own / "state"), "PYTHONPATH": str(tree)}
            pids.append(
                stack.enter_context(watching(own, enter, os.environ | lab.environment | environment)).pid
            )
            time.sleep(_STAGGER_S)
        time.sleep(WARM_UP_S)
        for _ in range(windows):
            before, began = read_tree_cpu_s(pids), time.monotonic()
            time.sleep(WINDOW_S)
            after, took = read_tree_cpu_s(pids), time.monotonic() - began
            found.append([1000 * (after[pid] - before[pid]) / took for pid in pids])
        for number in range(len(trees)):
            said = (folder / f"manager{number}" / "output").read_text()
            if "host-lost" in said:
                print(f"manager {number + 1} lost {said.count('host-lost')} hosts for a time")
    return found


def main(words: Sequence[str]) -> int:
    """Print the CPU of both in each window, and the ratio of this version to the other.

    Return the exit status: 0, or 2 if no folder was given.
    """
    if not words:
        print("usage: python -m tests.benchmarks.watched_pair FOLDER [N] [WINDOWS]", file=sys.stderr)
        return 2
    other, numbers = Path(words[0]).resolve(), [int(word) for word in words[1:]]
    count, windows = (*numbers, *(64, 5)[len(numbers) :])
    names = [f"robot{n}" if n % 5 == 0 else f"edge{n}" for n in range(count, 0, -1)]
    pairs: list[tuple[float, float]] = []
    for trees in ([other, HERE], [HERE, other]):
        with tempfile.TemporaryDirectory(prefix="edgectl-") as directory:
            for shares in measure_round(Path(directory), trees, names, windows):
                by_tree = dict(zip(trees, shares, strict=True))
                pairs.append((by_tree[HERE], by_tree[other]))
                print(
                    f"{pairs[-1][0]:.1f} ms a second here, {pairs[-1][1]:.1f} there: {pairs[-1][0] / pairs[-1][1]:.2f}"
                )
    ratios = sorted(here / there for here, there in pairs)
    print(
        f"{count} hosts, {len(pairs)} windows of {WINDOW_S:.0f} s: ratios {ratios[0]:.2f} to {ratios[-1]:.2f}, "
        f"median {statistics.median(ratios):.2f}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
