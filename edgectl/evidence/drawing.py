"""The figures of a report. Modules named ``drawing*`` alone know matplotlib; none of them touches its global state or a screen."""

from edgectl.evidence.drawing_gantt import gantt
from edgectl.evidence.drawing_sheet import Drawing, inline, pdf, styled, svg
from edgectl.evidence.drawing_spread import completions, handoffs, latency
from edgectl.evidence.drawing_time import loads, readings
from edgectl.model.experiment import Run

__all__ = ["Drawing", "drawings", "inline", "pdf", "svg"]


def drawings(run: Run) -> list[Drawing]:
    """Every figure that the run has something for, in the order of the page; it has one trial at least."""
    with styled():
        return [latency(run), *completions(run), *loads(run), *gantt(run), *handoffs(run), *readings(run)]
