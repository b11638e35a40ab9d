"""What every figure shares: its measures, colours and type, panels in rows and columns, and figures as bytes.

Lengths are inches. Text stays text in SVG and is embedded as TrueType in PDF, so that both can be searched. Nothing of the day, the machine
or its settings goes into the bytes.
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

FIGURE_WIDTH_IN = 7.16  # both columns of a page of the IEEE's
INK, FAINT, GRID = "#222222", "#6b6b6b", "#d4d4d4"
# Far apart for every kind of colour vision, and each three times lighter or darker than a white and than a black page.
SCHEME_COLOURS = ("#767676", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#a67c00", "#8a63d2", "#2a93a8")
TEXT_PT, SMALL_TEXT_PT = 7.0, 6.0  # pt
_CHARACTER_WIDTH_IN = 0.0615  # of text at 7 pt, on average
_DEFAULT_STYLE: dict[Any, Any] = {name: value for name, value in rcParamsDefault.items() if name != "backend"}
_STYLE: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"], "font.size": TEXT_PT, "text.color": INK, "text.parse_math": False, "figure.facecolor": "none",
    "axes.facecolor": "none", "axes.edgecolor": FAINT, "axes.labelcolor": INK, "axes.labelsize": TEXT_PT, "axes.titlesize": TEXT_PT,
    "axes.titlepad": 4.0, "axes.linewidth": 0.5, "axes.spines.top": False, "axes.spines.right": False, "axes.xmargin": 0.0,
    "axes.ymargin": 0.0, "axes.grid": True, "axes.axisbelow": True, "grid.color": GRID, "grid.linewidth": 0.4,
    "xtick.color": FAINT, "xtick.labelcolor": INK, "xtick.labelsize": SMALL_TEXT_PT, "xtick.major.width": 0.5, "xtick.major.size": 2.0,
    "ytick.color": FAINT, "ytick.labelcolor": INK, "ytick.labelsize": SMALL_TEXT_PT, "ytick.major.width": 0.5, "ytick.major.size": 2.0,
    "xtick.major.pad": 2.0, "ytick.major.pad": 2.0, "legend.fontsize": SMALL_TEXT_PT, "legend.frameon": False, "lines.solid_capstyle": "round",
    "svg.fonttype": "none", "pdf.fonttype": 42,
}  # fmt: skip

_PAGE_COLOUR_VARIABLES = {INK: "ink", FAINT: "faint", GRID: "grid"}
_SVG_PROLOGUE_PATTERN = re.compile(r"^.*?<svg", re.DOTALL)
_SVG_SIZE_PATTERN = re.compile(r' (width|height)="[^"]*"(?=[^>]*viewBox)')
_SVG_STYLE_PATTERN = re.compile(r"<defs>\s*<style.*?</defs>", re.DOTALL)
_SVG_ID_PATTERN = re.compile(r'<(\w+) id="[^"]+_\d+"')


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFigure:
    """A figure under the ``name`` of its files, and what it shows in words."""

    name: str
    title: str
    caption: str
    figure: Figure


def use_figure_style(salt: str = "edgectl") -> AbstractContextManager[None]:
    """The style of all figures within, whatever the settings of the machine; ``salt`` makes the ids in an SVG its own."""
    return rc_context({**_DEFAULT_STYLE, **_STYLE, "svg.hashsalt": salt})


def render_svg(drawing: ReportFigure) -> bytes:
    """The figure as an SVG document."""
    return _export_figure(drawing, "svg", {"Date": None, "Creator": None, "Format": None, "Type": None})


def render_inline_svg(drawing: ReportFigure) -> str:
    """The same as an element of a page: it takes the page's width and colours, and its ids stand nowhere else in the page."""
    text = render_svg(drawing).decode()
    text = _SVG_PROLOGUE_PATTERN.sub(f'<svg role="img" aria-label={quoteattr(drawing.title)}', text, count=1)
    text = _SVG_SIZE_PATTERN.sub("", text, count=2)
    text = _SVG_ID_PATTERN.sub(r"<\1", _SVG_STYLE_PATTERN.sub("", text, count=1))
    for colour, variable in _PAGE_COLOUR_VARIABLES.items():
        text = text.replace(colour, f"var(--{variable})")
    return text


def render_pdf(drawing: ReportFigure) -> bytes:
    """The figure as a PDF of one page."""
    return _export_figure(
        drawing, "pdf", {"CreationDate": None, "Creator": None, "Producer": None, "Title": drawing.title}
    )


def _export_figure(drawing: ReportFigure, form: str, metadata: Mapping[str, str | None]) -> bytes:
    file = BytesIO()
    with use_figure_style(drawing.name), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name in a script that the font lacks
        drawing.figure.savefig(file, format=form, metadata=metadata)
    return file.getvalue()


def get_scheme_colour(run: ExperimentRun, scheme: str) -> str:
    """The colour of a scheme: the same in every figure of a run."""
    names = [variant.name for variant in run.experiment.schemes]
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
    """Equal panels of a ``height`` that share their y axis, and their ``x`` axis; ``gap``: between columns and between rows."""
    beside, below = gap
    bottom, right = 0.38, 0.1
    total = top + bottom + rows * height + (rows - 1) * below
    width = (FIGURE_WIDTH_IN - left - right - (columns - 1) * beside) / columns
    figure = Figure(figsize=(FIGURE_WIDTH_IN, total))
    grid = {
        "left": left / FIGURE_WIDTH_IN, "right": 1 - right / FIGURE_WIDTH_IN, "bottom": bottom / total, "top": 1 - top / total,
        "wspace": beside / width, "hspace": below / height,
    }  # fmt: skip
    axes = figure.subplots(rows, columns, sharex=x, sharey=True, squeeze=False, gridspec_kw=grid)
    return figure, [list(row) for row in axes]


def label_rows(figure: Figure, axes: Sequence[Sequence[Axes]], names: Iterable[str], unit: str) -> None:
    """Write what a row of panels shows at its left, in several lines where it is long; and above them the unit of the value axis."""
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
    """Name the x axis of all panels, once."""
    edges = [axes.get_position() for axes in figure.axes]
    middle = (min(box.x0 for box in edges) + max(box.x1 for box in edges)) / 2
    figure.text(middle, 0.06 / figure.get_figheight(), text, ha="center", va="bottom", fontsize=TEXT_PT)


def wrap_label(text: str, width: int = 13) -> str:
    """``text`` in lines so short that they fit beside a panel."""
    return textwrap.fill(shorten_label(text, 3 * width), width)


def shorten_label(text: str, width: int = 26) -> str:
    """``text`` with its middle left out where it is too long."""
    text, half = _replace_unprintable(text), (width - 1) // 2
    return text if len(text) <= width else f"{text[:half]}…{text[-half:]}"


def _replace_unprintable(text: str) -> str:
    """``text`` without what no XML document may hold."""
    return "".join(character if character.isprintable() else "\ufffd" for character in text)


def estimate_text_width_in(texts: Iterable[str], size: float = TEXT_PT) -> float:
    """Inches that the longest of ``texts`` takes at most."""
    return max((len(text) for text in texts), default=0) * _CHARACTER_WIDTH_IN * size / TEXT_PT


def choose_time_unit(seconds: float) -> tuple[float, str]:
    """The unit for times up to ``seconds``: its length in s and its name."""
    return (1.0, "s") if seconds <= 600 else (60.0, "min") if seconds <= 4 * 3600 else (3600.0, "h")
