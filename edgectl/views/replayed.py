"""What other rules would have done with what was recorded, as text and as a document."""

from collections.abc import Iterable

from edgectl.formats.base import FORMAT_VERSION, Document, number
from edgectl.model.evidence import Replayed, Share
from edgectl.model.names import listed
from edgectl.model.order import natural_key
from edgectl.views.sections import note_lines
from edgectl.views.text import PLAIN, Cell, Look, Row, columns, flowed

_OPEN_LOOP = (
    "Open loop: what tasks used and how long they ran is as recorded, whatever a variant decided; "
    "edgectl simulate closes the loop in a model."
)


def text(values: Iterable[Replayed], look: Look = PLAIN) -> str:
    """One line per variant; utilisations as mean and peak over edges (or links) and cycles."""
    found = list(values)
    cycles = max((value.cycles for value in found), default=0)
    rows: list[Row] = [("VARIANT", "HANDOFFS", "PER CYCLE", "UNPLACED", "CPU", "MEMORY", "NETWORK")]
    rows += [
        (
            Cell(value.variant.name, "name"),
            str(value.handoffs),
            _per_cycle(value),
            str(value.unplaced),
            *(_share(share) if value.cycles else "-" for share in _shares(value)),
        )
        for value in found
    ]
    body = columns(rows, look, right={1, 2, 3, 4, 5, 6})
    return body + flowed(f"{cycles} cycles; utilisation as mean/peak. {_OPEN_LOOP}", look) + note_lines(_assumed(found), look)


def _assumed(values: Iterable[Replayed]) -> list[str]:
    tasks = sorted({task for value in values for task in value.assumed}, key=natural_key)
    return [f"never seen running, so that what it demands counts as its use: {listed(tasks)} ({len(tasks)})"] if tasks else []


def _per_cycle(value: Replayed) -> str:
    return f"{value.handoffs / value.cycles:.3f}" if value.cycles else "-"


def _shares(value: Replayed) -> tuple[Share, Share, Share]:
    return value.cpu, value.memory, value.network


def _share(value: Share) -> str:
    return f"{value.mean:.0%}/{value.peak:.0%}"


def document(values: Iterable[Replayed]) -> Document:
    """The same numbers as JSON types; utilisations are shares of the capacity."""
    return {"format_version": FORMAT_VERSION, "open_loop": True, "variants": [_replayed(value) for value in values]}


def _replayed(value: Replayed) -> Document:
    policy = value.variant.policy
    return {
        "name": value.variant.name,
        "policy": policy.name.value,
        "move_margin": number(policy.move_margin),
        "cycles": value.cycles,
        "handoffs": value.handoffs,
        "unplaced": value.unplaced,
        "unsettled": value.unsettled,
        "assumed": list(value.assumed),
        **{name: {"mean": number(share.mean), "peak": number(share.peak)} for name, share in zip(_NAMES, _shares(value), strict=True)},
    }


_NAMES = ("cpu", "memory", "network")
