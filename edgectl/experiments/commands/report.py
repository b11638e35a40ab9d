# SPDX-License-Identifier: Apache-2.0
"""The command report."""

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
        Argument(
            metavar="[RUN]", help="Directory of a run; default: the newest in runs/.", show_default=False
        ),
    ] = None,
    out: Annotated[
        Path | None,
        Option("--out", metavar="FILE", help="HTML file; default: RUN/report.html.", show_default=False),
    ] = None,
    figures: Annotated[
        Path | None,
        Option("--figures", metavar="DIR", help="Write each figure there, as SVG and PDF."),
    ] = None,
) -> None:
    """Render an experiment as an HTML page with table and figures, and print the names of the files written.

    The page is self-contained: no network, no script. An unfinished run is reported as far as it has come.
    Requires the extra report.

    Examples:
        edgectl report docs/examples/run --out report.html
        edgectl report docs/examples/run --out report.html --figures figures
    """
    import logging

    from edgectl.cli.extras import require_extra
    from edgectl.cli.user_files import make_directory, save_file
    from edgectl.experiments.files.run_directory import load_run

    # matplotlib logs the building of its font cache, which is of no interest here.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    with require_extra("report"):
        from edgectl.experiments.report.report import build_report_files

    directory = resolve_run_directory(run)
    loaded = load_run(directory)
    if not loaded.trials:
        raise UsageError(
            f"{directory} has no finished trial yet",
            hint="wait for the first one, or resume: edgectl experiment run SPEC",
        )
    if figures is not None:
        make_directory(figures)
    page = out or directory / "report.html"
    for path, data in build_report_files(loaded, _build_report_table(loaded), page, figures):
        save_file(path, data)
        console.print_text(f"{path}\n")


def _build_report_table(run: "ExperimentRun") -> "ReportTable":
    """The wide table of ``experiment show``."""
    from edgectl.experiments.report.page import ReportTable
    from edgectl.experiments.scheme_results import summarize_trials
    from edgectl.experiments.views.experiment import build_experiment_rows, describe_experiment

    results = summarize_trials(run)
    rows = [
        [str(getattr(cell, "text", cell)) for cell in row]
        for row in build_experiment_rows(run.experiment, results, every=True)
    ]
    return ReportTable(rows=rows, notes=list(describe_experiment(run.experiment, results, every=True)))
