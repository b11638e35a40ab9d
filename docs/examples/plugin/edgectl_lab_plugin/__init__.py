"""One plugin of each kind for edgectl, as small as they can be."""

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from edgectl.api import (
    Finding,
    Host,
    HostFacts,
    Inventory,
    LocalTransport,
    Session,
    Severity,
    Snapshot,
    Tasks,
    Transport,
)


def check_memory(
    inventory: Inventory, answers: Mapping[str, object], _snapshot: Snapshot | None
) -> Iterator[Finding]:
    """A check of the doctor: hosts with less than 2 GiB of memory cannot hold the lab's maps."""
    for name in inventory.hosts:
        facts = answers.get(name)
        if isinstance(facts, HostFacts) and facts.total_bytes < 2 * 2**30:
            yield Finding(
                host=name,
                check="lab memory",
                level=Severity.WARNING,
                message=f"{facts.total_bytes / 2**30:.1f} GiB of memory; maps of the lab need 2 GiB",
                remedy=f"give {name} smaller maps: map_resolution: 0.1",
            )
        elif isinstance(facts, HostFacts):
            yield Finding(
                host=name, check="lab memory", level=Severity.OK, message="enough for maps of the lab"
            )


class LoudTransport:
    """The local machine, as ``connection: local``; each connection is reported on standard error."""

    def __init__(self) -> None:
        self._local: Transport = LocalTransport()

    def connect(self, host: Host, *, timeout: float) -> Session:
        """Open a session and say so."""
        sys.stderr.write(f"loud-local: {host.name}\n")
        return self._local.connect(host, timeout=timeout)

    def address(self, host: Host) -> str:
        """The address of this machine."""
        return self._local.address(host)


def make_transport() -> Transport:
    """The transport for hosts with ``transport: loud-local``."""
    return LoudTransport()


def append_to_file(document: Mapping[str, Any], options: Mapping[str, str]) -> None:
    """A notifier: append the events to ``options["path"]``, one JSON object a line."""
    with Path(options["path"]).open("a") as file:
        for event in document["items"]:
            file.write(json.dumps({"fleet": document["fleet"], **event}) + "\n")


def rate_shade(inventory: Inventory, tasks: Tasks, _snapshot: Snapshot) -> dict[str, dict[str, float]]:
    """A term: hosts that the inventory labels ``sun: yes`` are worth half of the others, for every task."""
    rated = {name: 0.5 if host.labels.get("sun") == "yes" else 1.0 for name, host in inventory.hosts.items()}
    return dict.fromkeys(tasks.tasks, rated)


def prefer_few_tasks(inventory: Inventory, tasks: Tasks, snapshot: Snapshot) -> dict[str, dict[str, float]]:
    """A policy: the fewer tasks run on a host already, the better it is; one that does not answer is 0."""
    counts = {
        name: sum(run.state.alive for run in host.tasks.values())
        for name, host in snapshot.hosts.items()
        if host.ok
    }
    most = max(counts.values(), default=0) + 1
    rated = {name: 1 - counts[name] / most if name in counts else 0.0 for name in inventory.hosts}
    return dict.fromkeys(tasks.tasks, rated)
