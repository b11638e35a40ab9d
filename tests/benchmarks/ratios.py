# SPDX-License-Identifier: Apache-2.0
"""Ratios of all benchmarks for one table at the end of a run: each benchmark notes its own (`note_ratio`)."""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

# The file that a run collects ratios in; a benchmark that runs by itself has none.
VARIABLE = "EDGECTL_BENCHMARK_RATIOS"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """``what`` as a multiple ``of`` something else; the goal is ``most``, None where there is none."""

    what: str
    of: str
    value: float
    most: float | None = None

    @property
    def met(self) -> bool:
        """Whether it is within its goal."""
        return self.most is None or self.value <= self.most


def note_ratio(what: str, value: float, *, of: str, most: float | None = None) -> None:
    """Note a ratio for the table of the run that this benchmark is a part of, if it is."""
    path = os.environ.get(VARIABLE)
    if path:
        with Path(path).open("a") as file:
            file.write(json.dumps(asdict(Ratio(what=what, of=of, value=value, most=most))) + "\n")


def read_ratios(path: Path) -> list[Ratio]:
    """Read what was noted, in its order."""
    return [Ratio(**json.loads(line)) for line in path.read_text().splitlines()]


def format_table(ratios: Sequence[Ratio]) -> str:
    """Format the ratios as a Markdown table."""
    rows = ["| what | of | ratio | goal | met |", "|---|---|--:|--:|---|"]
    for each in ratios:
        goal, met = ("", "") if each.most is None else (f"{each.most:g}", "yes" if each.met else "no")
        rows.append(f"| {each.what} | {each.of} | {each.value:.2f} | {goal} | {met} |")
    return "\n".join(rows)
