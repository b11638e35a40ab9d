# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch.actions."""

import shlex
from collections.abc import Iterable
from typing import Any

from _edgectl_recorder import (
    Context,
    LaunchError,
    Recorded,
    load_description,
    make_dropped,
    perform,
    perform_boolean,
    visit,
)


class DeclareLaunchArgument(Recorded):
    """An argument of the file."""

    def execute(self, context: Context) -> list[int]:
        """Give it its default, if it was not given.

        Raises:
            LaunchError: it has no value, or none of its choices.
        """
        name = perform(context, self.words[0] if self.words else self.named["name"])
        context.declared.append(name)
        if name not in context.launch_configurations:
            default = self.named.get("default_value", self.words[1] if len(self.words) > 1 else None)
            if default is None:
                raise LaunchError(f"argument {name} has no value", self.place, f"give it: {name}:=VALUE")
            context.launch_configurations[name] = perform(context, default)
        choices = self.named.get("choices")
        if choices and context.launch_configurations[name] not in choices:
            message = f"argument {name} is {context.launch_configurations[name]!r}"
            raise LaunchError(message, self.place, f"its choices are {', '.join(map(str, choices))}")
        return []


class SetLaunchConfiguration(Recorded):
    """A value of an argument."""

    def execute(self, context: Context) -> list[int]:
        """Set it."""
        name, value = (*self.words, *(self.named[key] for key in ("name", "value") if key in self.named))
        context.launch_configurations[perform(context, name)] = perform(context, value)
        return []


class UnsetLaunchConfiguration(Recorded):
    """The end of an argument."""

    def execute(self, context: Context) -> list[int]:
        """Remove it."""
        name = self.words[0] if self.words else self.named["name"]
        context.launch_configurations.pop(perform(context, name), None)
        return []


class GroupAction(Recorded):
    """Actions in a scope of their own."""

    def execute(self, context: Context) -> list[int]:
        """Evaluate them; what they set ends with the group, unless it is not scoped."""
        actions = self.words[0] if self.words else self.named["actions"]
        given = self.named.get("launch_configurations") or {}
        saved = (dict(context.launch_configurations), context.namespace, dict(context.env),
                 list(context.remaps), dict(context.parameters))  # fmt: skip
        for name, value in dict(given).items():
            context.launch_configurations[perform(context, name)] = perform(context, value)
        numbers = visit(context, list(actions))
        if self.named.get("scoped", True):
            (context.launch_configurations, context.namespace, context.env, context.remaps,
             context.parameters) = saved  # fmt: skip
        return numbers


class PushLaunchConfigurations(Recorded):
    """The begin of a scope, which GroupAction replaces."""

    def execute(self, context: Context) -> list[int]:
        """Note it as dropped."""
        context.note(self.place, f"{type(self).__name__} is not imported", "use GroupAction")
        return []


PopLaunchConfigurations = PushLaunchConfigurations


class SetEnvironmentVariable(Recorded):
    """A variable of the environment."""

    def execute(self, context: Context) -> list[int]:
        """Set it."""
        name, value = (*self.words, *(self.named[key] for key in ("name", "value") if key in self.named))
        context.env[perform(context, name)] = perform(context, value)
        return []


class AppendEnvironmentVariable(Recorded):
    """An addition to a variable, whose value on the host is not known."""

    def execute(self, context: Context) -> list[int]:
        """Note it as dropped."""
        context.note(
            self.place, f"{type(self).__name__} is not imported", "write it in prelude: of the inventory"
        )
        return []


UnsetEnvironmentVariable = AppendEnvironmentVariable


class IncludeLaunchDescription(Recorded):
    """Another launch file."""

    def execute(self, context: Context) -> list[int]:
        """Evaluate it: Python here, XML and YAML later."""
        source = self.words[0] if self.words else self.named["launch_description_source"]
        arguments: Iterable[tuple[Any, Any]] = self.named.get("launch_arguments") or []
        for name, value in arguments:
            context.launch_configurations[perform(context, name)] = perform(context, value)
        if isinstance(source, Recorded) and hasattr(type(source), "execute"):
            return visit(context, source)
        path = perform(context, source.location if isinstance(source, Recorded) else source)
        if path.endswith(".py"):
            numbers = visit(context, load_description(context, path, self.place))
            context.files.pop()
            return numbers
        return context.add({
            "kind": "include",
            "file": path,
            "arguments": dict(context.launch_configurations),
            "namespace": context.namespace,
            "env": dict(context.env),
            "remaps": list(context.remaps),
            "parameters": dict(context.parameters),
        }, self.place)  # fmt: skip


class ExecuteProcess(Recorded):
    """A program."""

    def execute(self, context: Context) -> list[int]:
        """Note the process that it would start."""
        words = [perform(context, word) for word in self.named["cmd"]]
        if self.named.get("shell"):
            words = ["bash", "-c", " ".join(words)]
        elif len(words) == 1 and " " in words[0]:
            words = shlex.split(words[0])
        name = self.named.get("name")
        return context.add({
            "kind": "process",
            "words": words,
            "name": perform(context, name) if name is not None else "",
            "namespace": context.namespace,
            **describe_process(self, context),
        }, self.place)  # fmt: skip


ExecuteLocal = ExecuteProcess


def describe_process(action: Recorded, context: Context) -> dict[str, Any]:
    """What nodes and programs have in common."""
    for key in ("respawn_delay", "sigterm_timeout", "sigkill_timeout"):
        if action.named.get(key) is not None:
            context.note(action.place, f"{key} is not imported", "see restart: and stop: of a task")
    respawn, prefix, workdir = (action.named.get(key) for key in ("respawn", "prefix", "cwd"))
    extra = {**(action.named.get("env") or {}), **(action.named.get("additional_env") or {})}
    return {
        "respawn": None if respawn is None else perform_boolean(context, respawn, action.place),
        "prefix": "" if prefix is None else perform(context, prefix),
        "workdir": "" if workdir is None else perform(context, workdir),
        "env": context.env | {perform(context, key): perform(context, value) for key, value in extra.items()},
    }


class OpaqueFunction(Recorded):
    """A function that makes actions."""

    def execute(self, context: Context) -> list[int]:
        """Call it, and evaluate what it returns."""
        function = self.named.get("function", self.words[0] if self.words else None)
        if not callable(function):
            raise LaunchError("OpaqueFunction needs a function", self.place)
        words, named = self.named.get("args") or (), self.named.get("kwargs") or {}
        return visit(context, function(context, *words, **named))


class RegisterEventHandler(Recorded):
    """Actions after an event."""

    def execute(self, context: Context) -> list[int]:
        """Register them."""
        handler = self.words[0] if self.words else self.named.get("event_handler")
        register = getattr(type(handler), "register", None)
        if register is None:
            context.note(self.place, f"{type(handler).__name__} is not imported")
        else:
            register(handler, context)
        return []


class TimerAction(Recorded):
    """Actions after a time."""

    def execute(self, context: Context) -> list[int]:
        """Evaluate them, and note the delay."""
        context.note(self.place, "the delay of TimerAction is not imported", "write needs: in the tasks")
        return visit(context, list(self.named.get("actions") or []))


def __getattr__(name: str) -> type[Recorded]:
    return make_dropped(name)
