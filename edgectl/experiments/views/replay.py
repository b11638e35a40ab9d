"""What other rules would have done with what was recorded, as text and as a document."""

from collections.abc import Iterable

from edgectl.experiments.model.comparison import ReplayResult, Utilisation
from edgectl.formats.document import FORMAT_VERSION, Document, encode_number
from edgectl.names import format_name_list, natural_key
from edgectl.views.plan_sections import render_notes
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns, wrap_text

_OPEN_LOOP_NOTE = (
    "Open loop: what tasks used and how long they ran is as recorded, whatever a variant decided; "
    "edgectl simulate closes the loop in a model."
)


def render_replay(values: Iterable[ReplayResult], look: RenderOptions = PLAIN) -> str:
    """One line per variant; utilisations as mean and peak over edges (or links) and cycles."""
    found = list(values)
    cycles = max((value.cycles for value in found), default=0)
    rows: list[Row] = [("VARIANT", "HANDOFFS", "PER CYCLE", "UNPLACED", "CPU", "MEMORY", "NETWORK")]
    rows += [
        (
            Cell(value.scheme.name, "name"),
            str(value.handoffs),
            _format_handoffs_per_cycle(value),
            str(value.unplaced),
            *(_format_utilisation(share) if value.cycles else "-" for share in _list_utilisations(value)),
        )
        for value in found
    ]
    body = render_columns(rows, look, right={1, 2, 3, 4, 5, 6})
    return (
        body
        + wrap_text(f"{cycles} cycles; utilisation as mean/peak. {_OPEN_LOOP_NOTE}", look)
        + render_notes(_describe_assumed_tasks(found), look)
    )


def _describe_assumed_tasks(values: Iterable[ReplayResult]) -> list[str]:
    tasks = sorted({task for value in values for task in value.assumed}, key=natural_key)
    return (
        [
            f"never seen running, so that what it demands counts as its use: {format_name_list(tasks)} ({len(tasks)})"
        ]
        if tasks
        else []
    )


def _format_handoffs_per_cycle(value: ReplayResult) -> str:
    return f"{value.handoffs / value.cycles:.3f}" if value.cycles else "-"


def _list_utilisations(value: ReplayResult) -> tuple[Utilisation, Utilisation, Utilisation]:
    return value.cpu, value.memory, value.network


def _format_utilisation(value: Utilisation) -> str:
    return f"{value.mean:.0%}/{value.peak:.0%}"


def encode_replay(values: Iterable[ReplayResult]) -> Document:
    """The same numbers as JSON types; utilisations are shares of the capacity."""
    return {
        "format_version": FORMAT_VERSION,
        "open_loop": True,
        "variants": [_encode_replay_result(value) for value in values],
    }


def _encode_replay_result(value: ReplayResult) -> Document:
    policy = value.scheme.policy
    return {
        "name": value.scheme.name,
        "policy": policy.name.value,
        "move_margin": encode_number(policy.move_margin),
        "cycles": value.cycles,
        "handoffs": value.handoffs,
        "unplaced": value.unplaced,
        "unsettled": value.unsettled,
        "assumed": list(value.assumed),
        **{
            name: {"mean": encode_number(share.mean), "peak": encode_number(share.peak)}
            for name, share in zip(_UTILISATION_NAMES, _list_utilisations(value), strict=True)
        },
    }


_UTILISATION_NAMES = ("cpu", "memory", "network")
