"""get."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit

from edgectl.cli import console, exits, options
from edgectl.cli.complete import hosts, tasks
from edgectl.cli.inputs import load
from edgectl.cli.selector import matches
from edgectl.cli.until import pause, told
from edgectl.errors import UsageError
from edgectl.model.names import known
from edgectl.views.form import Form

if TYPE_CHECKING:
    from edgectl.usecases.fleet import Fleet
    from edgectl.views.listing import Change, Item, Listing

_KINDS = ("edges", "robots", "tasks", "links")


def _kinds(incomplete: str) -> list[str]:
    return [kind for kind in _KINDS if kind.startswith(incomplete)]


def _names(incomplete: str) -> list[str]:
    return [*hosts(incomplete), *tasks(incomplete)]


def get_command(
    *,
    kind: Annotated[str, Argument(metavar="KIND", autocompletion=_kinds, help="edges, robots, tasks or links.", show_default=False)],
    names: Annotated[
        list[str] | None, Argument(metavar="[NAME...]", autocompletion=_names, help="Only these; of links, an end.", show_default=False)
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FleetOutput = Form.TABLE,
    selector: options.SelectorOption = None,
    watch: options.WatchOption = False,
    every: options.EveryOption = "2s",
    allow_unreachable: options.AllowOption = False,
) -> None:
    """List edges, robots, tasks or links, from a probe. With -w a line follows whenever something but a measurement changes.

    With -w, -o json prints one object per line: {"type": "ADDED", "MODIFIED" or "DELETED", "at": .., "object": ..}.

    Examples:
        edgectl get edges -o wide
        edgectl get tasks -l task=detection
        edgectl get links edge1
        edgectl get tasks -w -o json
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases.look import looks
    from edgectl.usecases.probe import probe
    from edgectl.views.listing import Kind, listing

    wanted, period = Kind(_kind(kind)), pause(every)
    fleet = reach(load(inventory, tasks))
    _check(wanted, names or (), selector, fleet)
    if watch:
        if output is Form.YAML:
            raise UsageError("no yaml form of changes as they come", hint="write -o json, for one object per line")
        with told(period) as end:
            found = (_chosen(listing(wanted, look, fleet.inventory, fleet.tasks), names, selector) for look in looks(fleet, end))
            console.show_all(output, "listing_more", _differences(found))
        return
    snapshot = probe(fleet)
    console.show(output, "listing", _chosen(listing(wanted, snapshot, fleet.inventory, fleet.tasks), names, selector))
    raise Exit(exits.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def _kind(word: str) -> str:
    """The kind that is meant by its name, one of it, or its first letter."""
    named = next((kind for kind in _KINDS if word and word in (kind, kind[:-1], kind[0])), word)
    known([named], _KINDS, "kind")
    return named


def _check(kind: str, names: Sequence[str], selector: str | None, fleet: "Fleet") -> None:
    """Refuse what is none before a host is asked. A task that left the files may still run, so its name is not refused here."""
    if selector is not None:
        matches(selector, {})
    if kind == "tasks":
        return
    edges, robots = ([host.name for host in part] for part in (fleet.inventory.edges, fleet.inventory.robots))
    among = {"edges": edges, "robots": robots, "links": [*edges, *robots, *(f"{e}/{r}" for e in edges for r in robots)]}[kind]
    known(names, among, kind.removesuffix("s") if kind != "links" else "end of a link")


def _chosen(value: "Listing", names: Sequence[str] | None, selector: str | None) -> "Listing":
    """Only what is named and fits the selector.

    Raises:
        UsageError: a name that nothing has.
    """
    if names:
        known(names, dict.fromkeys(name for item in value.items for name in _called(item)), value.kind.removesuffix("s"))
    items = (item for item in value.items if not names or not set(_called(item)).isdisjoint(names))
    return replace(value, items=tuple(item for item in items if selector is None or matches(selector, dict(item.labels))))


def _called(item: "Item") -> list[str]:
    """What may be written for an item: its name, or of a link one of its ends."""
    return [str(item.document[key]) for key in ("name", "edge", "robot") if key in item.document]


def _differences(found: "Iterator[Listing]") -> "Iterator[tuple[Listing, list[tuple[Change, Item]], Listing | None]]":
    """Each look that changed something: itself, what changed, and the first one."""
    from edgectl.views.listing import changes

    first: Listing | None = None
    before: Listing | None = None
    for value in found:
        changed = changes(before, value)
        if changed or first is None:
            yield value, changed, first
        first, before = first or value, value
