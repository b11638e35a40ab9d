# SPDX-License-Identifier: Apache-2.0
"""get command."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.completion import complete_entries, complete_hosts
from edgectl.cli.listing_fields import list_field, sort_listing
from edgectl.cli.selector import matches_selector
from edgectl.cli.signals import catch_stop_signals, parse_every_option
from edgectl.cli.user_files import load_inputs
from edgectl.errors import UsageError
from edgectl.names import check_known_names
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.model.snapshot import Snapshot
    from edgectl.usecases.fleet import Fleet
    from edgectl.views.listing import ListingChangesView
    from edgectl.views.listing_items import Listing

_KIND_NAMES = ("hosts", "edges", "robots", "tasks", "links")
# Of names as -o name prints them.
_PREFIXES = ("edge/", "robot/", "host/", "task/", "link/")
# What `get all` lists, in this order.
_ALL = ("hosts", "tasks", "links")


def _complete_kinds(incomplete: str) -> list[str]:
    return [kind for kind in (*_KIND_NAMES, "all") if kind.startswith(incomplete)]


def _complete_names(incomplete: str) -> list[str]:
    return [*complete_hosts(incomplete), *complete_entries(incomplete)]


_KindArgument = Annotated[
    str,
    Argument(
        metavar="KIND",
        autocompletion=_complete_kinds,
        help="hosts, edges, robots, tasks, links or all.",
        show_default=False,
    ),
]
_NamesArgument = Annotated[
    list[str] | None,
    Argument(
        metavar="[NAME...]",
        autocompletion=_complete_names,
        help="Only these names; of links, either end.",
        show_default=False,
    ),
]


def get_command(
    *,
    kind: _KindArgument,
    names: _NamesArgument = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FleetOutput = OutputFormat.TABLE,
    selector: options.SelectorOption = None,
    sort_by: options.SortByOption = None,
    field: options.FieldOption = None,
    no_headers: options.NoHeadersOption = False,
    watch: options.WatchOption = False,
    every: options.EveryOption = "2s",
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """List hosts, edges, robots, tasks or links from a probe, or all of these. With -w, also print a line at
    each change that is not a measurement.

    Selectors match the labels of the files, host, kind and state; of tasks also robot and task.

    With -w, -o json prints one object per line: {"type": "ADDED", "MODIFIED" or "DELETED", "at": ..,
    "object": ..}.

    Examples:
        edgectl get edges -o wide
        edgectl get tasks -l task=detection
        edgectl get hosts --sort-by cpu.used_cores --no-headers
        edgectl get tasks -w -o json
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.probe import probe_fleet
    from edgectl.usecases.status import probe_repeatedly
    from edgectl.views.listing_items import ListingKind, build_listing
    from edgectl.views.output_format import NAMED_STREAM_FORMATS, check_output_format

    if kind == "all" and (sort_by or field):
        raise UsageError("the items of all have no common keys", hint="name one kind: edgectl get hosts ..")
    kinds, period = [ListingKind(each) for each in _resolve_kinds(kind)], parse_every_option(every)
    fleet = build_fleet(load_inputs(inventory, tasks, needs_tasks=ListingKind.TASKS in kinds))
    named = [name.partition("/")[2] if name.startswith(_PREFIXES) else name for name in names or ()]
    _check_names_and_selector(kind, kinds, named, selector, fleet)

    def build(wanted: ListingKind, look: "Snapshot") -> "Listing":
        made = build_listing(wanted, look, fleet.inventory, fleet.tasks)
        return sort_listing(_filter_listing(made, named, selector), sort_by)

    if watch:
        if len(kinds) > 1 or field is not None:
            raise UsageError("-w lists one kind, whole", hint="omit --field, and name the kind")
        check_output_format(output, NAMED_STREAM_FORMATS)
        with catch_stop_signals(period) as end:
            found = (build(kinds[0], seen) for seen in probe_repeatedly(fleet, end))
            name = "" if no_headers else fleet.inventory.fleet
            console.print_view_series(_stream_listing_changes(found), output, fleet=name)
        return
    snapshot = probe_fleet(fleet)
    listings = [build(wanted, snapshot) for wanted in kinds]
    if field is not None:
        console.print_lines(line + "\n" for listing in listings for line in _list_field(listing, field))
    else:
        _print_listings(listings, output, fleet=None if no_headers else fleet.inventory.fleet)
    raise Exit(exit_codes.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def _list_field(listing: "Listing", field: str) -> list[str]:
    return list_field([item.document for item in listing.items], field, listing.kind.removesuffix("s"))


def _print_listings(listings: "Sequence[Listing]", output: OutputFormat, *, fleet: str | None) -> None:
    """``fleet``: its name, None to omit the headings."""
    from edgectl.views.listing import AllListingsView, ListingView

    if len(listings) == 1:
        console.print_view(ListingView(listings[0], headers=fleet is not None), output, fleet=fleet or "")
    else:
        console.print_view(AllListingsView(listings, headers=fleet is not None), output, fleet=fleet or "")


def _resolve_kinds(word: str) -> Sequence[str]:
    """The kinds by plural, singular or first letter of one; ``all`` stands for hosts, tasks and links."""
    return _ALL if word == "all" else (_resolve_kind(word),)


def _resolve_kind(word: str) -> str:
    """The kind by its plural, singular or first letter."""
    named = next((kind for kind in _KIND_NAMES if word and word in (kind, kind[:-1], kind[0])), word)
    check_known_names([named], (*_KIND_NAMES, "all"), "kind")
    return named


def _check_names_and_selector(
    word: str, kinds: Sequence[str], names: Sequence[str], selector: str | None, fleet: "Fleet"
) -> None:
    """Reject unknown names before a host is asked. A task that left the files may still run, so its name is
    accepted.
    """
    if selector is not None:
        matches_selector(selector, {})
    if names and len(kinds) > 1:
        raise UsageError(f"{word} takes no names", hint=f"edgectl get tasks {names[0]}")
    kind = kinds[0]
    if kind == "tasks" or not names:
        return
    edges, robots = ([host.name for host in part] for part in (fleet.inventory.edges, fleet.inventory.robots))
    among = {
        "hosts": [*edges, *robots],
        "edges": edges,
        "robots": robots,
        "links": [*edges, *robots, *(f"{e}/{r}" for e in edges for r in robots)],
    }[kind]
    check_known_names(names, among, kind.removesuffix("s") if kind != "links" else "end of a link")


def _filter_listing(value: "Listing", names: Sequence[str] | None, selector: str | None) -> "Listing":
    """The items that match names and selector.

    Raises:
        UsageError: no item has this name.
    """
    if names:
        check_known_names(
            names,
            dict.fromkeys(name for item in value.items for name in item.aliases),
            value.kind.removesuffix("s"),
        )
    items = (item for item in value.items if not names or not set(item.aliases).isdisjoint(names))
    return replace(
        value,
        items=tuple(item for item in items if selector is None or matches_selector(selector, item.labels)),
    )


def _stream_listing_changes(found: "Iterator[Listing]") -> "Iterator[ListingChangesView]":
    """The changes of each probe that differs from the one before."""
    from edgectl.views.listing import ListingChangesView
    from edgectl.views.listing_items import compare_listings

    first: Listing | None = None
    before: Listing | None = None
    for value in found:
        changed = compare_listings(before, value)
        if changed or first is None:
            yield ListingChangesView(value, changed, first)
        first, before = first or value, value
