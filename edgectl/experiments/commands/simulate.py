"""simulate."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from edgectl.cli import console, options
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat


def simulate_command(
    *,
    scenario: Annotated[Path, Argument(metavar="SCENARIO", help="A scenario file.")],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ExplainOutput = OutputFormat.TABLE,
    policies: options.PoliciesOption = "local,static,utility",
    weights: options.WeightsListOption = "cpu,memory,network,all",
    runs: Annotated[
        int, Option("--runs", "-n", metavar="N", min=1, max=1000, help="Runs of each scheme.")
    ] = 5,
    seed: Annotated[int, Option("--seed", metavar="N", help="Of everything that is drawn at random.")] = 1,
    against: Annotated[
        Path | None,
        Option("--against", metavar="RUN", help="Beside what this run of an experiment measured."),
    ] = None,
) -> None:
    """Run a mission in a closed-loop model under several schemes; the scheduler and the diff are the real ones.

    Inventory and tasks are those that the scenario names; the schemes local, static, and utility with the weights cpu, memory, network and
    all. Below each stands what was published of the real thing, or with --against what an experiment measured, and how far the model
    is off. Needs the extra edgectl[evidence].

    Examples:
        edgectl simulate docs/scenarios/paper-2.yaml --runs 2
        edgectl simulate docs/scenarios/paper-1.yaml --policy local,static --seed 7
        edgectl simulate docs/scenarios/paper-2.yaml --weights all -n 1 -o json
        edgectl simulate docs/scenarios/paper-2.yaml --against docs/examples/run
    """
    from edgectl.cli.extras import require_extra
    from edgectl.experiments.commands.scheme_options import parse_schemes
    from edgectl.experiments.files.run_directory import load_run
    from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
    from edgectl.experiments.reference_values import reference_from_run, reference_from_scenario

    with require_extra("evidence"):
        from edgectl.experiments.simulator_runs import simulate_schemes

    run = None if against is None else load_run(against)
    named = load_scenario_paths(scenario)
    loaded = load_inputs(inventory or named[0], tasks or ([named[1]] if named[1] else None))
    world = load_scenario(scenario, loaded.inventory, loaded.tasks)
    chosen = parse_schemes(loaded.tasks.policy, policies, weights, [])
    found = list(simulate_schemes(loaded.inventory, loaded.tasks, world, chosen, runs=runs, seed=seed))
    real = reference_from_scenario(world) if run is None else reference_from_run(found, run)
    console.print_view(output, "simulated", world, found, real)
