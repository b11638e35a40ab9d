"""Style of all figures: sizes, colours, fonts, panels; and export as SVG and PDF.

Lengths are in inches. Text stays text in SVG and is embedded as TrueType in PDF, so that both can be
searched. The output is reproducible: it does not depend on date, machine or matplotlib settings.
"""

import re
import textwrap
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from io import BytesIO
from typing import Any
from xml.sax.saxutils import quoteattr

from matplotlib import rc_context, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.experiments.report.trial_selection import is_mission_short

FIGURE_WIDTH_IN = 3.5  # one column of an IEEE page; its smallest text is 9 px high on a screen of 400 px
INK, FAINT, GRID = "#222222", "#6b6b6b", "#d4d4d4"
# Distinct under all kinds of colour blindness, and with a contrast of at least 3 to white and to black pages.
SCHEME_COLOURS = (
    "#767676",
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#a67c00",
    "#8a63d2",
    "#2a93a8",
    "#b3446c",
    "#5b7a00",
    "#4f6bd8",
    "#9a5b3c",
)
TEXT_PT, SMALL_TEXT_PT = 7.0, 6.0  # pt
_CHARACTER_WIDTH_IN = 0.0615  # of text at 7 pt, on average
_DEFAULT_STYLE: dict[Any, Any] = {name: value for name, value in rcParamsDefault.items() if name != "backend"}
_STYLE: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": TEXT_PT,
    "text.color": INK,
    "text.parse_math": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.labelsize": TEXT_PT,
    "axes.titlesize": TEXT_PT,
    "axes.titlepad": 4.0,
    "axes.titley": 1.0,
    "axes.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.xmargin": 0.0,
    "axes.ymargin": 0.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.4,
    "xtick.color": FAINT,
    "xtick.labelcolor": INK,
    "xtick.labelsize": SMALL_TEXT_PT,
    "xtick.major.width": 0.5,
    "xtick.major.size": 2.0,
    "ytick.color": FAINT,
    "ytick.labelcolor": INK,
    "ytick.labelsize": SMALL_TEXT_PT,
    "ytick.major.width": 0.5,
    "ytick.major.size": 2.0,
    "xtick.major.pad": 2.0,
    "ytick.major.pad": 2.0,
    "legend.fontsize": SMALL_TEXT_PT,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}

_PAGE_COLOUR_VARIABLES = {INK: "ink", FAINT: "faint", GRID: "grid"}
_SVG_PROLOGUE_PATTERN = re.compile(r"^.*?<svg", re.DOTALL)
_SVG_SIZE_PATTERN = re.compile(r' (width|height)="[^"]*"(?=[^>]*viewBox)')
_SVG_STYLE_PATTERN = re.compile(r"<defs>\s*<style.*?</defs>", re.DOTALL)
_SVG_ID_PATTERN = re.compile(r'<(\w+) id="[^"]+_\d+"')


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFigure:
    """A figure, the ``name`` of its files, and its title and caption."""

    name: str
    title: str
    caption: str
    figure: Figure


def use_figure_style(salt: str = "edgectl") -> AbstractContextManager[None]:
    """A context with the style of all figures, independent of local settings.

    ``salt`` makes the ids of an SVG unique.
    """
    return rc_context({**_DEFAULT_STYLE, **_STYLE, "svg.hashsalt": salt})


def render_svg(figure: ReportFigure) -> bytes:
    """The figure as an SVG document."""
    return _export_figure(figure, "svg", {"Date": None, "Creator": None, "Format": None, "Type": None})


def inline_svg_from_document(document: bytes, title: str) -> str:
    """The document of `render_svg` as an element with the page's width and colours and without fixed ids."""
    text = document.decode()
    text = _SVG_PROLOGUE_PATTERN.sub(f'<svg role="img" aria-label={quoteattr(title)}', text, count=1)
    text = _SVG_SIZE_PATTERN.sub("", text, count=2)
    text = _SVG_ID_PATTERN.sub(r"<\1", _SVG_STYLE_PATTERN.sub("", text, count=1))
    for colour, variable in _PAGE_COLOUR_VARIABLES.items():
        text = text.replace(colour, f"var(--{variable})")
    return text


def render_pdf(figure: ReportFigure) -> bytes:
    """The figure as a PDF of one page."""
    return _export_figure(
        figure, "pdf", {"CreationDate": None, "Creator": None, "Producer": None, "Title": figure.title}
    )


