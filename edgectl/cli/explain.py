# SPDX-License-Identifier: Apache-2.0
"""explain command."""

from typing import Annotated

from typer import Argument, Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.task_names import resolve_task_name
from edgectl.cli.user_files import load_inputs
from edgectl.names import check_known_names
from edgectl.views.output_format import OutputFormat


def _complete_words(incomplete: str) -> list[str]:
    from edgectl.cli.completion import complete_tasks
    from edgectl.config.key_reference import list_reference_words

    words = list_reference_words() if incomplete else ()
    return [*complete_tasks(incomplete), *(word for word in words if word.startswith(incomplete))]


def explain_command(
    *,
    task: Annotated[
        str,
        Argument(
            metavar="TASK",
            autocompletion=_complete_words,
            parser=options.strip_task_kind,
            help="A task; or a key, a code, a check.",
            show_default=False,
        ),
    ],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.WideOutput = OutputFormat.TABLE,
    snapshot: options.SnapshotOption = None,
    weights: options.WeightsOption = None,
    policy: options.PolicyOption = None,
    without: options.WithoutOption = None,
    allow_unreachable: options.AllowUnreachableOption = False,
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Explain a placement: the contribution of each term, and the smallest changes that would change the
    host.

    Each change is checked by a new plan; tasks that would move first are named. A lead below the variation of
    the measurements is called fragile.

    TASK may be a key of a file (task.demand.cpu, edge.limits, inventory.fleet), the code of a problem (EC101)
    or a check of the doctor (check.clock): its meaning is printed, offline.

    Examples:
        edgectl explain slam-robot1
        edgectl explain slam-robot1 -o wide
        edgectl explain task.demand.cpu
        edgectl explain EC101
    """
    from edgectl.cli.connect import build_fleet, build_offline_fleet
    from edgectl.cli.policy_options import policy_from_options
    from edgectl.config.documents import load_snapshot
    from edgectl.config.key_reference import find_reference, is_reference_word
    from edgectl.usecases.explain import compute_noise_by_host, explain_placement
    from edgectl.usecases.history import find_last_carries
    from edgectl.usecases.plan import is_what_if, make_plan
    from edgectl.views.explanation import ExplanationView
    from edgectl.views.notes import list_lost_task_notes, list_unreachable_notes
    from edgectl.views.plan_sections import list_slack_notes

    if is_reference_word(task):
        from edgectl.views.reference import ReferenceView

        console.print_view(ReferenceView(find_reference(task)), output)
        return
    loaded = load_inputs(inventory, tasks)
    task = resolve_task_name(task, loaded.tasks)
    check_known_names([task], loaded.tasks.tasks, "task")
    fleet = build_offline_fleet(loaded) if snapshot else build_fleet(loaded, accept_new=accept_new)
    overrides = options.PolicyOptions(weights=weights, policy=policy, without=without)
    how = policy_from_options(fleet, overrides)
    made = make_plan(
        fleet,
        how,
        snapshot=load_snapshot(snapshot) if snapshot else None,
        recorded=not is_what_if(fleet, how),
    )
    found = explain_placement(fleet, made, task, None if snapshot else compute_noise_by_host(fleet))
    step = next(step for step in made.steps if step.task == task)
    stated = loaded.tasks.tasks[task]
    carried = find_last_carries(fleet).get(task) if stated.state is not None and not snapshot else None
    view = ExplanationView(
        step,
        found,
        list_unreachable_notes(made.snapshot),
        made.snapshot.manager,
        task=stated,
        carried=carried,
    )
    console.print_view(view, output, fleet=fleet.inventory.fleet)
    console.print_notes(list_lost_task_notes(made.snapshot, {task}) + list_slack_notes(made, {task}))
    raise Exit(exit_codes.of_plan(made, detailed=False, allow_unreachable=allow_unreachable))
