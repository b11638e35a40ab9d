"""One open history for as long as a fleet is worked on: what is opened and closed for every record has to be synced every time."""

import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from edgectl.state.json_files import Warn, ignore_warning

if TYPE_CHECKING:
    from edgectl.state.store import Store

Value = TypeVar("Value")


class StoreHandle:
    """Opens the history when it is first needed, and closes it when the last fleet that shares this keeper is gone, or at exit.

    For any thread. Each trouble is said once, however often it is met.
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._voice = _WarnOnce()
        self._open: dict[Path, Store] = {}
        weakref.finalize(self, _close_stores, self._open)

    def use(self, fleet_dir: Path, warn: Warn, act: "Callable[[Store], Value]") -> Value:
        """What ``act`` gives, with the history of ``fleet_dir``."""
        from edgectl.state.store import Store

        with self._guard:
            self._voice.warn = warn
            if fleet_dir not in self._open:
                _close_stores(self._open)
                self._open[fleet_dir] = Store.open(fleet_dir, warn=self._voice)
            return act(self._open[fleet_dir])


class _WarnOnce:
    """Says a text once. It knows nothing of the keeper, or the store that has it would keep the keeper alive."""

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
