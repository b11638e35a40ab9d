# SPDX-License-Identifier: Apache-2.0
"""The tables of docs/concepts/quality.md: their labels, and how their figures are measured."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from tests.quality.measures import (
    Shortfall,
    count_evicting_fleets,
    count_losing_fleets,
    count_needless_fleets,
    count_short_fleets,
    count_true_statements,
    measure_shortfalls,
    prove_first_levels,
)
from tests.scheduler.closed_loop import ClosedLoop, build_saturated_loop, build_tight_loop
from tests.usecases.tight_sites import CronSite, watch_tight_site

Cells = tuple[str, ...]
SEEDS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """``labels``: the first cells of each row; ``measure`` gives the others, row by row."""

    heading: str
    columns: Cells
    labels: Sequence[Cells]
    measure: Callable[[], Iterable[Cells]]

    def list_lines(self) -> Iterator[str]:
        """The table in Markdown, each row as soon as it is known."""
        yield format_row(self.columns)
        yield "|" + "---|" * len(self.columns)
        for labels, cells in zip(self.labels, self.measure(), strict=True):
            yield format_row((*labels, *cells))


def format_row(cells: Cells) -> str:
    """One row of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def build_tables() -> tuple[Table, ...]:
    """All tables, in the order of the page."""
    return _build_unplaced(), _build_sums(), _build_proofs(), _build_stability(), _build_explanations()


# What just fits; spare capacity and noise of the readings, both as shares of the capacity.
_LOOPS = (
    ("cpu", 0.005, 0.02),
    ("cpu", 0.005, 0.05),
    ("cpu", 0.025, 0.05),
    ("memory", 0.005, 0.02),
    ("network", 0.005, 0.02),
    ("network", 0.005, 0.05),
)
# Noise up to which a task is also run by the real loops.
_REAL_NOISE = 0.02


def _build_stability() -> Table:
    names = [
        f"a task that just fits by {resource}: {spare:.1%} spare, noise {noise:.0%}"
        for resource, spare, noise in _LOOPS
    ]
    names.append("three edges, each overloaded by its two tasks, noise 2%")
    return Table(
        heading="Stability",
        columns=("fleet", "raw readings", "smoothed", "`watch --apply`", "`apply` each minute"),
        labels=[(name.replace("%", " %"),) for name in names],
        measure=_measure_stability,
    )


def _measure_stability() -> Iterator[Cells]:
    for resource, spare, noise in _LOOPS:
        build = partial(build_tight_loop, spare, noise, resource=resource)
        real = _measure_real_loops(resource, noise) if noise <= _REAL_NOISE else ("", "")
        yield (*_measure_loops(build), *real)
    yield (*_measure_loops(build_saturated_loop), "", "")


def _measure_loops(build: Callable[..., ClosedLoop]) -> Cells:
    return tuple(
        str(max(build(smooth=smooth, seed=seed).run() for seed in range(1, SEEDS + 1)))
        for smooth in (False, True)
    )


def _measure_real_loops(resource: str, noise: float) -> Cells:
    """The moves of an hour of `watch --apply`, and of an hour of `apply` from cron, over simulated hosts."""
    moves: dict[str, list[int]] = {"watch": [], "cron": []}
    for seed in range(1, SEEDS + 1):
        with TemporaryDirectory() as folder:
            state = Path(folder)
            moves["watch"].append(watch_tight_site(state / "watch", resource, 360, up_to=noise, seed=seed))
            moves["cron"].append(CronSite(state / "cron", resource, up_to=noise, seed=seed).run(60))
    return tuple(str(max(found)) for found in moves.values())


def _build_unplaced() -> Table:
    return Table(
        heading="Tasks left unplaced",
        columns=("fleets", "of which", "number"),
        labels=[
            ("100 of 5 x 20, filled to 88 to 95 % by construction", "leave a task unplaced"),
            ("60 of 10 x 50, likewise", "leave a task unplaced"),
            (
                "50 of 5 x 20, memory 90 % full",
                "leave a task unplaced, and it is not proven that not all fit",
            ),
            ("600 of 5 x 20, memory 60, 75 and 90 % full", "leave more unplaced if one edge is 10 % larger"),
            (
                "180 of 5 x 20, memory 80 % full, a newcomer and 19 running tasks",
                "move a task within its dwell, or place the newcomer by its name",
            ),
        ],
        measure=_measure_unplaced,
    )


