"""experiment run, experiment show."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, options
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode, UsageError
from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.views.output_format import OutputFormat

RUNS_DIR = Path("runs")
_INTERRUPT_NOTICE = "ending the trial and stopping its tasks; Ctrl-C again stops at once"


def experiment_run_command(
    *,
    spec: Annotated[Path, Argument(metavar="SPEC", help="A spec file.", show_default=False)],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ExperimentOutput = OutputFormat.TABLE,
    out: Annotated[
        Path | None, Option("--out", metavar="DIR", help="Where the run is kept; runs/NAME where not given.")
    ] = None,
    repetitions: Annotated[
        int | None, Option("--repetitions", "-n", metavar="N", min=1, max=1000, help="Instead of the spec's.")
    ] = None,
    lock_timeout: options.LockTimeoutOption = "0s",
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Run a mission on the real hosts, under several schemes, several times, and compare what was measured.

    The fleet must be idle, and is again after each trial. Stopped at any point, the same command goes on with the trials that are missing.
    Ctrl-C ends the trial that is under way and stops its tasks.

    Examples:
        edgectl experiment run tasks/mission/experiment.yaml
        edgectl experiment run tasks/mission/experiment.yaml -n 1 --out again
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.cli.extras import require_extra
    from edgectl.cli.signals import stop_control_on_signal
    from edgectl.experiments.files.experiment_file import load_experiment, load_experiment_paths
    from edgectl.experiments.runner import ExperimentOptions, run_experiment
    from edgectl.usecases.control import Control
    from edgectl.views.output_format import get_renderer
    from edgectl.views.progress import show_trial_progress

    get_renderer(output, "measured")  # refuse an unknown form before anything is done
    named = load_experiment_paths(spec)
    loaded = load_inputs(inventory or named[0], tasks or ([named[1]] if named[1] else None))
    wanted = load_experiment(spec, loaded.tasks)
    wanted = replace(wanted, repetitions=repetitions or wanted.repetitions)
    if wanted.maps:
        with require_extra("evidence"):
            from edgectl.experiments.map_comparison import check_truth_map
        for pair in wanted.maps.values():  # not found out after the first trial
            check_truth_map(spec.parent / pair.truth)
    control = Control()
    with (
        stop_control_on_signal(control, _INTERRUPT_NOTICE),
        show_trial_progress(len(wanted.schemes) * wanted.repetitions) as watcher,
    ):
        given = ExperimentOptions(
            directory=out or RUNS_DIR / wanted.name,
            beside=spec.parent,
            lock_timeout=parse_duration_option(lock_timeout, "--lock-timeout"),
            watcher=watcher,
            control=control,
            debug=bool(os.environ.get("EDGECTL_DEBUG")),
        )
        run = run_experiment(build_fleet(loaded, accept_new=accept_new, asking=False), wanted, given)
    _print_experiment(output, run)
    if control.stop_requested.is_set():
        raise Exit(ExitCode.INTERRUPTED)


def experiment_show_command(
    *,
    run: Annotated[
        Path | None,
        Argument(metavar="[RUN]", help="Directory of a run; the newest in runs/.", show_default=False),
    ] = None,
    output: options.ExperimentOutput = OutputFormat.TABLE,
) -> None:
    """Compare what an experiment has measured so far. No host is contacted.

    Examples:
        edgectl experiment show docs/examples/run
        edgectl experiment show docs/examples/run -o markdown
    """
    from edgectl.experiments.files.run_directory import load_run

    _print_experiment(output, load_run(resolve_run_directory(run)))


def resolve_run_directory(given: Path | None) -> Path:
    """The run that is given, or the newest in runs/.

    Raises:
        UsageError: there is none.
    """
    from edgectl.experiments.files.run_directory import find_newest_run

    found = given or find_newest_run(RUNS_DIR)
    if found is None:
        raise UsageError(
            f"there is no run in {RUNS_DIR}/", hint="name one, or make one: edgectl experiment run SPEC"
        )
    return found


def _print_experiment(output: OutputFormat, run: ExperimentRun) -> None:
    from edgectl.experiments.scheme_results import summarize_trials

    console.print_view(output, "measured", run, summarize_trials(run))
