# SPDX-License-Identifier: Apache-2.0
"""The commands experiment run and experiment show."""

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, options
from edgectl.cli.user_files import load_named_inputs
from edgectl.errors import ExitCode, UsageError
from edgectl.experiments.commands.scheme_options import EquivalenceOption, parse_equivalence
from edgectl.views.output_format import EXPERIMENT_FORMATS, OutputFormat

if TYPE_CHECKING:
    from edgectl.experiments.model.experiment import Experiment, ExperimentRun
    from edgectl.usecases.fleet import Fleet

RUNS_DIR = Path("runs")
_INTERRUPT_NOTICE = "ending the trial and stopping its tasks; press Ctrl-C again to stop at once"
ExperimentOutput = Annotated[OutputFormat, options.build_output_option(EXPERIMENT_FORMATS)]

_RepetitionsOption = Annotated[
    int | None,
    Option("--repetitions", "-n", metavar="N", min=1, max=1000, help="Instead of the number in SPEC."),
]


def experiment_run_command(
    *,
    spec: Annotated[Path, Argument(metavar="SPEC", help="An experiment file.", show_default=False)],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: ExperimentOutput = OutputFormat.TABLE,
    out: Annotated[
        Path | None, Option("--out", metavar="DIR", help="Directory of the run; default: runs/NAME.")
    ] = None,
    repetitions: _RepetitionsOption = None,
    dry_run: options.DryRunMarkOption = False,
    lock_timeout: options.LockTimeoutOption = None,
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Run a mission on the real hosts, repeatedly under each scheme, and compare the results.

    The fleet must be idle before each trial and is cleared after it. To resume an interrupted experiment,
    repeat the command: it runs the trials that are missing. Ctrl-C ends the current trial and stops its
    tasks. Exit code 4 if a mission did not end before its limit.

    Examples:
        edgectl experiment run tasks/patrol/experiment.yaml
        edgectl experiment run tasks/patrol/experiment.yaml -n 1 --out again
        edgectl experiment run tasks/patrol/experiment.yaml --dry-run
    """
    from edgectl.cli.connect import build_fleet, parse_lock_timeout
    from edgectl.cli.signals import stop_control_on_signal
    from edgectl.cli.user_files import select_exposed
    from edgectl.config.problems import Problems
    from edgectl.experiments.commands.person import ask_person
    from edgectl.experiments.files.experiment_file import load_experiment, load_experiment_paths
    from edgectl.experiments.runner import ExperimentOptions, run_experiment
    from edgectl.experiments.views.progress import show_trial_progress
    from edgectl.usecases.control import Control

    named_inventory, named_tasks = load_experiment_paths(spec)
    loaded = load_named_inputs(inventory, tasks, named_inventory, named_tasks)
    problems = Problems()
    experiment = load_experiment(spec, loaded.inventory, loaded.tasks, problems)
    loaded = replace(loaded, exposed=(*loaded.exposed, *select_exposed(problems.warnings)))
    experiment = replace(experiment, repetitions=repetitions or experiment.repetitions)
    _check_truth_maps(experiment, spec.parent)
    directory = out or RUNS_DIR / experiment.name
    if dry_run:
        _print_missing_trials(build_fleet(loaded, asking=False), experiment, directory)
        return
    control = Control()
    with (
        stop_control_on_signal(control, _INTERRUPT_NOTICE),
        show_trial_progress(len(experiment.schemes) * experiment.repetitions) as listener,
    ):
        given = ExperimentOptions(
            directory=directory,
            spec_directory=spec.parent,
            lock_timeout=parse_lock_timeout(lock_timeout),
            listener=listener,
            control=control,
            debug=bool(os.environ.get("EDGECTL_DEBUG")),
            ask=ask_person,
        )
        run = run_experiment(build_fleet(loaded, accept_new=accept_new, asking=False), experiment, given)
    _print_experiment(output, run)
    if control.stop_requested.is_set():
        raise Exit(ExitCode.INTERRUPTED)
    if not all(trial.finished for trial in run.trials):
        raise Exit(ExitCode.PARTLY)


def _print_missing_trials(fleet: "Fleet", experiment: "Experiment", directory: Path) -> None:
    from edgectl.experiments.runner import list_missing_trials
    from edgectl.views.marks import DRY_RUN_SUFFIX

    missing = list_missing_trials(fleet, experiment, directory)
    for scheme, repetition in missing:
        console.print_text(f"trial/{scheme.name}/{repetition} run{DRY_RUN_SUFFIX}\n")
    if not missing:
        console.print_message(f"no trial is missing in {directory}")


def _check_truth_maps(experiment: "Experiment", directory: Path) -> None:
    """Refuse an unusable ground truth before the first trial, not after it."""
    from edgectl.cli.extras import require_extra

    if experiment.maps:
        with require_extra("evidence"):
            from edgectl.experiments.map_comparison import check_truth_map
        for pair in experiment.maps.values():
            check_truth_map(directory / pair.truth)


def experiment_show_command(
    *,
    run: Annotated[
        Path | None,
        Argument(
            metavar="[RUN]", help="Directory of a run; default: the newest in runs/.", show_default=False
        ),
    ] = None,
    output: ExperimentOutput = OutputFormat.TABLE,
    equivalence: EquivalenceOption = None,
) -> None:
    """Compare the results of an experiment so far. No host is contacted.

    Examples:
        edgectl experiment show docs/examples/run
        edgectl experiment show docs/examples/run -o markdown
    """
    from edgectl.experiments.files.run_directory import load_run

    bound = parse_equivalence(equivalence)
    _print_experiment(output, load_run(resolve_run_directory(run)), bound)


def resolve_run_directory(given: Path | None) -> Path:
    """The directory given, otherwise the newest run in runs/.

    Raises:
        UsageError: there is none.
    """
    from edgectl.experiments.files.run_directory import find_newest_run

    found = given or find_newest_run(RUNS_DIR)
    if found is None:
        raise UsageError(
            f"no run in {RUNS_DIR}/",
            hint="name the directory of a run, or create one: edgectl experiment run SPEC",
        )
    return found


def _print_experiment(output: OutputFormat, run: "ExperimentRun", bound: float | None = None) -> None:
    """``bound``: of equivalence, instead of that of the experiment file."""
    from edgectl.experiments.event_results import add_trial_events
    from edgectl.experiments.scheme_comparison import compare_schemes
    from edgectl.experiments.scheme_results import summarize_trials
    from edgectl.experiments.views.experiment import ExperimentView

    results = add_trial_events(run, summarize_trials(run))
    compared = compare_schemes(results, bound or run.experiment.equivalence)
    console.print_view(ExperimentView(run=run, results=results, comparisons=compared), output)