def _measure_unplaced() -> Iterator[Cells]:
    yield (str(count_short_fleets(5, 20, range(100))),)
    yield (str(count_short_fleets(10, 50, range(60))),)
    yield (str(count_needless_fleets(5, 20, range(50), 0.9)),)
    yield (str(sum(count_losing_fleets(5, 20, range(200), fill) for fill in (0.6, 0.75, 0.9))),)
    yield (str(count_evicting_fleets(5, 20, range(180), 0.8)),)


# Edges, tasks, number of fleets, and memory fill.
_SUMS = ((5, 20, 8, 0.7), (5, 16, 10, 0.65), (10, 50, 2, 0.7))


def _build_sums() -> Table:
    ways = ("`plan`", "`plan --rebalance`", "`plan --optimal`")
    labels = [
        (f"{count} of {edges} x {tasks}, memory {fill * 100:.0f} % full" if not index else "", way)
        for edges, tasks, count, fill in _SUMS
        for index, way in enumerate(ways)
    ]
    return Table(
        heading="Sum of utilities",
        columns=("fleets", "way", "below the best: median, most", "CPU time: median, most"),
        labels=labels,
        measure=_measure_sums,
    )


def _measure_sums() -> Iterator[Cells]:
    for edges, tasks, count, fill in _SUMS:
        for found in measure_shortfalls(edges, tasks, range(count), fill, 20.0).values():
            yield _describe_shortfalls(found)


def _describe_shortfalls(found: Sequence[Shortfall]) -> Cells:
    """Below the best: of the plans that place all tasks."""
    whole = [each.below for each in found if not each.unplaced]
    notes = ""
    if len(whole) < len(found):
        notes += f"; {len(found) - len(whole)} leave a task out"
    if any(each.proven for each in found):
        notes += f"; {sum(each.proven for each in found)} of {len(found)} proven"
    seconds = [each.seconds for each in found]
    return (
        f"{median(whole):.1%}, {max(whole):.1%}".replace("%", " %") + notes,
        f"{median(seconds):.2g} s, {max(seconds):.2g} s",
    )


# For the first two levels, which may take half of it each.
DEADLINE_S = 2.0
# Edges, tasks, number of fleets, least and greatest memory fill, newcomers.
_PROOFS = ((5, 20, 6, 0.9, 0.9, 5), (50, 200, 100, 0.6, 0.85, 20))


def _build_proofs() -> Table:
    labels = []
    for edges, tasks, count, low, high, newcomers in _PROOFS:
        fill = f"{low * 100:.0f}" if low == high else f"{low * 100:.0f} to {high * 100:.0f}"
        labels.append((f"{count} of {edges} x {tasks}, {newcomers} of them new, memory {fill} % full",))
    return Table(
        heading="Moves",
        columns=("fleets", "both proven within 1 s", "CPU time: median, most", "moves, and at least"),
        labels=labels,
        measure=_measure_proofs,
    )


def _measure_proofs() -> Iterator[Cells]:
    for edges, tasks, count, low, high, newcomers in _PROOFS:
        fills = [low + (high - low) * seed / count for seed in range(count)]
        found = [
            prove_first_levels(edges, tasks, seed, fill, newcomers, DEADLINE_S)
            for seed, fill in enumerate(fills)
        ]
        seconds = [each.seconds for each in found]
        certificates = [each.certificate for each in found]
        yield (
            str(sum(each.complete and each.seconds <= 1.0 for each in found)),
            f"{median(seconds):.2g} s, {max(seconds):.2g} s",
            f"{sum(each.moves for each in certificates)}, {sum(each.moves_bound for each in certificates)}",
        )


def _build_explanations() -> Table:
    return Table(
        heading="Explanations",
        columns=("fleets", "statements", "true of the whole plan"),
        labels=[("4 of 3 x 9, in half of them all tasks run",)],
        measure=lambda: [tuple(map(str, count_true_statements(range(4))))],
    )
