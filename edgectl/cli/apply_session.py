# SPDX-License-Identifier: Apache-2.0
"""Session of a command that changes hosts: confirmation, live progress, Ctrl-C, report."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

from edgectl.cli import console
from edgectl.cli.connect import parse_lock_timeout
from edgectl.cli.options import ChangeOptions
from edgectl.cli.signals import request_stop_on_signal
from edgectl.errors import ExitCode, UsageError
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy
from edgectl.model.progress import ProgressEvent, ProgressListener, ignore_progress
from edgectl.usecases.apply import check_saved_plan
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import keep_whole_plan, list_remote_commands, make_plan
from edgectl.usecases.plan_execution import ApplyOptions, ApplyResult
from edgectl.views.output_format import HUMAN_FORMATS, NAMED_FORMATS, OutputFormat, check_output_format
from edgectl.views.progress import show_apply_progress
from edgectl.views.text import is_ci


def check_can_confirm(*, asked: bool, first: str = "check first: edgectl plan") -> bool:
    """Whether to ask for confirmation; refused before anything is done where no answer is possible.

    ``first`` is what to check before passing --yes.

    Raises:
        UsageError: stdin is not a terminal, or a CI job runs this (CI=true).
    """
    if asked and (not sys.stdin.isatty() or is_ci()):
        why = "CI is set" if is_ci() else "stdin is not a terminal"
        raise UsageError(f"{why}: cannot ask for confirmation", hint=f"pass --yes, or {first}")
    return asked


class ApplySession:
    """One change: output before, during and after it."""

    def __init__(
        self,
        *,
        quiet: bool,
        output: OutputFormat,
        asked: bool,
        dry_run: bool,
        within: contextlib.ExitStack,
        fleet: str = "",
    ) -> None:
        self._dry_run, self._fleet = dry_run, fleet
        self._quiet, self._output, self._asked, self._within = quiet, output, asked, within
        self._listener: ProgressListener = ignore_progress
        self.stop_requested = threading.Event()

    def options(
        self,
        *,
        lock_timeout: float | None,
        max_parallel: int = 16,
        fail_fast: bool = False,
        choose: Callable[[Plan], Plan] = keep_whole_plan,
    ) -> ApplyOptions:
        """Options of the use case."""
        return ApplyOptions(
            lock_timeout=lock_timeout,
            max_parallel=max_parallel,
            fail_fast=fail_fast,
            choose=choose,
            dry_run=self._dry_run,
            progress=self._hear,
            stop_requested=self.stop_requested,
        )

    def options_from(
        self, given: ChangeOptions, choose: Callable[[Plan], Plan] = keep_whole_plan
    ) -> ApplyOptions:
        """Options of the use case from those of the command line.

        Raises:
            UsageError: the time-out is no duration.
        """
        return self.options(
            lock_timeout=parse_lock_timeout(given.lock_timeout),
            max_parallel=given.max_parallel,
            fail_fast=given.fail_fast,
            choose=choose,
        )

    def confirm(self, plan: Plan) -> bool:
        """Show the plan; if asked, only the answer ``yes`` confirms."""
        if self._output in HUMAN_FORMATS and (self._asked or not self._quiet):
            self._print_plan(plan)
        count = sum(step.action.changes for step in plan.steps)
        to_fleet = f" to fleet {self._fleet}" if self._fleet else ""
        agreed = not self._asked or ask_confirmation(
            f"\nApply {'this action' if count == 1 else f'these {count} actions'}{to_fleet}? "
            'Only "yes" is accepted: '
        )
        if agreed:
            self._listener = self._within.enter_context(show_apply_progress(count, quiet=self._quiet))
        return agreed

    def _hear(self, event: ProgressEvent) -> None:
        self._listener(event)

    def report(self, applied: ApplyResult, code: ExitCode = ExitCode.DONE) -> None:
        """Print the results, or after a dry run nothing. Quiet: only the reason of an exit code other
        than 0.
        """
        from edgectl.views.results import ResultsView

        if self._dry_run:
            return
        if applied.declined:
            console.print_message("nothing was done")
        elif applied.results is not None:
            console.print_view(ResultsView(applied.results, fleet=self._fleet), self._output)
        elif not self._quiet and self._output in HUMAN_FORMATS:
            self._print_plan(applied.plan)
        elif not self._quiet:
            console.print_view(ResultsView(None), self._output)
        if self._quiet:
            _explain_exit_code(applied.plan, code)

    def _print_plan(self, plan: Plan) -> None:
        from edgectl.views.plan import PlanView

        console.print_view(PlanView(plan, now=time.time()), self._output)


def _explain_exit_code(plan: Plan, code: ExitCode) -> None:
    """Print the causes of an exit code of a plan that was not shown."""
    from edgectl.views import plan_sections

    if code is ExitCode.PARTLY:
        console.print_stderr(
            plan_sections.render_unreachable_hosts(plan.snapshot, plan.snapshot.silent_hosts)
            + plan_sections.render_lost_tasks(plan)
        )
    elif code is ExitCode.UNPLACED:
        console.print_stderr(plan_sections.render_unplaced_tasks(plan))


def ask_confirmation(question: str, answer: str = "yes") -> bool:
    """Ask on stderr; only the word ``answer`` confirms."""
    sys.stderr.write(question)
    sys.stderr.flush()
    return sys.stdin.readline().strip() == answer


@contextlib.contextmanager
def open_apply_session(
    *, quiet: bool, output: OutputFormat, asked: bool, dry_run: bool = False, fleet: str = ""
) -> Iterator[ApplySession]:
    """A session that changes ``fleet``: the first Ctrl-C (or SIGTERM) lets running actions finish, the second
    stops at once.

    ``dry_run``: only plan; ``print_requests`` then shows what would be sent.
    """
    check_output_format(output, NAMED_FORMATS)
    with contextlib.ExitStack() as within:
        act = ApplySession(
            quiet=quiet, output=output, asked=asked, dry_run=dry_run, within=within, fleet=fleet
        )
        within.enter_context(request_stop_on_signal(act.stop_requested))
        yield act


def print_dry_run(
    fleet: Fleet, policy: Policy, saved: Plan | None, choose: Callable[[Plan], Plan], output: OutputFormat
) -> ExitCode:
    """Print the requests of apply, host by host."""
    if saved is not None:
        check_saved_plan(fleet, saved)
    plan = saved if saved is not None else choose(make_plan(fleet, policy))
    return print_requests(fleet, plan, output)


def print_requests(fleet: Fleet, plan: Plan, output: OutputFormat) -> ExitCode:
    """Print the requests of ``plan``, host by host.

    Raises:
        UsageError: they have no such format.
    """
    from edgectl.views.dry_run import RequestsView

    check_output_format(output, RequestsView.formats)
    console.print_view(RequestsView(list_remote_commands(fleet, plan)), output, fleet=fleet.inventory.fleet)
    return ExitCode.DONE
