# SPDX-License-Identifier: Apache-2.0
"""Run cases and report those that end with neither a value nor an EdgectlError, or take too long."""

import signal
import time
from dataclasses import dataclass, field
from types import FrameType

from edgectl.errors import EdgectlError
from tests.fuzz.targets import Target

# Both are CPU time: decoders do not wait, and a busy machine must not look like a hang.
SLOW_S = 1.0
_HANG_S = 20.0


@dataclass
class TargetResults:
    """Results of one target. ``bad`` says how to repeat each failed case."""

    target: str
    cases: int = 0
    accepted: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    bad: list[str] = field(default_factory=list)


class _DecoderHang(BaseException):
    """The decoder did not return in time."""


def _raise_hang(_signal: int, _frame: FrameType | None) -> None:
    raise _DecoderHang


def count_cases(target: Target, cases: int) -> int:
    """Return the number of cases for a target: fewer for an expensive one."""
    return -(-cases // target.cost)


def run_target(target: Target, *, seed: int, cases: int, until: float) -> TargetResults:
    """Run ``cases`` cases, fewer if the monotonic clock reaches ``until``."""
    tally = TargetResults(target.name)
    before = signal.signal(signal.SIGPROF, _raise_hang)
    try:
        for number in range(count_cases(target, cases)):
            if time.monotonic() >= until:
                break
            _run_case(target, seed, number, tally)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    return tally


def _run_case(target: Target, seed: int, number: int, tally: TargetResults) -> None:
    data = target.case(seed, number)
    tally.cases += 1
    signal.setitimer(signal.ITIMER_PROF, _HANG_S)
    began = time.process_time()
    try:
        target.read(data)
    except EdgectlError as error:
        tally.refused += 1
        wrong = (
            "" if error.message and "\n" not in error.message.split("\n")[0] else "an error without a message"
        )
    except (Exception, _DecoderHang) as error:
        wrong = f"{type(error).__name__}: {error}"[:200]
    else:
        tally.accepted += 1
        wrong = ""
    seconds = time.process_time() - began
    tally.slowest_s = max(tally.slowest_s, seconds)
    if seconds > SLOW_S:
        wrong = wrong or f"took {seconds:.1f} s"
    if wrong:
        tally.bad.append(f"{target.name} seed {seed} case {number}: {wrong}")
