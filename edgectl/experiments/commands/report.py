"""report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from edgectl.cli import console
from edgectl.errors import UsageError
from edgectl.experiments.commands.experiment import resolve_run_directory

if TYPE_CHECKING:
    from edgectl.experiments.model.experiment import ExperimentRun
    from edgectl.experiments.report.page import ReportTable


def report_command(
    *,
    run: Annotated[
        Path | None,
        Argument(metavar="[RUN]", help="Directory of a run; the newest in runs/.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        Option("--out", metavar="FILE", help="The page, instead of RUN/report.html.", show_default=False),
    ] = None,
    figures: Annotated[
        Path | None, Option("--figures", metavar="DIR", help="Write every figure there, as SVG and PDF.")
    ] = None,
) -> None:
    """Write a run of an experiment as one HTML page with its table and figures, and print the names of the files.

    The page needs no network and no script. A run that is still going on, or was interrupted, is reported as far as it is.
    Needs the extra edgectl[report].

    Examples:
        edgectl report docs/examples/run --out report.html
        edgectl report docs/examples/run --out report.html --figures figures
    """
    import logging

    from edgectl.cli.extras import require_extra
    from edgectl.cli.user_files import make_directory, save_file
    from edgectl.experiments.files.run_directory import load_run

    logging.getLogger("matplotlib").setLevel(
        logging.ERROR
    )  # where it keeps its list of fonts, and that it makes one, is no news
    with require_extra("report"):
        from edgectl.experiments.report.report import build_report_files

    directory = resolve_run_directory(run)
    found = load_run(directory)
    if not found.trials:
        raise UsageError(
            f"no trial of {directory} has ended yet",
            hint="wait for the first one, or go on: edgectl experiment run SPEC",
        )
    if figures is not None:
        make_directory(figures)
    for path, data in build_report_files(
        found, _build_report_table(found), out or directory / "report.html", figures
    ):
        save_file(path, data)
        console.print_text(f"{path}\n")


def _build_report_table(run: "ExperimentRun") -> "ReportTable":
    """The same table as everywhere, with every metric."""
    from edgectl.experiments.report.page import ReportTable
    from edgectl.experiments.scheme_results import summarize_trials
    from edgectl.experiments.views.experiment import build_experiment_rows, describe_experiment

    values = summarize_trials(run)
    words = [
        [str(getattr(cell, "text", cell)) for cell in row]
        for row in build_experiment_rows(run.experiment, values, every=True)
    ]
    return ReportTable(rows=words, notes=list(describe_experiment(run.experiment, values, every=True)))
