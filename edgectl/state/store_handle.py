# SPDX-License-Identifier: Apache-2.0
"""Shared SQLite connection per fleet: reopening costs an fsync for every record."""

import sys
import threading
import weakref
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from edgectl.state.json_files import Warn, ignore_warning

if TYPE_CHECKING:
    from edgectl.state.store import Store

Value = TypeVar("Value")


class StoreHandle:
    """Opens the history at first use, and closes it when the last fleet that shares the handle is gone, or at
    exit.

    Thread-safe. Each warning is printed once.
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._voice = _WarnOnce()
        self._open: dict[Path, Store] = {}
        weakref.finalize(self, _close_stores, self._open)

    def prepare(self) -> None:
        """Import what the history needs, 10 ms, in a thread: while hosts are waited for."""
        if "edgectl.state.store" not in sys.modules:
            threading.Thread(target=partial(import_module, "edgectl.state.store"), daemon=True).start()

    def use(self, fleet_dir: Path, warn: Warn, act: "Callable[[Store], Value]") -> Value:
        """The result of ``act`` with the history of ``fleet_dir``."""
        from edgectl.state.store import Store

        with self._guard:
            self._voice.warn = warn
            if fleet_dir not in self._open:
                _close_stores(self._open)
                self._open[fleet_dir] = Store.open(fleet_dir, warn=self._voice)
            return act(self._open[fleet_dir])


class _WarnOnce:
    """Prints a text once. It has no reference to the handle, which a store would otherwise keep alive."""

    def __init__(self) -> None:
        self.warn: Warn = ignore_warning
        self._said: set[str] = set()

    def __call__(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self.warn(text)


def _close_stores(stores: "dict[Path, Store]") -> None:
    while stores:
        stores.popitem()[1].close()
