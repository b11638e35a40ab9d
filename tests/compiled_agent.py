# SPDX-License-Identifier: Apache-2.0
"""The agent on the hosts of tests, with its code compiled: as on any host that edgectl has asked before.

To compile the code of an operation takes three times the CPU of a request, and every test has new hosts. What the first
request to a new host does is tested in `tests/agent/test_boot.py`.
"""

import os
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock

from edgectl.config.load import load_inventory
from edgectl.transport.agent_archive import build_agent_zipapp, compute_agent_hash
from edgectl.transport.agent_client import _PROCESS_KEY

# Of two threads that create it at once, the folder of one is removed under the other.
_CREATION = Lock()


@cache
def _create_shared_folder() -> "TemporaryDirectory[str]":
    """The agent, and a directory for the code that any host compiles; removed with this process."""
    shared = TemporaryDirectory(prefix="edgectl-agent-")
    agent = Path(shared.name) / "agent.pyz"
    agent.touch(mode=0o600)
    agent.write_bytes(build_agent_zipapp())
    (Path(shared.name) / "code").mkdir(mode=0o700)
    return shared


def give_agent(state: Path) -> None:
    """Put the agent into ``state``, the state directory of a host, if there is none.

    All hosts of this process share the code that one of them has compiled. It is sealed for requests of this process.
    """
    with _CREATION:
        shared = Path(_create_shared_folder().name)
    agents = state / "agent"
    if agents.exists():
        return
    state.mkdir(mode=0o700, parents=True, exist_ok=True)
    agents.mkdir(mode=0o700)
    os.link(shared / "agent.pyz", agents / f"{compute_agent_hash()}.pyz")
    (agents / compute_agent_hash()).symlink_to(shared / "code")


def give_agent_and_keys(state: Path, *inventories: Path) -> None:
    """Put the agent into ``state``, that of a manager and of its local hosts, with the keys of these fleets."""
    give_agent(state)
    for inventory in inventories:
        give_key(state, load_inventory(inventory).fleet)


def give_scaffold_keys(state: Path, site: Path) -> None:
    """The same for both fleets of a scaffold in ``site``."""
    give_agent_and_keys(state, site / "inventories" / "local.yaml", site / "tasks" / "patrol" / "fleet.yaml")


def give_key(state: Path, fleet: str) -> None:
    """Let the manager with the state directory ``state`` seal code of ``fleet`` as this process does."""
    for folder in (state, state / "fleets", state / "fleets" / fleet):
        folder.mkdir(mode=0o700, exist_ok=True)
    key = state / "fleets" / fleet / "agent-key"
    if not key.exists():
        key.touch(mode=0o600)
        key.write_text(_PROCESS_KEY)
