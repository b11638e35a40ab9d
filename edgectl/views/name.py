"""Names only, one per line, to be piped into other commands."""

from collections.abc import Iterable, Sequence

from edgectl.model.inventory import Inventory
from edgectl.model.plan import Plan
from edgectl.model.result import Results
from edgectl.model.revision import Revision
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.views.listing import ItemChange, Listing, ListingItem
from edgectl.views.profilers import render_profiler_names as profilers  # noqa: F401
from edgectl.views.table import list_task_runs
from edgectl.views.text import PLAIN, RenderOptions


def plan(value: Plan, _look: RenderOptions = PLAIN) -> str:
    """The tasks of the plan."""
    return "".join(f"task/{step.task}\n" for step in value.steps)


def snapshot(value: Snapshot, _look: RenderOptions = PLAIN) -> str:
    """The hosts that answered, as edge/NAME or robot/NAME."""
    return "".join(f"{host.role}/{name}\n" for name, host in value.hosts.items() if host.ok)


def status(value: Snapshot, _inventory: Inventory, _tasks: Tasks, _look: RenderOptions = PLAIN) -> str:
    """The tasks that run."""
    return "".join(
        f"task/{name}\n"
        for name in dict.fromkeys(task for task, _, sample in list_task_runs(value) if sample.state.alive)
    )


def nothing(_look: RenderOptions = PLAIN) -> str:
    """No task was touched."""
    return ""


def history(values: Iterable[Revision], _look: RenderOptions = PLAIN) -> str:
    """The numbers, as revision/N."""
    return "".join(f"revision/{value.number}\n" for value in values)


def revision(value: Revision, _look: RenderOptions = PLAIN) -> str:
    """The tasks that were touched."""
    return results(value.results)


def results(value: Results, _look: RenderOptions = PLAIN) -> str:
    """The tasks that were touched."""
    return "".join(f"task/{action.task}\n" for action in value.actions)


def drained(passes: Iterable[Results], _left: object, _done: object, _look: RenderOptions = PLAIN) -> str:
    """The tasks that were touched, each once."""
    return "".join(
        f"task/{name}\n" for name in dict.fromkeys(action.task for each in passes for action in each.actions)
    )


def bandwidth(value: Snapshot, _links: object, look: RenderOptions = PLAIN) -> str:
    """As of a snapshot."""
    return snapshot(value, look)


def listing(value: Listing, _look: RenderOptions = PLAIN) -> str:
    """What is listed, as KIND/NAME."""
    return "".join(f"{name}\n" for name in dict.fromkeys(item.name for item in value.items))


def listing_more(
    _value: Listing,
    changed: Sequence[tuple[ItemChange, ListingItem]],
    _first: Listing | None,
    _look: RenderOptions = PLAIN,
) -> str:
    """What changed."""
    return "".join(f"{item.name}\n" for _, item in changed)
