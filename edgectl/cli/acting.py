"""What every command shares that changes hosts: asking, live progress, two kinds of Ctrl-C, the report."""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

from edgectl.cli import console
from edgectl.errors import ExitCode, UsageError
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy
from edgectl.model.progress import Listener, Progress, unheard
from edgectl.usecases.change import Applied, ApplyOptions
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import commands, whole
from edgectl.usecases.plan import plan as make_plan
from edgectl.views.form import Form, view
from edgectl.views.progress import applying

_FOR_PEOPLE = (Form.TABLE, Form.WIDE)


def answerable(*, asked: bool, first: str = "look first: edgectl plan") -> bool:
    """Whether a person is asked; refuses where nobody can answer, before anything is done. ``first`` is what to do before a blind yes.

    Raises:
        UsageError: standard input is not a terminal.
    """
    if asked and not sys.stdin.isatty():
        raise UsageError("standard input is not a terminal, so nobody can say yes", hint=f"pass --yes, or {first}")
    return asked


class Session:
    """One change under way: what to show before, during and after it."""

    def __init__(self, *, quiet: bool, output: Form, asked: bool, within: contextlib.ExitStack) -> None:
        self._quiet, self._output, self._asked, self._within = quiet, output, asked, within
        self._listener: Listener = unheard
        self.stop_requested = threading.Event()

    def options(
        self, *, lock_timeout: float, max_parallel: int = 16, fail_fast: bool = False, choose: Callable[[Plan], Plan] = whole
    ) -> ApplyOptions:
        """The options of the use case."""
        return ApplyOptions(
            lock_timeout=lock_timeout,
            max_parallel=max_parallel,
            fail_fast=fail_fast,
            choose=choose,
            progress=self._hear,
            stop_requested=self.stop_requested,
        )

    def confirm(self, plan: Plan) -> bool:
        """Show the plan; where a person is asked, only ``yes`` is a yes."""
        if self._output in _FOR_PEOPLE and (self._asked or not self._quiet):
            console.show(self._output, "plan", plan)
        count = sum(step.action.changes for step in plan.steps)
        agreed = not self._asked or ask(
            f'\nCarry out {"this action" if count == 1 else f"these {count} actions"}? Only "yes" is accepted: '
        )
        if agreed:
            self._listener = self._within.enter_context(applying(count, quiet=self._quiet))
        return agreed

    def _hear(self, event: Progress) -> None:
        self._listener(event)

    def report(self, applied: Applied, code: ExitCode = ExitCode.DONE) -> None:
        """What was done. Quiet: nothing where nothing was to be done and the exit code is 0; else why it is not."""
        if applied.declined:
            console.tell("nothing was done")
        elif applied.results is not None:
            console.show(self._output, "results", applied.results)
        elif not self._quiet and self._output in _FOR_PEOPLE:
            console.show(self._output, "plan", applied.plan)
        elif not self._quiet:
            console.show(self._output, "nothing")
        if self._quiet:
            _say_why(applied.plan, code)


def _say_why(plan: Plan, code: ExitCode) -> None:
    """The causes of an exit code that a plan nobody was shown accounts for."""
    from edgectl.cli.exits import silent_hosts
    from edgectl.views import causes

    if code is ExitCode.PARTLY:
        console.say(causes.unanswered(plan.snapshot, silent_hosts(plan.snapshot)))
    elif code is ExitCode.UNPLACED:
        console.say(causes.unplaced(plan))


def ask(question: str, answer: str = "yes") -> bool:
    """Put a question on standard error; only the word ``answer`` is a yes."""
    sys.stderr.write(question)
    sys.stderr.flush()
    return sys.stdin.readline().strip() == answer


@contextlib.contextmanager
def session(*, quiet: bool, output: Form, asked: bool) -> Iterator[Session]:
    """A change, in which the first Ctrl-C (or SIGTERM) lets the running actions finish and the second stops at once."""
    view(output, "results")  # refuse an unknown form before anything is done
    with contextlib.ExitStack() as within:
        act = Session(quiet=quiet, output=output, asked=asked, within=within)
        within.enter_context(_patient(act.stop_requested))
        yield act


@contextlib.contextmanager
def _patient(stop_requested: threading.Event) -> Iterator[None]:
    def first(_signal: int, _frame: FrameType | None) -> None:
        if stop_requested.is_set():
            raise KeyboardInterrupt
        stop_requested.set()
        console.tell("finishing what is under way; Ctrl-C again stops at once")

    before = {number: signal.signal(number, first) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def dry_run(fleet: Fleet, policy: Policy, saved: Plan | None, choose: Callable[[Plan], Plan], output: Form) -> ExitCode:
    """Print what apply would send, host by host."""
    view(output, "commands")
    plan = saved if saved is not None else choose(make_plan(fleet, policy))
    console.show(output, "commands", commands(fleet, plan))
    return ExitCode.DONE
