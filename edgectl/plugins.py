# SPDX-License-Identifier: Apache-2.0
"""Plugins of other packages: entry points that are loaded when a file or an option names them (ADR 67)."""

from collections.abc import Callable
from enum import StrEnum
from typing import Any

from edgectl.dataclass import dataclass
from edgectl.errors import PluginError, UsageError
from edgectl.names import format_name_list


class PluginGroup(StrEnum):
    """Groups of entry points, each with the word for one of its plugins."""

    CHECKS = "edgectl.checks"
    TRANSPORTS = "edgectl.transports"
    NOTIFIERS = "edgectl.notifiers"
    TERMS = "edgectl.terms"
    POLICIES = "edgectl.policies"

    @property
    def word(self) -> str:
        """One plugin of the group in a message."""
        return {"POLICIES": "policy"}.get(self.name, self.name.lower().removesuffix("s"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Plugin:
    """A loaded plugin: ``make`` is what its entry point names, ``package`` the distribution it came with."""

    group: PluginGroup
    name: str
    package: str
    make: Callable[..., Any]

    def call(self, *args: object, **named: object) -> Any:  # noqa: ANN401 - each group has its own type
        """Call it.

        Raises:
            EdgectlError: as it raises.
            PluginError: it raised anything else.
        """
        from edgectl.errors import EdgectlError

        try:
            return self.make(*args, **named)
        except EdgectlError:
            raise
        except Exception as error:
            raise self.fail(error) from error

    def fail(self, error: Exception) -> PluginError:
        """The error of this plugin, which raised ``error`` or gave something wrong."""
        return _build_plugin_error(self.group, self.name, self.package, error)


def load_plugin(group: PluginGroup, name: str) -> Plugin:
    """The plugin ``name`` of ``group``.

    Raises:
        UsageError: no installed package has it.
        PluginError: it cannot be imported, or two packages have it.
    """
    found = [point for point in _list_entry_points(group) if point.name == name]
    if not found:
        known = list_plugin_names(group)
        raise UsageError(
            f"unknown {group.word} {name}: no installed package has it",
            hint=f"installed: {format_name_list(known)}"
            if known
            else f"install one with a plugin in {group}",
        )
    packages = sorted({_name_package(point) for point in found})
    if len(packages) > 1:
        raise PluginError(
            f"{group.word} {name} is in two packages: {' and '.join(packages)}", hint="uninstall one of them"
        )
    return _load_entry_point(group, found[0])


def list_plugin_names(group: PluginGroup) -> list[str]:
    """The names of the plugins of ``group``; none of them is imported."""
    return sorted({point.name for point in _list_entry_points(group)})


def load_plugins(group: PluginGroup) -> tuple[Plugin, ...]:
    """All plugins of ``group``, by name.

    Raises:
        PluginError: one cannot be imported.
    """
    points = sorted(_list_entry_points(group), key=lambda point: (point.name, _name_package(point)))
    return tuple(_load_entry_point(group, point) for point in points)


def _list_entry_points(group: PluginGroup) -> list[Any]:
    from importlib.metadata import entry_points  # 15 ms: only for who uses plugins

    return list(entry_points(group=group.value))


def _name_package(point: Any) -> str:  # noqa: ANN401 - of importlib.metadata, which is imported late
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "an unknown package"


def _load_entry_point(group: PluginGroup, point: Any) -> Plugin:  # noqa: ANN401
    package = _name_package(point)
    try:
        make = point.load()
    except Exception as error:
        raise _build_plugin_error(group, point.name, package, error) from error
    if not callable(make):
        raise PluginError(
            f"{group.word} {point.name} of {package}: {point.value} is not callable",
            hint=f"name a function in the group {group} of its package",
        )
    return Plugin(group=group, name=point.name, package=package, make=make)


def _build_plugin_error(group: PluginGroup, name: str, package: str, error: Exception) -> PluginError:
    """The error of a plugin that raised ``error``; it names the plugin and its package."""
    said = " ".join(f"{type(error).__name__}: {error}".split())
    return PluginError(
        f"{group.word} {name} of {package} failed: {said[:300]}",
        hint=f"report it to the authors of {package}",
    )
