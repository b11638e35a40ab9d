"""experiment run, experiment show."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, options
from edgectl.cli.inputs import load
from edgectl.errors import ExitCode, UsageError
from edgectl.model.experiment import Run
from edgectl.views.form import Form

RUNS = Path("runs")
_ENDING = "ending the trial and stopping its tasks; Ctrl-C again stops at once"


def experiment_run_command(
    *,
    spec: Annotated[Path, Argument(metavar="SPEC", help="A spec file.", show_default=False)],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.MeasuredOutput = Form.TABLE,
    out: Annotated[Path | None, Option("--out", metavar="DIR", help="Where the run is kept; runs/NAME where not given.")] = None,
    repetitions: Annotated[int | None, Option("--repetitions", "-n", metavar="N", min=1, max=1000, help="Instead of the spec's.")] = None,
    lock_timeout: options.LockOption = "0s",
    accept_new: options.AcceptOption = False,
) -> None:
    """Run a mission on the real hosts, under several schemes, several times, and compare what was measured.

    The fleet must be idle, and is again after each trial. Stopped at any point, the same command goes on with the trials that are missing.
    Ctrl-C ends the trial that is under way and stops its tasks.

    Examples:
        edgectl experiment run tasks/mission/experiment.yaml
        edgectl experiment run tasks/mission/experiment.yaml -n 1 --out again
    """
    from edgectl.cli.extras import extra
    from edgectl.cli.reach import reach, seconds
    from edgectl.cli.until import obeying
    from edgectl.config.experiment import experiment_files, load_experiment
    from edgectl.usecases.control import Control
    from edgectl.usecases.experiment import ExperimentOptions, experiment
    from edgectl.views.form import view
    from edgectl.views.progress import trying

    view(output, "measured")  # refuse an unknown form before anything is done
    named = experiment_files(spec)
    loaded = load(inventory or named[0], tasks or ([named[1]] if named[1] else None))
    wanted = load_experiment(spec, loaded.tasks)
    wanted = replace(wanted, repetitions=repetitions or wanted.repetitions)
    if wanted.maps:
        with extra("evidence"):
            from edgectl.usecases.maps import check
        for pair in wanted.maps.values():  # not found out after the first trial
            check(spec.parent / pair.truth)
    control = Control()
    with obeying(control, _ENDING), trying(len(wanted.variants) * wanted.repetitions) as watcher:
        given = ExperimentOptions(
            directory=out or RUNS / wanted.name,
            beside=spec.parent,
            lock_timeout=seconds(lock_timeout, "--lock-timeout"),
            watcher=watcher,
            control=control,
            debug=bool(os.environ.get("EDGECTL_DEBUG")),
        )
        run = experiment(reach(loaded, accept_new=accept_new, asking=False), wanted, given)
    _show(output, run)
    if control.stop_requested.is_set():
        raise Exit(ExitCode.INTERRUPTED)


def experiment_show_command(
    *,
    run: Annotated[Path | None, Argument(metavar="[RUN]", help="Directory of a run; the newest in runs/.", show_default=False)] = None,
    output: options.MeasuredOutput = Form.TABLE,
) -> None:
    """Compare what an experiment has measured so far. No host is contacted.

    Examples:
        edgectl experiment show docs/examples/run
        edgectl experiment show docs/examples/run -o markdown
    """
    from edgectl.state.runs import read_run

    _show(output, read_run(run_directory(run)))


def run_directory(given: Path | None) -> Path:
    """The run that is given, or the newest in runs/.

    Raises:
        UsageError: there is none.
    """
    from edgectl.state.runs import newest_run

    found = given or newest_run(RUNS)
    if found is None:
        raise UsageError(f"there is no run in {RUNS}/", hint="name one, or make one: edgectl experiment run SPEC")
    return found


def _show(output: Form, run: Run) -> None:
    from edgectl.evidence.measured import columns

    console.show(output, "measured", run, columns(run))
