"""simulate."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from edgectl.cli import console, options
from edgectl.cli.inputs import load
from edgectl.views.form import Form


def simulate_command(
    *,
    scenario: Annotated[Path, Argument(metavar="SCENARIO", help="A scenario file.")],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ExplainOutput = Form.TABLE,
    policies: options.PoliciesOption = "local,static,utility",
    weights: options.WeightsListOption = "cpu,memory,network,all",
    runs: Annotated[int, Option("--runs", "-n", metavar="N", min=1, max=1000, help="Runs of each scheme.")] = 5,
    seed: Annotated[int, Option("--seed", metavar="N", help="Of everything that is drawn at random.")] = 1,
    against: Annotated[Path | None, Option("--against", metavar="RUN", help="Beside what this run of an experiment measured.")] = None,
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
    from edgectl.cli.compare import variants_of
    from edgectl.cli.extras import extra
    from edgectl.config.scenario import load_scenario, scenario_files
    from edgectl.evidence.reality import measured, published
    from edgectl.state.runs import read_run

    with extra("evidence"):
        from edgectl.usecases.simulate import simulate

    run = None if against is None else read_run(against)
    named = scenario_files(scenario)
    loaded = load(inventory or named[0], tasks or ([named[1]] if named[1] else None))
    world = load_scenario(scenario, loaded.inventory, loaded.tasks)
    chosen = variants_of(loaded.tasks.policy, policies, weights, [])
    found = list(simulate(loaded.inventory, loaded.tasks, world, chosen, runs=runs, seed=seed))
    real = published(world) if run is None else measured(found, run)
    console.show(output, "simulated", world, found, real)
