# SPDX-License-Identifier: Apache-2.0
"""plan command."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from typer import Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs, save_file
from edgectl.errors import UsageError
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.model.plan import Plan
    from edgectl.model.policy import Policy
    from edgectl.model.snapshot import Snapshot
    from edgectl.usecases.fleet import Fleet


def plan_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.PlanOutput = OutputFormat.TABLE,
    snapshot: options.SnapshotOption = None,
    out: options.SavePlanOption = None,
    overrides: options.PlanPolicyOptions,
    limits: options.PlanFilterOptions,
    watch: options.WatchOption = False,
    every: options.EveryOption = "2s",
    detailed: options.DetailedExitcodeOption = False,
    allow_unreachable: options.AllowUnreachableOption = False,
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Rank hosts for each task by utility and show the changes, with reasons. Nothing is changed.

    With -w, plan repeatedly and print the plan when it differs (edgectl watch also smooths loads).

    Examples:
        edgectl plan
        edgectl plan -o wide --weights network
        edgectl plan --out next.plan
        edgectl plan -w --every 5s
    """
    from edgectl.cli.connect import build_fleet, build_offline_fleet
    from edgectl.cli.policy_options import build_plan_filter, policy_from_options, require_solver
    from edgectl.usecases.plan import is_what_if, make_plan
    from edgectl.views.output import render_view
    from edgectl.views.plan import PlanView

    loaded = load_inputs(inventory, tasks)
    choose = build_plan_filter(loaded.tasks, limits)
    fleet = build_offline_fleet(loaded) if snapshot else build_fleet(loaded, accept_new=accept_new)
    how = policy_from_options(fleet, overrides)
    require_solver(how)
    if watch:
        if snapshot is not None or out is not None:
            raise UsageError("-w plans from hosts, again and again", hint="omit --snapshot and --out")
        return _watch_plans(fleet, how, choose, every, output)
    seen = None
    if snapshot:
        from edgectl.config.documents import load_snapshot

        seen = load_snapshot(snapshot)
    result = choose(make_plan(fleet, how, snapshot=seen, recorded=not is_what_if(fleet, how)))
    _warn_of_former_fleet(fleet, result)
    carried = None
    stateful = any(task.state is not None for task in loaded.tasks.tasks.values())
    if output is OutputFormat.WIDE and stateful and not snapshot:
        from edgectl.usecases.history import find_last_carries

        carried = find_last_carries(fleet)
    view = PlanView(result, loaded.tasks, carried, now=None if snapshot else fleet.clock())
    if out is not None:
        save_file(out, render_view(view, OutputFormat.JSON))
        console.print_message(f"saved {out}; apply it with: edgectl apply {out}")
    console.print_view(view, output)
    raise Exit(exit_codes.of_plan(result, detailed=detailed, allow_unreachable=allow_unreachable))


def _warn_of_former_fleet(fleet: "Fleet", plan: "Plan") -> None:
    if fleet.inventory.is_fleet_named:
        return
    from edgectl.rules.former_fleet import find_former_fleet
    from edgectl.state.lock import describe_manager

    found = find_former_fleet(fleet.inventory, plan.steps, plan.snapshot, describe_manager())
    if found is not None:
        console.print_message(f"warning: {found.message}\nhint: {found.hint}")


def _watch_plans(
    fleet: "Fleet", how: "Policy", choose: "Callable[[Plan], Plan]", every: str, output: OutputFormat
) -> None:
    """Each plan that decides otherwise than the one before, until Ctrl-C."""
    from edgectl.cli.signals import catch_stop_signals, parse_every_option
    from edgectl.usecases.plan import make_plan
    from edgectl.usecases.status import probe_repeatedly
    from edgectl.views.output_format import NAMED_STREAM_FORMATS, check_output_format
    from edgectl.views.plan import PlanView

    check_output_format(output, NAMED_STREAM_FORMATS)

    def list_changed(snapshots: "Iterator[Snapshot]") -> "Iterator[PlanView]":
        before: object = None
        for snapshot in snapshots:
            plan = choose(make_plan(fleet, how, snapshot=snapshot, recorded=False))
            decided = [(step.task, step.action, step.decision.host, step.stop) for step in plan.steps]
            if decided != before:
                yield PlanView(plan, now=fleet.clock())
            before = decided

    with catch_stop_signals(parse_every_option(every)) as end:
        console.print_view_series(list_changed(probe_repeatedly(fleet, end)), output)
