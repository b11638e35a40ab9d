# SPDX-License-Identifier: Apache-2.0
"""watch command."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated

from typer import Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode, UsageError
from edgectl.model.cycle import Cycle
from edgectl.model.policy import Policy
from edgectl.units import format_duration
from edgectl.usecases.control import Control
from edgectl.usecases.fleet import Fleet
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.usecases.watch import WatchOptions

_MIN_PERIOD_S = 1.0
_ApplyOption = Annotated[bool, Option("--apply", help="Apply the plans, without asking.")]
_EveryOption = Annotated[str, Option("--every", metavar="TIME", help="Time from one cycle to the next.")]
_CyclesOption = Annotated[int | None, Option("--cycles", metavar="N", min=1, help="End after N cycles.")]
_TakeOverOption = Annotated[
    bool, Option("--take-over", help="With --apply: end another watch of this fleet.")
]
CyclePrinter = Callable[[Cycle], None]


def watch_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.WatchOutput = OutputFormat.TABLE,
    apply: _ApplyOption = False,
    every: _EveryOption = "10s",
    cycles: _CyclesOption = None,
    take_over: _TakeOverOption = False,
    max_parallel: options.MaxParallelOption = 16,
    overrides: options.PolicyOptions,
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Re-plan periodically; with --apply, also apply.

    On a terminal: a live view; q quits, p plans now, a pauses. Else: a line at the start, at each event and
    at each change of health. SIGTERM ends it with exit code 0.

    Examples:
        edgectl watch --cycles 3 --every 2s
        edgectl watch --apply --every 30s
        edgectl watch -o jsonl --cycles 1
    """
    from edgectl.cli import policy_options
    from edgectl.cli.connect import build_fleet
    from edgectl.cli.reload import build_fleet_reloader
    from edgectl.usecases.plan_execution import ApplyOptions
    from edgectl.usecases.watch import WatchOptions

    def how(fleet: Fleet) -> Policy:
        return policy_options.policy_from_options(fleet, overrides, attended=False)

    given = WatchOptions(
        every=_parse_period(every),
        apply=apply,
        take_over=take_over,
        cycles=cycles,
        execution=ApplyOptions(max_parallel=max_parallel),
        debug=bool(os.environ.get("EDGECTL_DEBUG")),
        policy=how,
        refresh=build_fleet_reloader(inventory, tasks, accept_new=accept_new),
        control=Control(),
    )
    loaded = load_inputs(inventory, tasks)
    fleet = build_fleet(loaded, accept_new=accept_new, asking=False)
    raise Exit(_show_cycles(fleet, given, output, loaded.inventory.fleet))


def _parse_period(text: str) -> float:
    """The period in s.

    Raises:
        UsageError: no duration, or too short.
    """
    from edgectl.cli.connect import parse_duration_option

    period = parse_duration_option(text, "--every")
    if period < _MIN_PERIOD_S:
        raise UsageError(f"--every {text} is too short", hint="write 1s or more")
    return period


def _show_cycles(fleet: Fleet, given: "WatchOptions", output: OutputFormat, name: str) -> ExitCode:
    """Watch and show each cycle, until the last one or a signal."""
    from edgectl.cli.signals import stop_control_on_signal
    from edgectl.usecases.watch import watch_fleet

    last: Cycle | None = None
    with (
        stop_control_on_signal(given.control) as signals,
        _open_cycle_printer(output, name, given.policy(fleet), given) as show,
    ):
        for last in _yield_and_close(watch_fleet(fleet, given)):
            show(last)
    if given.control.stop_requested.is_set() or last is None:
        return ExitCode.INTERRUPTED if signal.SIGINT in signals[:1] else ExitCode.DONE
    return exit_codes.of_cycle(last)


def _yield_and_close(cycles: Iterator[Cycle]) -> Iterator[Cycle]:
    with contextlib.closing(cycles):  # type: ignore[type-var]
        yield from cycles


@contextlib.contextmanager
def _open_cycle_printer(
    output: OutputFormat, name: str, policy: Policy, given: "WatchOptions"
) -> Iterator[CyclePrinter]:
    """A function that shows each cycle: draws it, prints its line, or prints its object."""
    from edgectl.cli.terminal import is_foreground, listen_for_keys
    from edgectl.views import watch_cycle

    if output is OutputFormat.JSONL:
        yield lambda cycle: console.print_view(watch_cycle.CycleView(cycle), output)
        return
    if not (sys.stdout.isatty() and is_foreground() and os.environ.get("TERM") != "dumb"):
        console.print_message(
            f"watching {name} every {format_duration(given.every)}; "
            + ("plans are applied" if given.apply else "plans are not applied")
        )
        yield _build_line_printer(watch_cycle.render_cycle_line)
        return
    from edgectl.views.watch_screen import WatchScreen, WatchTitle, show_watch_screen

    title = WatchTitle(fleet=name, weights=watch_cycle.format_weights(policy.weights), applies=given.apply)
    control = given.control
    screen = WatchScreen(title, lambda: control.paused)
    wanted = {"q": control.stop, "p": control.now, "a": control.pause}
    with show_watch_screen(screen), listen_for_keys(lambda key: wanted.get(key.lower(), _ignore_key)()):
        yield screen.show


def _build_line_printer(line: Callable[[Cycle | None, Cycle], str]) -> CyclePrinter:
    """A function that prints the line of each cycle that has one."""
    before: list[Cycle] = []

    def show(cycle: Cycle) -> None:
        text = line(before[0] if before else None, cycle)
        before[:] = [cycle]
        if text:
            console.print_text(text)

    return show


def _ignore_key() -> None:
    """Ignore a key."""
