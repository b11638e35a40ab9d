# SPDX-License-Identifier: Apache-2.0
"""What the machine does beside an experiment: CPU of all processes, and of those of the experiment, in cores over time."""

import json
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from edgectl.experiments.files.run_directory import RUN_FILE_NAME

FILE_NAME = "machine.jsonl"
EVERY_S = 5.0


@dataclass(frozen=True, kw_only=True)
class MachineSample:
    """The ``EVERY_S`` up to ``at`` (s since 1970): ``busy`` cores of the machine, and ``own`` ones of the experiment."""

    at: float
    busy: float
    own: float

    @property
    def others(self) -> float:
        """Cores that were not the experiment's: of processes outside of it, or of other machines on the same computer."""
        return max(0.0, self.busy - self.own)


def read_busy_s() -> float:
    """CPU seconds of the machine since it was switched on: of processes, and those that its computer gave to other machines.

    Interrupts are not counted: nearly all are packets of the experiment, and belong to no process.
    """
    words = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]
    user, nice, system, _, _, _, _, steal = map(int, words)
    return (user + nice + system + steal) / os.sysconf("SC_CLK_TCK")


def measure_busy(seconds: float) -> float:
    """Cores in use over the next ``seconds``."""
    began, before = time.monotonic(), read_busy_s()
    time.sleep(seconds)
    return (read_busy_s() - before) / (time.monotonic() - began)


@contextmanager
def watch_machine(path: Path, read_own_s: Callable[[], float], every_s: float = EVERY_S) -> Iterator[None]:
    """Append a sample to ``path`` every so often, as long as the context lasts; from when on there is a run beside it."""
    ended = threading.Event()

    def run() -> None:
        at, busy, own = time.monotonic(), read_busy_s(), read_own_s()
        while not ended.wait(every_s):
            then, busy_before, own_before = at, busy, own
            at, busy, own = time.monotonic(), read_busy_s(), read_own_s()
            cores = [
                round((now - before) / (at - then), 3)
                for now, before in ((busy, busy_before), (own, own_before))
            ]
            if (path.parent / RUN_FILE_NAME).exists():
                with path.open("a") as file:
                    file.write(
                        json.dumps({"at": round(time.time(), 1), "busy": cores[0], "own": cores[1]}) + "\n"
                    )

    thread = threading.Thread(target=run, name="machine")
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def load_samples(path: Path) -> list[MachineSample]:
    """The samples of a run; none where they were not taken."""
    if not path.exists():
        return []
    return [MachineSample(**json.loads(line)) for line in path.read_text().splitlines()]


def compute_others(samples: Iterable[MachineSample], since: float, until: float) -> float | None:
    """Mean cores of others from ``since`` to ``until``; None without samples."""
    found: Sequence[float] = [each.others for each in samples if since < each.at <= until]
    return sum(found) / len(found) if found else None
