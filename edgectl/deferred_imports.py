# SPDX-License-Identifier: Apache-2.0
"""Import packages without modules that they import and most commands never use."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

# By package; only modules of which it takes functions and classes while it is imported.
DEFERRED_MODULES = {
    # Completion, questions and help; what finds similar words, what names the system, and UUIDs, for options
    # of a type that edgectl has none of.
    "typer.main": (
        *("difflib", "platform", "uuid"),
        *("typer.completion", "typer._completion_classes", "typer._click.shell_completion"),
        *("typer._click.termui", "typer._click.formatting"),
    ),
    # The parser and emitter in Python, beside those in C; classes that join them with resolvers.
    "yaml": (
        *("yaml.reader", "yaml.scanner", "yaml.parser", "yaml.composer", "yaml.emitter", "yaml.serializer"),
        *(
            "yaml.constructor",
            "yaml.resolver",
            "yaml.representer",
            "yaml.loader",
            "yaml.dumper",
            "yaml.cyaml",
        ),
    ),
    # Files, servers, agents, programs as proxies, rare key exchanges and forms of keys; invoke for ``Match
    # exec`` of ssh_config, which edgectl leaves to ssh; a parser of e-mail for its version.
    "paramiko": (
        *("invoke", "importlib.metadata"),
        *("paramiko.sftp_client", "paramiko.sftp_server", "paramiko.sftp_attr", "paramiko.sftp_handle"),
        *("paramiko.sftp_si", "paramiko.sftp_file", "paramiko.server", "paramiko.agent", "paramiko.proxy"),
        *("paramiko.kex_gex", "paramiko.kex_group14", "paramiko.kex_group16", "paramiko.primes"),
        *("cryptography.hazmat.primitives.serialization.ssh", "nacl.public"),
    ),
    # Mock (with asyncio and ssl) for the MockContext of invoke, and a YAML parser for files of its own.
    "fabric": ("unittest.mock", "invoke.vendor.yaml", "importlib.metadata"),
}
_IMPORTING = threading.RLock()


class _DeferredName:
    """Stands for a function or class; its module is imported when it is called, read or made a base."""

    def __init__(self, module: "_DeferredModule", name: str) -> None:
        self.__module, self.__name = module, name

    def __load(self) -> Any:  # noqa: ANN401
        return getattr(self.__module.load(), self.__name)

    def __call__(self, *args: object, **options: object) -> object:
        return self.__load()(*args, **options)

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.__load(), name)

    def __mro_entries__(self, _bases: tuple[object, ...]) -> tuple[type, ...]:
        return (self.__load(),)

    def __instancecheck__(self, value: object) -> bool:
        return isinstance(value, self.__load())

    def __subclasscheck__(self, kind: type) -> bool:
        return issubclass(kind, self.__load())


class _DeferredModule(ModuleType):
    """Stands for a module; what is imported from it are ``_DeferredName``."""

    def load(self) -> ModuleType:
        """The module itself."""
        _remove_stand_in(self)
        return import_module(self.__name__)

    def __getattr__(self, name: str) -> object:
        if name == "__all__":
            return _read_public_names(self.__name__)
        if name.startswith("__"):
            raise AttributeError(name)
        return _DeferredName(self, name)


def import_deferred(name: str) -> ModuleType:
    """Import the module ``name``; its ``DEFERRED_MODULES`` are imported when they are used.

    Where a module uses one of them while it is imported, that one is imported at once; where it uses it as
    something else than a function or class, all are.
    """
    with _IMPORTING:
        if name in sys.modules:
            return sys.modules[name]
        before = set(sys.modules)
        try:
            with _put_stand_ins(DEFERRED_MODULES.get(name, ())):
                return import_module(name)
        except (AttributeError, ImportError, NameError, TypeError):
            # What was imported with stand-ins before the error is imported again.
            for each in set(sys.modules) - before:
                if each.partition(".")[0] == name.partition(".")[0]:
                    del sys.modules[each]
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
        package, _, name = module.__name__.rpartition(".")
        if package in sys.modules:
            # As an import does; the import of the module itself replaces it.
            vars(sys.modules[package]).setdefault(name, module)


def _read_public_names(module: str) -> list[str]:
    """``__all__`` of a module as its source states it; nothing of it is run."""
    package = import_module(module.rpartition(".")[0])
    spec = PathFinder.find_spec(module, package.__path__)
    text = Path(spec.origin).read_text() if spec and spec.origin else ""
    names, end, _ = text.partition("__all__ = [")[2].partition("]")
    if not end:
        raise AttributeError("__all__")
    return [name.strip(" \n'\"") for name in names.split(",") if name.strip()]


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
