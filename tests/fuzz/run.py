"""Run cases and tell those that ended otherwise than with a value or an error of our own, or took too long."""

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
class Tally:
    """What became of the cases of one target. ``bad`` says how to repeat each that went wrong."""

    target: str
    cases: int = 0
    accepted: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    bad: list[str] = field(default_factory=list)


class _Hang(BaseException):
    """The decoder did not come back."""


def _alarm(_signal: int, _frame: FrameType | None) -> None:
    raise _Hang


def cases_of(target: Target, cases: int) -> int:
    """How many of ``cases`` a target is given: fewer where one is dear."""
    return -(-cases // target.cost)


def run(target: Target, *, seed: int, cases: int, until: float) -> Tally:
    """``cases`` cases, fewer where the monotonic clock reaches ``until`` first."""
    tally = Tally(target.name)
    before = signal.signal(signal.SIGPROF, _alarm)
    try:
        for number in range(cases_of(target, cases)):
            if time.monotonic() >= until:
                break
            _one(target, seed, number, tally)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    return tally


def _one(target: Target, seed: int, number: int, tally: Tally) -> None:
    data = target.case(seed, number)
    tally.cases += 1
    signal.setitimer(signal.ITIMER_PROF, _HANG_S)
    began = time.process_time()
    try:
        target.read(data)
    except EdgectlError as error:
        tally.refused += 1
        wrong = "" if error.message and "\n" not in error.message.split("\n")[0] else "an error without words"
    except (Exception, _Hang) as error:
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
