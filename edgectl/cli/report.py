"""report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from edgectl.cli import console
from edgectl.cli.experiment import run_directory
from edgectl.errors import UsageError

if TYPE_CHECKING:
    from edgectl.evidence.page import Table
    from edgectl.model.experiment import Run


def report_command(
    *,
    run: Annotated[Path | None, Argument(metavar="[RUN]", help="Directory of a run; the newest in runs/.", show_default=False)] = None,
    out: Annotated[Path | None, Option("--out", metavar="FILE", help="The page, instead of RUN/report.html.", show_default=False)] = None,
    figures: Annotated[Path | None, Option("--figures", metavar="DIR", help="Write every figure there, as SVG and PDF.")] = None,
) -> None:
    """Write a run of an experiment as one HTML page with its table and figures, and print the names of the files.

    The page needs no network and no script. A run that is still going on, or was interrupted, is reported as far as it is.
    Needs the extra edgectl[report].

    Examples:
        edgectl report docs/examples/run --out report.html
        edgectl report docs/examples/run --out report.html --figures figures
    """
    import logging

    from edgectl.cli.extras import extra
    from edgectl.cli.inputs import make, save
    from edgectl.state.runs import read_run

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # where it keeps its list of fonts, and that it makes one, is no news
    with extra("report"):
        from edgectl.usecases.report import report

    directory = run_directory(run)
    found = read_run(directory)
    if not found.trials:
        raise UsageError(f"no trial of {directory} has ended yet", hint="wait for the first one, or go on: edgectl experiment run SPEC")
    if figures is not None:
        make(figures)
    for path, data in report(found, _table(found), out or directory / "report.html", figures):
        save(path, data)
        console.put(f"{path}\n")


def _table(run: "Run") -> "Table":
    """The same table as everywhere, with every metric."""
    from edgectl.evidence.measured import columns
    from edgectl.evidence.page import Table
    from edgectl.views.measured import notes, rows

    values = columns(run)
    words = [[str(getattr(cell, "text", cell)) for cell in row] for row in rows(run.experiment, values, every=True)]
    return Table(rows=words, notes=list(notes(run.experiment, values, every=True)))
