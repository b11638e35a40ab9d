# SPDX-License-Identifier: Apache-2.0
"""Construction of a fleet from loaded files, for the command line and for programs."""

import contextlib
from collections.abc import Callable
from pathlib import Path

from edgectl.errors import StateError
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from edgectl.state.json_files import Warn
from edgectl.usecases.fleet import Fleet, ShowProbe, show_nothing


def open_fleet(
    inventory: Inventory,
    tasks: Tasks,
    state: Path,
    *,
    warn: Warn,
    accept_new: bool = False,
    ask_password: Callable[[str], str] | None = None,
    show_probe: ShowProbe = show_nothing,
) -> Fleet:
    """The fleet with a transport and its state directory. Nothing is contacted yet.

    ``accept_new`` records the keys of unknown hosts; ``ask_password`` is called with a prompt;
    None never asks. ``show_probe``: as of ``Fleet``.
    """
    from edgectl.state.cache_key import load_cache_key
    from edgectl.transport.agent_client import use_cache_key
    from edgectl.transport.fleet_transport import FleetTransport

    transport = FleetTransport(
        accept_new=accept_new, ask_password=ask_password, config_cache=state / "ssh-config.json"
    )
    with contextlib.suppress(StateError):  # doctor says what is wrong with the directory
        use_cache_key(inventory.fleet, load_cache_key(state))
    return Fleet(
        inventory=inventory, tasks=tasks, transport=transport, state=state, warn=warn, show_probe=show_probe
    )