def _export_figure(figure: ReportFigure, form: str, metadata: Mapping[str, str | None]) -> bytes:
    file = BytesIO()
    with use_figure_style(figure.name), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name with characters that the font lacks
        figure.figure.savefig(file, format=form, metadata=metadata)
    return file.getvalue()


def get_scheme_colour(run: ExperimentRun, scheme: str) -> str:
    """The colour of a scheme, the same in all figures of a run."""
    names = [scheme.name for scheme in run.experiment.schemes]
    return SCHEME_COLOURS[names.index(scheme) % len(SCHEME_COLOURS)]


def create_panels(
    rows: int,
    columns: int,
    *,
    height: float,
    left: float,
    top: float,
    gap: tuple[float, float] = (0.12, 0.1),
    x: bool = True,
) -> tuple[Figure, list[list[Axes]]]:
    """Panels of equal ``height`` with a shared y axis.

    ``x``: share the x axis too. ``gap``: between columns, between rows.
    """
    column_gap, row_gap = gap
    bottom, right = 0.38, 0.1
    total = top + bottom + rows * height + (rows - 1) * row_gap
    width = (FIGURE_WIDTH_IN - left - right - (columns - 1) * column_gap) / columns
    figure = Figure(figsize=(FIGURE_WIDTH_IN, total))
    grid = {
        "left": left / FIGURE_WIDTH_IN,
        "right": 1 - right / FIGURE_WIDTH_IN,
        "bottom": bottom / total,
        "top": 1 - top / total,
        "wspace": column_gap / width,
        "hspace": row_gap / height,
    }
    axes = figure.subplots(rows, columns, sharex=x, sharey=True, squeeze=False, gridspec_kw=grid)
    for panel in figure.axes:
        # Placed by hand, as the style says: to search a place for titles takes a tenth of the time.
        panel.set_title("")
        # Only x axes that are not shared have a label: placing the empty ones takes a tenth of the time.
        panel.yaxis.set_label_coords(0.0, 0.0)
        if x:
            panel.xaxis.set_label_coords(0.0, 0.0)
    return figure, [list(row) for row in axes]


def label_rows(figure: Figure, axes: Sequence[Sequence[Axes]], names: Iterable[str], unit: str) -> None:
    """Label each row of panels at its left, wrapped; and above all rows, the unit of the value axis."""
    high = figure.get_figheight()
    figure.text(
        0.02 / FIGURE_WIDTH_IN,
        1 - 0.06 / high,
        wrap_label(unit, 18),
        ha="left",
        va="top",
        fontsize=SMALL_TEXT_PT,
        linespacing=1.15,
    )
    for row, name in zip(axes, names, strict=True):
        box = row[0].get_position()
        figure.text(
            0.02 / FIGURE_WIDTH_IN,
            (box.y0 + box.y1) / 2,
            wrap_label(name),
            ha="left",
            va="center",
            fontsize=TEXT_PT,
            linespacing=1.05,
        )


def label_x_axis(figure: Figure, text: str) -> None:
    """Label the shared x axis once."""
    edges = [axes.get_position() for axes in figure.axes]
    middle = (min(box.x0 for box in edges) + max(box.x1 for box in edges)) / 2
    figure.text(middle, 0.06 / figure.get_figheight(), text, ha="center", va="bottom", fontsize=TEXT_PT)


def wrap_label(text: str, width: int = 13) -> str:
    """``text`` in lines that fit beside a panel."""
    return textwrap.fill(shorten_label(text, 3 * width), width)


def shorten_label(text: str, width: int = 26) -> str:
    """``text``, shortened in its middle to at most ``width`` characters."""
    text, half = _replace_unprintable(text), (width - 1) // 2
    return text if len(text) <= width else f"{text[:half]}…{text[-half:]}"


def _replace_unprintable(text: str) -> str:
    """``text`` without characters that XML forbids."""
    return "".join(character if character.isprintable() else "\ufffd" for character in text)


def estimate_text_width_in(texts: Iterable[str], size: float = TEXT_PT) -> float:
    """Upper bound of the width of the longest of ``texts``, in inches."""
    return max((len(text) for text in texts), default=0) * _CHARACTER_WIDTH_IN * size / TEXT_PT


def choose_time_unit(run: ExperimentRun) -> tuple[float, str]:
    """The unit of all times of a run, as in the table: its length in s, and its symbol."""
    return (1.0, "s") if is_mission_short(run) else (60.0, "min")
