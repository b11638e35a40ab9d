"""The files of a report: the HTML page, and each figure as SVG and PDF.

Figures are drawn without a display and without changing matplotlib's global state.
"""

from collections.abc import Iterator
from pathlib import Path

from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.experiments.report.distribution_plots import draw_completions, draw_handoffs, draw_latency
from edgectl.experiments.report.figure_style import (
    ReportFigure,
    inline_svg_from_document,
    render_pdf,
    render_svg,
    use_figure_style,
)
from edgectl.experiments.report.gantt_chart import draw_gantt_charts
from edgectl.experiments.report.page import EmbeddedFigure, ReportTable, render_report_page
from edgectl.experiments.report.ratio_plot import draw_ratios
from edgectl.experiments.report.time_series_plots import draw_loads, draw_readings


def draw_figures(run: ExperimentRun, bound: float | None = None) -> list[ReportFigure]:
    """All figures that the run has data for, in the order of the page; the run needs a trial.

    ``bound``: of equivalence.
    """
    with use_figure_style():
        return [
            *draw_ratios(run, bound),
            draw_latency(run),
            *draw_completions(run),
            *draw_loads(run),
            *draw_gantt_charts(run),
            *draw_handoffs(run),
            *draw_readings(run),
        ]


def build_report_files(
    run: ExperimentRun, table: ReportTable, out: Path, figures: Path | None, bound: float | None = None
) -> Iterator[tuple[Path, bytes]]:
    """Paths and contents of the page and of each figure as SVG and PDF; the run needs a trial."""
    drawn = [(figure, render_svg(figure)) for figure in draw_figures(run, bound)]
    embedded = [
        EmbeddedFigure(
            name=figure.name,
            title=figure.title,
            caption=figure.caption,
            svg=inline_svg_from_document(document, figure.title),
        )
        for figure, document in drawn
    ]
    yield out, render_report_page(run, table, embedded).encode()
    if figures is not None:
        for figure, document in drawn:
            yield figures / f"{figure.name}.svg", document
            yield figures / f"{figure.name}.pdf", render_pdf(figure)
