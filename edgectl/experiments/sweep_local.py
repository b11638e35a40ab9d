# SPDX-License-Identifier: Apache-2.0
"""Worlds of a sweep on the cores of this machine, in processes that may die without harm to the others."""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from edgectl.errors import EdgectlError
from edgectl.experiments.model.sweep import SweepWorld, WorldResult
from edgectl.experiments.sweep_runs import simulate_world

# A world whose process is killed so often is given up: perhaps it does not fit into the memory.
MAX_ATTEMPTS = 3
_JOIN_TIMEOUT_S = 5.0

Report = Callable[[str], None]


@dataclass(slots=True, kw_only=True)
class _Worker:
    """A process, our end of its pipe, and the world on which it works."""

    process: SpawnProcess
    pipe: Connection
    world: SweepWorld | None = None


def count_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0))


def simulate_on_cores(worlds: Sequence[SweepWorld], workers: int, report: Report) -> Iterator[WorldResult]:
    """The results, in the order in which they come.

    A process that is killed is reported, and its world is given to another. All processes have ended when
    this generator has, also when it is closed early.

    Raises:
        EdgectlError: a world killed its process three times.
    """
    waiting, attempts = deque(worlds), dict[str, int]()
    crew = [_start_worker() for _ in range(min(workers, len(worlds)))]
    left = len(worlds)
    try:
        for worker in crew:
            _give_world(worker, waiting)
        while left:
            ready = wait([worker.pipe for worker in crew if worker.world is not None])
            for place in [place for place, worker in enumerate(crew) if worker.pipe in ready]:
                result = _receive_result(crew[place])
                if result is None:
                    crew[place] = _replace_worker(crew[place], waiting, attempts, report)
                else:
                    left -= 1
                    yield result
                _give_world(crew[place], waiting)
    finally:
        _end_workers(crew)


def _start_worker() -> _Worker:
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs,), daemon=True)
    process.start()
    theirs.close()
    return _Worker(process=process, pipe=ours)


def _work(pipe: Connection) -> None:
    """Simulate what comes until the other end is closed. Ctrl-C is for the parent, which then ends us."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            pipe.send(simulate_world(pipe.recv()))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


def _give_world(worker: _Worker, waiting: "deque[SweepWorld]") -> None:
    worker.world = waiting.popleft() if waiting else None
    if worker.world is not None:
        try:
            worker.pipe.send(worker.world)
        except (BrokenPipeError, ConnectionResetError):
            return  # it is dead: reading says so


def _receive_result(worker: _Worker) -> WorldResult | None:
    """None: the process is dead."""
    try:
        result: WorldResult = worker.pipe.recv()
    except (EOFError, ConnectionResetError):
        return None
    return result


def _replace_worker(
    dead: _Worker, waiting: "deque[SweepWorld]", attempts: dict[str, int], report: Report
) -> _Worker:
    world = dead.world
    assert world is not None  # noqa: S101 - it is waited for only with a world
    _end_workers([dead])
    attempts[world.digest] = attempts.get(world.digest, 0) + 1
    name = ", ".join(f"{key} {value}" for key, value in world.settings.items()) or "the only world"
    how = _describe_end(dead.process.exitcode)
    if attempts[world.digest] >= MAX_ATTEMPTS:
        raise EdgectlError(
            f"the process of a world {how} {MAX_ATTEMPTS} times ({name})",
            hint="use fewer workers if memory is short: --workers 1; finished worlds are kept",
        )
    report(f"process {dead.process.pid} {how} ({name}); the world is simulated again")
    waiting.appendleft(world)
    return _start_worker()


def _describe_end(code: int | None) -> str:
    if code is not None and code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with status {code}"


def _end_workers(crew: Sequence[_Worker]) -> None:
    for worker in crew:
        worker.pipe.close()
        worker.process.terminate()
    for worker in crew:
        worker.process.join(_JOIN_TIMEOUT_S)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
