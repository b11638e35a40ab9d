# SPDX-License-Identifier: Apache-2.0
"""Memory of what the last probe left in the history, which the next one need not read again (ADR 200)."""

import sqlite3

from edgectl.dataclass import dataclass
from edgectl.state import store_write
from edgectl.state.store_events import KnownFleet


@dataclass(frozen=True, slots=True, kw_only=True)
class StoreMemory:
    """The numbers of the links and the known state of the fleet, as ``connection`` has left them.

    ``version``: changes where any other connection writes to the file. ``written``: the links of the last
    snapshot, while their samples wait.
    """

    connection: sqlite3.Connection
    version: int
    links: store_write.LinkNumbers
    fleet: KnownFleet
    written: store_write.WrittenLinks | None = None


def recall(connection: sqlite3.Connection, kept: StoreMemory | None) -> StoreMemory:
    """``kept``, if nobody has written since; else what the file has. Call it within a transaction.

    Raises:
        DamagedRowError: edgectl did not write it.
    """
    version = int(connection.execute("PRAGMA data_version").fetchone()[0])
    if kept is not None and kept.connection is connection and kept.version == version:
        return kept
    return StoreMemory(
        connection=connection,
        version=version,
        links=store_write.load_link_numbers(connection),
        fleet=store_write.load_known_fleet(connection),
    )
