# SPDX-License-Identifier: Apache-2.0
"""Results of a sweep: a row for each world, as text and as a document."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from edgectl.experiments.model.comparison import Estimate
from edgectl.experiments.model.sweep import Sweep, SweepWorld, WorldResult
from edgectl.experiments.scheme_results import compute_estimate
from edgectl.formats.document import Document
from edgectl.views.output import ListView
from edgectl.views.output_format import WIDE_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns, wrap_text


@dataclass(frozen=True, kw_only=True)
class SweepView(ListView):
    """All worlds of a sweep with their results, by digest."""

    kind = "world"
    formats = WIDE_FORMATS
    sweep: Sweep
    results: Mapping[str, WorldResult]

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Per world its settings, the mean mission time of each scheme in s, and the fastest scheme."""
        return self._render(look, intervals=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with confidence intervals and moves."""
        return self._render(look, intervals=True)

    def items(self) -> Sequence[Document]:
        """One item per world."""
        return [_encode_world(world, self.results[world.digest]) for world in self.sweep.worlds]

    def warnings(self) -> Sequence[str]:
        """Runs that the time limit ended."""
        unfinished = sum(
            each.unfinished for result in self.results.values() for each in result.schemes.values()
        )
        return (
            [f"runs ended by the time limit, which counts as their mission time: {unfinished}"]
            if unfinished
            else []
        )

    def _render(self, look: RenderOptions, *, intervals: bool) -> str:
        schemes = [scheme.name for scheme in self.sweep.worlds[0].schemes]
        axes = self.sweep.axes
        heads = [axis.upper().replace("_", " ") for axis in axes]
        rows: list[Row] = [(*heads, "RUNS", *(name.upper() for name in schemes), "FASTEST")]
        rows += [
            _build_row(axes, world, self.results[world.digest], intervals) for world in self.sweep.worlds
        ]
        right = set(range(len(axes), len(axes) + 1 + len(schemes)))
        notes = "".join(wrap_text(note, look) for note in self._describe(intervals=intervals))
        return render_columns(rows, look, right=right) + notes

    def _describe(self, *, intervals: bool) -> Iterator[str]:
        numbers = "means with 95 % intervals" if intervals else "means"
        yield f"Mission times in s: {numbers}, over runs with the same seeds."
        if self.sweep.bounds.error is not None:
            yield (
                f"FASTEST: faster with more than half of all seeds, wrong with a probability of at most "
                f"{self.sweep.bounds.error:.0%}, and then a world ends; -: none in "
                f"{self.sweep.bounds.runs} runs."
            )
        else:
            yield (
                "FASTEST: - everywhere, since the sweep file states no error: all runs are made, and none is "
                "called the fastest."
            )


def _build_row(axes: Sequence[str], world: SweepWorld, result: WorldResult, intervals: bool) -> Row:  # noqa: FBT001
    return (
        *(world.settings.get(axis, "-") for axis in axes),
        str(result.runs),
        *(_format_time(compute_estimate(each.latency), intervals) for each in result.schemes.values()),
        Cell(result.winner or "-", "name"),
    )


def _format_time(estimate: Estimate, intervals: bool) -> str:  # noqa: FBT001
    mean = f"{estimate.mean:.0f}"
    return f"{mean} ± {estimate.half_ci95:.0f}" if intervals and estimate.count > 1 else mean


def _encode_world(world: SweepWorld, result: WorldResult) -> Document:
    return {
        "settings": dict(world.settings),
        "digest": result.digest,
        "run_count": result.runs,
        "fastest": result.winner or None,
        "schemes": [
            {
                "scheme": name,
                "mission_s": estimate.mean,
                "half_ci95": estimate.half_ci95 if estimate.count > 1 else None,
                "handoffs": sum(each.handoffs),
                "unplaced": sum(each.unplaced),
                "unfinished": each.unfinished,
            }
            for name, each in result.schemes.items()
            for estimate in [compute_estimate(each.latency)]
        ],
    }
