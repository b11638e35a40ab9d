# SPDX-License-Identifier: Apache-2.0
"""Byte counters of the hosts: install, remove and show them."""

import dataclasses
from collections.abc import Sequence

from edgectl.doctor.ssh_command import format_ssh_command
from edgectl.errors import UsageError
from edgectl.gateway import byte_counters
from edgectl.model.byte_counters import ByteCounters
from edgectl.model.inventory import Host, Role
from edgectl.names import check_known_names
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import track_heartbeats

_TIMEOUT_S = 60.0


def ask_counters(fleet: Fleet, names: Sequence[str], action: str) -> tuple[ByteCounters, ...]:
    """The counters of the edges ``names``, of all where there is no name, after ``action``: install, remove
    or show. Where root's rights were refused, the hint is the command for a person who has them.

    Raises:
        UsageError: an edge is unknown.
    """
    hosts = _select_edges(fleet, names)
    with track_heartbeats(fleet) as near:
        found = byte_counters.ask_counters(hosts, fleet.inventory, near.transport, action, timeout=_TIMEOUT_S)
    return tuple(
        dataclasses.replace(each, hint=_format_script_command(host, action))
        if each.error and not each.hint and action != "show"
        else each
        for host, each in zip(hosts, found, strict=True)
    )


def build_script(fleet: Fleet, name: str, action: str) -> str:
    """The script that root runs on the edge ``name`` to install or remove its counters.

    Raises:
        UsageError: the edge is unknown.
        HostError: it did not answer, or its answer is of no use.
    """
    (host,) = _select_edges(fleet, [name])
    with track_heartbeats(fleet) as near:
        return byte_counters.build_counters_script(
            host, fleet.inventory, near.transport, action, timeout=_TIMEOUT_S
        )


def _select_edges(fleet: Fleet, names: Sequence[str]) -> list[Host]:
    edges = {host.name: host for host in fleet.inventory.hosts.values() if host.role is Role.EDGE}
    check_known_names(names, edges, "edge")
    found = [host for host in edges.values() if host.probe and (not names or host.name in names)]
    if not found:
        raise UsageError("no edge is probed", hint="set probe: true in the inventory")
    return found


def _format_script_command(host: Host, action: str) -> str:
    """The command by which a person runs the script as root, and types a password if sudo wants one."""
    script = f"$(edgectl counters {action} {host.name} --script)"
    login = format_ssh_command(host, "-t")
    return f"{login} \"sudo sh -c '{script}'\"" if login else f'sudo sh -c "{script}"'
