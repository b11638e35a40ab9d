# SPDX-License-Identifier: Apache-2.0
"""Import packages without modules of others that they import and that nothing of ours uses."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

# By package. paramiko imports invoke for ``Match exec`` of ssh_config, which edgectl leaves to ssh, and a
# parser of e-mail for its version. invoke imports Mock (with asyncio and ssl) for its MockContext, and a YAML
# parser for files of its own. typer imports what finds similar words, what names the system, and UUIDs, for
# options of a type that edgectl has none of.
DEFERRED_MODULES = {
    "typer.main": ("difflib", "platform", "uuid"),
    "paramiko": ("invoke", "importlib.metadata"),
    "fabric": ("unittest.mock", "invoke.vendor.yaml", "importlib.metadata"),
}
_IMPORTING = threading.RLock()


class _DeferredModule(ModuleType):
    """Stands for a module: what is imported from it is a function that imports the module when called."""

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)

        def call(*args: object, **options: object) -> object:
            _remove_stand_in(self)
            return getattr(import_module(self.__name__), name)(*args, **options)

        return call


def import_deferred(name: str) -> ModuleType:
    """Import the module ``name``; its ``DEFERRED_MODULES`` are imported when they are used.

    Where a module uses one of them while it is imported, other than by a call, all are imported at once.
    """
    with _IMPORTING:
        if name in sys.modules:
            return sys.modules[name]
        try:
            with _put_stand_ins(DEFERRED_MODULES.get(name, ())):
                return import_module(name)
        except (AttributeError, ImportError, TypeError):
            return import_module(name)


@contextmanager
def _put_stand_ins(names: tuple[str, ...]) -> Iterator[None]:
    stand_ins = [_DeferredModule(name) for name in names if name not in sys.modules]
    for each in stand_ins:
        if each.__name__ == "importlib.metadata":
            each.version = _read_version  # type: ignore[attr-defined]
        sys.modules[each.__name__] = each
    try:
        yield
    finally:
        for each in stand_ins:
            _remove_stand_in(each)


def _remove_stand_in(module: ModuleType) -> None:
    if sys.modules.get(module.__name__) is module:
        del sys.modules[module.__name__]


def _read_version(distribution: str) -> str:
    """The version by the name of the directory beside the package of the same name, as installers make it."""
    spec = find_spec(distribution)
    if spec is not None and spec.origin is not None:
        found = list(Path(spec.origin).parents[1].glob(f"{distribution}-*.dist-info"))
        if len(found) == 1:
            return found[0].stem.removeprefix(f"{distribution}-")
    sys.modules.pop("importlib.metadata", None)
    from importlib.metadata import version

    return version(distribution)
