# SPDX-License-Identifier: Apache-2.0
"""Connection to the file of a history: opened at first use, set aside if broken; failures are warnings."""

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from edgectl.errors import StateError
from edgectl.state.json_files import Warn
from edgectl.state.store_file import (
    get_file_identity,
    is_transient_error,
    open_database,
    set_aside_database,
)
from edgectl.state.store_rows import DamagedRowError

Value = TypeVar("Value")


class StoreConnection:
    """The file at ``path``, for one thread at a time. The first failure is reported through ``warn``."""

    def __init__(self, path: Path, warn: Warn) -> None:
        self.path = path
        self._warn = warn
        self._connection: sqlite3.Connection | None = None
        self._opened: tuple[int, int] | None = None
        self._warned = False

    def use(self) -> sqlite3.Connection:
        """The open connection.

        Raises:
            sqlite3.Error: the file is broken, or cannot be used.
            StateError: it cannot be created, or a newer edgectl wrote it.
        """
        if self._connection is not None and get_file_identity(self.path) != self._opened:
            # Another edgectl set it aside, or it was removed.
            self.close()
        if self._connection is None:
            self._opened = get_file_identity(self.path)
            self._connection = open_database(self.path)
            self._opened = get_file_identity(self.path)
        return self._connection

    def run(self, act: Callable[[sqlite3.Connection], Value], default: Value) -> Value:
        """The result of ``act``, retried with a new file if this one is broken; else ``default``, with a
        warning.
        """
        for _ in range(2):
            try:
                return act(self.use())
            except (sqlite3.Error, DamagedRowError) as error:
                if (isinstance(error, sqlite3.Error) and is_transient_error(error)) or not self._set_aside(
                    error
                ):
                    self._warn_once(f"history is not recorded: {self.path}: {error}")
                    return default
            except (OSError, StateError, ValueError, OverflowError) as error:
                self._warn_once(f"history is not recorded: {error}")
                return default
        return default

    def write(self, act: Callable[[sqlite3.Connection], None]) -> bool:
        """Run ``act`` in a transaction, whole or not at all, and return which; as ``run``."""

        def within(connection: sqlite3.Connection) -> bool:
            connection.execute("BEGIN IMMEDIATE")
            try:
                act(connection)
                connection.execute("COMMIT")
            except BaseException:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                raise
            return True

        return self.run(within, default=False)

    def close(self) -> None:
        """Close the file; the next use opens it again."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _set_aside(self, error: Exception) -> bool:
        """Whether the broken file was set aside."""
        self.close()
        try:
            aside = set_aside_database(self.path, self._opened)
        except OSError:
            return False
        if aside is not None:
            self._warn(
                f"{self.path} is broken ({error}); set aside as {aside.name}, a new history is started"
            )
        return True

    def _warn_once(self, text: str) -> None:
        if not self._warned:
            self._warned = True
            self._warn(text)
