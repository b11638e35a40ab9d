"""Inventory of a fleet from one file or several (ADR 138)."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from edgectl.config.fields import Fields, merge_keys, read_fields
from edgectl.config.fleet_name import derive_fleet_name
from edgectl.config.inventory_file import (
    INVENTORY_KEYS,
    expand_identity_file,
    read_defaults,
    read_host_entries,
    read_link_entries,
)
from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems
from edgectl.config.ros_rules import check_host_addresses
from edgectl.config.ros_settings import resolve_master
from edgectl.config.scalars import INVALID
from edgectl.formats.digest import digest_inventory
from edgectl.model.event import EventHook
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.names import natural_key

# Keys that say the same of the whole fleet: at most one statement of each.
_FLEET_KEYS = ("fleet", "probe_links", "coordination")
_HOST_KEYS = (("edges", Role.EDGE), ("robots", Role.ROBOT))


def read_inventories(nodes: Sequence[Node], problems: Problems) -> Inventory:
    """The inventory that the files state together, with everything wrong noted.

    The order of the files does not matter. Hosts that have mistakes are in it, so that tasks can refer to
    them.
    """
    files = [
        read_fields(node, problems, INVENTORY_KEYS, required=("version",), what="an inventory")
        for node in nodes
    ]
    hosts, places = _read_hosts(files, problems)
    if not hosts and not problems.errors:
        problems.add(
            nodes[0].mark,
            ProblemCode.MISSING,
            "the inventory names no host",
            "add edges: {edge1: {host: 192.168.1.20}}",
        )
    ordered = {key: resolve_master(hosts[key], hosts) for key in sorted(hosts, key=natural_key)}
    for host, message in check_host_addresses(ordered):
        problems.add(
            places[host.name],
            ProblemCode.ROS,
            message,
            "state ros: {version: 1, master: HOST} and remove the variable: edgectl then derives the address",
            warning=True,
        )
    links: dict[tuple[str, str], float] = {}
    for top in files:
        if "links" in top:
            read_link_entries(top.at("links"), ordered, links, problems)
    stated = merge_keys(files, _FLEET_KEYS, problems)
    fleet = stated.get("fleet") or derive_fleet_name(Path(nodes[0].mark.source.file))
    _check_fleet_name(files, fleet, problems)
    inventory = Inventory(
        hosts=ordered,
        links=dict(sorted(links.items(), key=_build_link_key)),
        fleet=fleet,
        is_fleet_named="fleet" in stated,
        probe_links=stated.get("probe_links", True),
        coordination=stated.get("coordination"),
        on_event=_read_on_event(files, problems),
    )
    # The digest is of the files alone: no path and no home of a user may change it.
    return replace(
        inventory,
        hosts={key: replace(expand_identity_file(host), fleet=fleet) for key, host in ordered.items()},
        digest=digest_inventory(inventory),
    )


def _build_link_key(item: tuple[tuple[str, str], float]) -> tuple[object, object]:
    return natural_key(item[0][0]), natural_key(item[0][1])


def _read_hosts(files: Sequence[Fields], problems: Problems) -> tuple[dict[str, Host], dict[str, Mark]]:
    """The hosts of all files, each with the defaults of its own file, and where each is named."""
    hosts: dict[str, Host] = {}
    places: dict[str, Mark] = {}
    for top in files:
        defaults = read_defaults(top.at("defaults"), problems) if "defaults" in top else {}
        for key, role in _HOST_KEYS:
            if key in top:
                read_host_entries(top.at(key), role, defaults, hosts, places, problems)
    return hosts, places


def _read_on_event(files: Sequence[Fields], problems: Problems) -> tuple[EventHook, ...]:
    """The programs of all files. Those of several files stand in an order that is not that of the files."""
    nodes = [top.at("on_event") for top in files if "on_event" in top]
    if not nodes:
        return ()
    from edgectl.config.event_hooks import read_event_hooks

    read = [read_event_hooks(node, problems) for node in nodes]
    hooks = tuple(hook for each in read if each is not INVALID for hook in each)
    return hooks if len(nodes) == 1 else tuple(sorted(hooks, key=repr))


def _check_fleet_name(files: Sequence[Fields], fleet: str, problems: Problems) -> None:
    """A fleet of several files, and one with coordination, needs a name that stands in a file."""
    if any("fleet" in top for top in files):
        return
    coordinated = next((top.node for top in files if "coordination" in top), None)
    if coordinated is not None:
        problems.add(
            coordinated.key_mark("coordination"),
            ProblemCode.MISSING,
            "coordination needs fleet: every machine must know the fleet by the same name",
            f"add fleet: {fleet}",
        )
    elif len(files) > 1:
        problems.add(
            files[0].node.mark,
            ProblemCode.MISSING,
            f"none of the {len(files)} inventories names the fleet that they make together",
            "add fleet: NAME to one of them",
        )
