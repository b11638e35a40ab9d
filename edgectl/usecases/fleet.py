# SPDX-License-Identifier: Apache-2.0
"""The fleet as every use case receives it: inventory, tasks, transport and state."""

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING

from edgectl.dataclass import dataclass
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from edgectl.state.json_files import Warn, ignore_warning
from edgectl.state.store_handle import StoreHandle
from edgectl.state.uptime import Uptime, read_uptime
from edgectl.transport.base import Transport
from edgectl.transport.fleet_lease import FleetLease

if TYPE_CHECKING:
    from edgectl.gateway.host_probe import HostCallback


# Of the hosts that are asked: the listener that is told as each one ends, None for nobody.
ShowProbe = Callable[[Sequence[str]], AbstractContextManager["HostCallback | None"]]


def show_nothing(_hosts: Sequence[str]) -> "AbstractContextManager[HostCallback | None]":
    """Tell nobody of a probe."""
    return nullcontext()


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """Inventory and tasks as loaded, a transport, and the fleet's state directory
    (``state.paths.fleet_dir``).

    ``clock`` gives s since 1970, ``uptime`` monotonic seconds. ``warn`` receives warnings that do not stop
    the call; ``history`` records samples and actions. ``lease``: the hold of the fleet by this run, while it
    changes something. ``show_probe`` shows how a probe gets on.
    """

    inventory: Inventory
    tasks: Tasks
    transport: Transport
    state: Path
    clock: Callable[[], float] = time.time
    warn: Warn = ignore_warning
    uptime: Callable[[], Uptime] = read_uptime
    history: StoreHandle = field(default_factory=StoreHandle)
    lease: FleetLease | None = None
    show_probe: ShowProbe = show_nothing
