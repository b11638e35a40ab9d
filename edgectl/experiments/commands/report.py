# SPDX-License-Identifier: Apache-2.0
"""The command report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from edgectl.cli import console
from edgectl.errors import UsageError
from edgectl.experiments.commands.experiment import resolve_run_directory
from edgectl.experiments.commands.scheme_options import EquivalenceOption, parse_equivalence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edgectl.experiments.model.experiment import ExperimentRun
    from edgectl.experiments.report.page import ReportTable
    from edgectl.views.text import Row


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
    equivalence: EquivalenceOption = None,
) -> None:
    """Render an experiment as an HTML page, and print the names of the files written.

    The page opens with the answer in one sentence, with its interval; table, comparisons and figures follow.

    The page is self-contained: no network, no script. An unfinished run is reported with the trials done so
    far. Requires the extra report.

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
    bound = parse_equivalence(equivalence) or loaded.experiment.equivalence
    if figures is not None:
        make_directory(figures)
    page = out or directory / "report.html"
    table = _build_report_table(loaded, bound)
    for path, data in build_report_files(loaded, table, page, figures, bound):
        save_file(path, data)
        console.print_text(f"{path}\n")


def _build_report_table(run: "ExperimentRun", bound: float | None) -> "ReportTable":
    """The answer, the wide table of ``experiment show``, and the comparisons of all metrics.

    ``bound``: of equivalence.
    """
    from edgectl.experiments.event_results import add_trial_events
    from edgectl.experiments.report.page import ReportTable
    from edgectl.experiments.scheme_comparison import compare_schemes, find_primary_comparison
    from edgectl.experiments.scheme_results import summarize_trials
    from edgectl.experiments.views.answer import describe_answer
    from edgectl.experiments.views.comparison_table import build_comparison_rows
    from edgectl.experiments.views.experiment import (
        build_experiment_rows,
        describe_experiment,
        list_compared_columns,
    )
    from edgectl.experiments.views.recovery_table import build_recovery_rows

    results = add_trial_events(run, summarize_trials(run))
    compared = compare_schemes(results, bound)
    columns = list_compared_columns(run.experiment, results, every=True)
    return ReportTable(
        rows=_list_row_texts(build_experiment_rows(run.experiment, results, every=True)),
        notes=list(describe_experiment(run.experiment, results, compared, every=True)),
        answer=describe_answer(find_primary_comparison(compared)),
        compared=_list_row_texts(
            build_comparison_rows(compared, {column.name: column for column in columns})
        ),
        recovery=_list_row_texts(build_recovery_rows(results)),
    )


def _list_row_texts(rows: "Sequence[Row]") -> list[list[str]]:
    return [[str(getattr(cell, "text", cell)) for cell in row] for row in rows]
