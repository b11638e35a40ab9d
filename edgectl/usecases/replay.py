"""replay: decide what was recorded again, under other rules; no host is asked."""

from collections.abc import Sequence

from edgectl.evidence.past import snapshots_of
from edgectl.evidence.replay import replay as replayed
from edgectl.model.evidence import Replayed, Variant
from edgectl.model.snapshot import Snapshot
from edgectl.usecases.fleet import Fleet


def replay(fleet: Fleet, snapshots: Sequence[Snapshot], variants: Sequence[Variant]) -> tuple[Replayed, ...]:
    """Each variant over ``snapshots``, which may stand in any order."""
    ordered = sorted(snapshots, key=lambda snapshot: snapshot.taken_at)
    return tuple(replayed(fleet.inventory, fleet.tasks, ordered, variant) for variant in variants)


def history(fleet: Fleet, since: float | None = None) -> tuple[Snapshot, ...]:
    """The snapshots that the history can make again. ``since``: s since 1970."""
    rows = fleet.history.use(
        fleet.state,
        fleet.warn,
        lambda store: (store.host_points(since=since), store.link_points(since=since), store.task_points(since=since)),
    )
    return snapshots_of(fleet.inventory, *rows)
