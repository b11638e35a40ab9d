"""report: a run of an experiment as a page and as figures."""

from collections.abc import Iterator
from pathlib import Path

from edgectl.evidence.drawing import drawings, inline, pdf, svg
from edgectl.evidence.page import Picture, Table, page
from edgectl.model.experiment import Run


def report(run: Run, table: Table, out: Path, figures: Path | None) -> Iterator[tuple[Path, bytes]]:
    """What is to be written where: the page to ``out``, and every figure as SVG and PDF into ``figures``. The run has a trial."""
    drawn = drawings(run)
    pictures = [Picture(name=each.name, title=each.title, caption=each.caption, svg=inline(each)) for each in drawn]
    yield out, page(run, table, pictures).encode()
    if figures is not None:
        for drawing in drawn:
            yield figures / f"{drawing.name}.svg", svg(drawing)
            yield figures / f"{drawing.name}.pdf", pdf(drawing)
