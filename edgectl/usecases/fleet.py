"""What every use case is given: the fleet, the way to it, and where its state lies."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from edgectl.state.files import Warn, silent
from edgectl.state.keeper import Keeper
from edgectl.state.uptime import Uptime
from edgectl.state.uptime import uptime as now_up
from edgectl.transport.base import Transport


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """Inventory and tasks as loaded, a transport, and the fleet's state directory (``state.paths.fleet_dir``).

    ``clock`` gives s since 1970, ``uptime`` time that nobody sets. ``warn`` hears what a user should know although the call goes on;
    ``history`` keeps what is seen and done.
    """

    inventory: Inventory
    tasks: Tasks
    transport: Transport
    state: Path
    clock: Callable[[], float] = time.time
    warn: Warn = silent
    uptime: Callable[[], Uptime] = now_up
    history: Keeper = field(default_factory=Keeper)
