# SPDX-License-Identifier: Apache-2.0
"""Results of a replay: a row per scheme as text, and a document."""

from collections.abc import Sequence
from dataclasses import dataclass

from edgectl.experiments.model.comparison import ReplayResult, Utilisation
from edgectl.formats.document import Document, encode_number
from edgectl.model.resource import TASK_RESOURCES
from edgectl.names import format_name_list, natural_key
from edgectl.views.output import ListView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns, wrap_text

_OPEN_LOOP_NOTE = (
    "Open loop: the usage and run time of tasks are as recorded, whatever a scheme decides; "
    "edgectl simulate closes the loop in a model."
)

_HEAD = ("SCHEME", "HANDOFFS", "PER CYCLE", "UNPLACED", *(each.title for each in TASK_RESOURCES))


@dataclass(frozen=True, kw_only=True)
class ReplayView(ListView):
    """The results of all schemes over the same snapshots."""

    kind = "replay"
    formats = ITEM_FORMATS
    results: Sequence[ReplayResult]

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One row per scheme; utilisations as mean and peak over edges (or links) and cycles."""
        cycles = max((result.cycles for result in self.results), default=0)
        rows: list[Row] = [_HEAD]
        rows += map(_build_replay_row, self.results)
        return render_columns(rows, look, right=set(range(1, len(_HEAD)))) + wrap_text(
            f"{cycles} cycles; utilisation as mean/peak. {_OPEN_LOOP_NOTE}", look
        )

    def items(self) -> Sequence[Document]:
        """The same numbers as JSON types; utilisations are shares of the capacity."""
        return [_encode_replay_result(result) for result in self.results]

    def warnings(self) -> Sequence[str]:
        """The limits of an open loop, and tasks without measurements."""
        return [_OPEN_LOOP_NOTE, *_describe_assumed_tasks(self.results)]

    def notes(self) -> Sequence[str]:
        """Tasks without measurements; the limits stand below the table."""
        return _describe_assumed_tasks(self.results)


def _build_replay_row(result: ReplayResult) -> Row:
    return (
        Cell(result.scheme.name, "name"),
        str(result.handoffs),
        f"{result.handoffs / result.cycles:.3f}" if result.cycles else "-",
        str(result.unplaced),
        *(_format_utilisation(share) if result.cycles else "-" for share in _select_shown(result).values()),
    )


def _describe_assumed_tasks(results: Sequence[ReplayResult]) -> list[str]:
    tasks = sorted({task for result in results for task in result.assumed}, key=natural_key)
    if not tasks:
        return []
    names = f"{format_name_list(tasks)} ({len(tasks)})"
    return [f"never recorded as running, so their usage is taken from their demand: {names}"]


def _select_shown(result: ReplayResult) -> dict[str, Utilisation]:
    """Of the resources that every host has."""
    return {each.name: result.utilisation[each.name] for each in TASK_RESOURCES}


def _format_utilisation(share: Utilisation) -> str:
    return f"{share.mean:.0%}/{share.peak:.0%}"


def _encode_replay_result(result: ReplayResult) -> Document:
    policy = result.scheme.policy
    return {
        "scheme": result.scheme.name,
        "policy": policy.name.value,
        "move_margin": encode_number(policy.move_margin),
        "cycles": result.cycles,
        "handoffs": result.handoffs,
        "unplaced": result.unplaced,
        "unsettled": result.unsettled,
        "assumed": list(result.assumed),
        "utilisation": {
            name: {"mean": encode_number(share.mean), "peak": encode_number(share.peak)}
            for name, share in _select_shown(result).items()
        },
    }
