"""The figures of a report. Modules named ``drawing*`` alone know matplotlib; none of them touches its global state or a screen."""

from collections.abc import Iterator
from pathlib import Path

from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.experiments.report.distribution_plots import draw_completions, draw_handoffs, draw_latency
from edgectl.experiments.report.figure_style import (
    ReportFigure,
    render_inline_svg,
    render_pdf,
    render_svg,
    use_figure_style,
)
from edgectl.experiments.report.gantt_chart import draw_gantt_charts
from edgectl.experiments.report.page import EmbeddedFigure, ReportTable, render_report_page
from edgectl.experiments.report.time_series_plots import draw_loads, draw_readings


def draw_figures(run: ExperimentRun) -> list[ReportFigure]:
    """Every figure that the run has something for, in the order of the page; it has one trial at least."""
    with use_figure_style():
        return [
            draw_latency(run),
            *draw_completions(run),
            *draw_loads(run),
            *draw_gantt_charts(run),
            *draw_handoffs(run),
            *draw_readings(run),
        ]


def build_report_files(
    run: ExperimentRun, table: ReportTable, out: Path, figures: Path | None
) -> Iterator[tuple[Path, bytes]]:
    """What is to be written where: the page to ``out``, and every figure as SVG and PDF into ``figures``. The run has a trial."""
    drawn = draw_figures(run)
    pictures = [
        EmbeddedFigure(name=each.name, title=each.title, caption=each.caption, svg=render_inline_svg(each))
        for each in drawn
    ]
    yield out, render_report_page(run, table, pictures).encode()
    if figures is not None:
        for drawing in drawn:
            yield figures / f"{drawing.name}.svg", render_svg(drawing)
            yield figures / f"{drawing.name}.pdf", render_pdf(drawing)
