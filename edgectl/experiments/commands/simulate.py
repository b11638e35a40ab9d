# SPDX-License-Identifier: Apache-2.0
"""The command simulate run."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, options
from edgectl.cli.user_files import load_named_inputs
from edgectl.errors import ExitCode
from edgectl.experiments.commands.scheme_options import EquivalenceOption, PoliciesOption, WeightsListOption
from edgectl.views.output_format import OutputFormat


def simulate_run_command(
    *,
    scenario: Annotated[Path, Argument(metavar="SCENARIO", help="A scenario file.")],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.WideOutput = OutputFormat.TABLE,
    policies: PoliciesOption = "local,static,utility",
    weights: WeightsListOption = "cpu,memory,network,all",
    runs: Annotated[
        int, Option("--runs", "-n", metavar="N", min=1, max=1000, help="Runs of each scheme.")
    ] = 20,
    seed: Annotated[int, Option("--seed", metavar="N", help="Random seed.")] = 1,
    against: Annotated[
        Path | None,
        Option("--against", metavar="RUN", help="Compare with the results of this experiment run."),
    ] = None,
    equivalence: EquivalenceOption = None,
) -> None:
    """Simulate a mission under several schemes in a closed loop, with the real scheduler and diff.

    Inventory and tasks default to those named in the scenario; the default schemes are local, static, and
    utility with the weights cpu, memory, network and all. Below each scheme are the published values, or with
    --against those of an experiment, and the deviation of the model. Exit code 4 if a mission does not end
    before its limit. Requires the extra evidence.

    Examples:
        edgectl simulate run docs/scenarios/paper-2.yaml --runs 2
        edgectl simulate run docs/scenarios/paper-1.yaml --policy static --seed 7
        edgectl simulate run docs/scenarios/paper-2.yaml --weights all -n 1 -o json
        edgectl simulate run docs/scenarios/paper-2.yaml --against docs/examples/run
    """
    from edgectl.cli.extras import require_extra
    from edgectl.experiments.commands.scheme_options import parse_equivalence, parse_simulated_schemes
    from edgectl.experiments.files.run_directory import load_run
    from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
    from edgectl.experiments.reference_values import reference_from_run, reference_from_scenario
    from edgectl.experiments.scheme_comparison import compare_schemes
    from edgectl.experiments.views.simulation import SimulationView

    with require_extra("evidence"):
        from edgectl.experiments.simulator_runs import simulate_schemes

    bound = parse_equivalence(equivalence)
    run = None if against is None else load_run(against)
    named_inventory, named_tasks = load_scenario_paths(scenario)
    loaded = load_named_inputs(inventory, tasks, named_inventory, named_tasks)
    mission = load_scenario(scenario, loaded.inventory, loaded.tasks)
    schemes = parse_simulated_schemes(loaded.tasks.policy, policies, weights)
    results = list(simulate_schemes(loaded.inventory, loaded.tasks, mission, schemes, runs=runs, seed=seed))
    reference = reference_from_scenario(mission) if run is None else reference_from_run(results, run)
    compared = compare_schemes(results, bound)
    view = SimulationView(scenario=mission, results=results, reference=reference, comparisons=compared)
    console.print_view(view, output)
    if any(result.unfinished for result in results):
        raise Exit(ExitCode.PARTLY)
