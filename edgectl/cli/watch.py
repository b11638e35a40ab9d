"""watch."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Annotated

from typer import Exit, Option

from edgectl.cli import console, exits, options
from edgectl.cli.inputs import load
from edgectl.errors import ExitCode, UsageError
from edgectl.model.cycle import Cycle
from edgectl.model.policy import Policy
from edgectl.usecases.control import Control
from edgectl.usecases.fleet import Fleet
from edgectl.views.form import Form

_SHORTEST_S = 1.0
_ApplyOption = Annotated[bool, Option("--apply", help="Carry the plans out, unasked.")]
_EveryOption = Annotated[str, Option("--every", metavar="TIME", help="From one cycle to the next.")]
_CyclesOption = Annotated[int | None, Option("--cycles", metavar="N", min=1, help="End after N cycles.")]
Show = Callable[[Cycle], None]


def watch_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.RoundsOutput = Form.TABLE,
    apply: _ApplyOption = False,
    every: _EveryOption = "10s",
    cycles: _CyclesOption = None,
    max_parallel: options.ParallelOption = 16,
    weights: options.WeightsOption = None,
    policy: options.PolicyOption = None,
    best_effort: options.BestEffortOption = False,
    without: options.WithoutOption = None,
    accept_new: options.AcceptOption = False,
) -> None:
    """Look at the fleet again and again, plan each time, and with --apply keep everything where it should be.

    On a terminal: a live view; q quits, p plans now, a pauses. Elsewhere: a line where something happened. SIGTERM ends it with 0.

    Examples:
        edgectl watch --cycles 3 --every 2s
        edgectl watch --apply --every 30s
        edgectl watch -o jsonl --cycles 1
    """
    from edgectl.cli import decide
    from edgectl.cli.reach import reach, seconds
    from edgectl.cli.refresh import refreshing
    from edgectl.cli.until import obeying
    from edgectl.usecases.watch import WatchOptions, watch

    pause = seconds(every, "--every")
    if pause < _SHORTEST_S:
        raise UsageError(f"--every {every} is too often", hint="write 1s or more")

    def how(fleet: Fleet) -> Policy:
        return decide.policy_of(fleet, weights=weights, policy=policy, without=without, best_effort=best_effort, full=False, attended=False)

    refresh = refreshing(inventory, tasks, accept_new=accept_new)
    loaded, control = load(inventory, tasks), Control()
    fleet = reach(loaded, accept_new=accept_new, asking=False)
    given = WatchOptions(
        every=pause,
        apply=apply,
        cycles=cycles,
        max_parallel=max_parallel,
        debug=bool(os.environ.get("EDGECTL_DEBUG")),
        policy=how,
        refresh=refresh,
        control=control,
    )
    last: Cycle | None = None
    with obeying(control) as signals, _showing(output, loaded.path.stem, how(fleet), control, apply=apply) as show:
        for last in _closing(watch(fleet, given)):
            show(last)
    if control.stop_requested.is_set() or last is None:
        raise Exit(ExitCode.INTERRUPTED if signal.SIGINT in signals[:1] else ExitCode.DONE)
    raise Exit(exits.of_cycle(last))


def _closing(cycles: Iterator[Cycle]) -> Iterator[Cycle]:
    with contextlib.closing(cycles):  # type: ignore[type-var]
        yield from cycles


@contextlib.contextmanager
def _showing(output: Form, name: str, policy: Policy, control: Control, *, apply: bool) -> Iterator[Show]:
    """What to do with each cycle: draw it, write its line, or write its object."""
    from edgectl.cli.keys import in_front, keys
    from edgectl.views import rounds
    from edgectl.views.form import view

    if output is not Form.TABLE:
        view(output, "cycle")  # refuse an unknown form before anything is done
        yield lambda cycle: console.show(output, "cycle", cycle)
        return
    if not (sys.stdout.isatty() and in_front() and os.environ.get("TERM") != "dumb"):
        yield _lines(rounds.line)
        return
    from edgectl.views.live import Screen, Title, live

    title = Title(fleet=name, variant=rounds.variant(policy.weights), applies=apply)
    screen = Screen(title, lambda: control.paused)
    wanted = {"q": control.stop, "p": control.now, "a": control.pause}
    with live(screen), keys(lambda key: wanted.get(key.lower(), _nothing)()):
        yield screen.show


def _lines(line: Callable[[Cycle | None, Cycle], str]) -> Show:
    """Write the line of each cycle that has one."""
    before: list[Cycle] = []

    def show(cycle: Cycle) -> None:
        text = line(before[0] if before else None, cycle)
        before[:] = [cycle]
        if text:
            console.put(text)

    return show


def _nothing() -> None:
    """A key that means nothing."""
