# SPDX-License-Identifier: Apache-2.0
"""events command."""

import time
from typing import Annotated, Literal

from typer import Argument, Exit, Option

from edgectl.cli import console, options
from edgectl.cli.completion import complete_entries, complete_hosts
from edgectl.cli.signals import catch_stop_signals
from edgectl.cli.task_names import check_task_names, expand_task_names
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode, UsageError
from edgectl.model.event import EventKind
from edgectl.names import check_known_names
from edgectl.usecases.fleet import Fleet
from edgectl.views.output_format import OutputFormat

_POLL_INTERVAL_S = 1.0
_HostOption = Annotated[
    str | None,
    Option(
        "--host",
        metavar="HOST",
        autocompletion=complete_hosts,
        parser=options.strip_host_kind,
        help="Only events of this host.",
    ),
]
_TaskOption = Annotated[
    str | None,
    Option(
        "--task",
        metavar="TASK",
        autocompletion=complete_entries,
        parser=options.strip_task_kind,
        help="Only events of this task.",
    ),
]


_KindOption = Annotated[
    EventKind | None, Option("--kind", metavar="KIND", help="With test: of this kind.", show_default=False)
]


def events_command(
    *,
    action: Annotated[
        Literal["test"] | None,
        Argument(metavar="[test]", help="Run the on_event programs with an example.", show_default=False),
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
    since: Annotated[str, Option("--since", metavar="TIME", help="Only events newer than this.")] = "24h",
    host: _HostOption = None,
    task: _TaskOption = None,
    watch: Annotated[bool, Option("--watch", "-w", help="Keep watching until Ctrl-C.")] = False,
    kind: _KindOption = None,
    dry_run: Annotated[bool, Option("--dry-run", help="With test: only print the programs.")] = False,
) -> None:
    """List recent events: hosts lost and back, tasks started, moved, failed, and the actions of apply. No
    host is contacted.

    Events are recorded by probe, plan, apply and watch. With -w, -o json prints one object per line. events
    test runs each program of on_event in the inventory, and exits with 1 if one fails.

    Examples:
        edgectl events
        edgectl events --since 7d --task slam-robot1
        edgectl events -w -o json
        edgectl events test --kind task-failed
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.usecases.events import EventFilter, follow_events, list_events
    from edgectl.views.events import EventsView
    from edgectl.views.output_format import STREAM_FORMATS, check_output_format

    if action is not None:
        fleet = build_fleet(load_inputs(inventory, tasks, needs_tasks=False))
        raise Exit(_test_hooks(fleet, kind, output, dry_run=dry_run))
    if watch:
        check_output_format(output, STREAM_FORMATS)
    fleet = build_fleet(load_inputs(inventory, tasks))
    wanted = EventFilter(
        since=time.time() - parse_duration_option(since, "--since"),
        host=host,
        tasks=tuple(expand_task_names([task] if task else [], fleet.tasks)),
    )
    if watch:
        with catch_stop_signals(_POLL_INTERVAL_S) as end:
            batches = enumerate(follow_events(fleet, wanted, end))
            console.print_view_series(
                (EventsView(found, stream=True, first=number == 0) for number, found in batches),
                output,
                fleet=fleet.inventory.fleet,
            )
        return
    found = list_events(fleet, wanted)
    if not found:
        # Checked late: hosts and tasks that left the files have a history, too.
        check_known_names([host] if host else [], fleet.inventory.hosts, "host")
        check_task_names([task] if task else [], fleet.tasks)
    console.print_view(EventsView(found), output, fleet=fleet.inventory.fleet)


def _test_hooks(fleet: Fleet, kind: EventKind | None, output: OutputFormat, *, dry_run: bool) -> ExitCode:
    """Run each hook once and print how it ended.

    Raises:
        UsageError: no hook would run.
    """
    from edgectl.usecases.event_delivery import list_tested_hooks, run_hook_trials
    from edgectl.views.hook_trials import HookTrialsView

    hooks = list_tested_hooks(fleet, kind)
    if not hooks:
        raise UsageError(
            "no program of on_event receives this event"
            if fleet.inventory.on_event
            else "no on_event is stated",
            hint="add on_event: [{command: [..]}] to the inventory",
        )
    if dry_run:
        planned = HookTrialsView([(hook, "", 0.0) for hook in hooks], dry_run=True)
        console.print_view(planned, output)
        return ExitCode.DONE
    trials = run_hook_trials(fleet, kind)
    rows = [(trial.hook, trial.failure, trial.seconds) for trial in trials]
    console.print_view(HookTrialsView(rows), output, fleet=fleet.inventory.fleet)
    return ExitCode.FAILED if any(trial.failure for trial in trials) else ExitCode.DONE
