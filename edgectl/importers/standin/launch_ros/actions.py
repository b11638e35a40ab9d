# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch_ros.actions."""

from collections.abc import Mapping
from typing import Any

from _edgectl_recorder import (
    Context,
    LaunchError,
    Recorded,
    join_namespace,
    make_dropped,
    perform,
    perform_value,
)
from launch.actions import describe_process


class Node(Recorded):
    """A node."""

    def execute(self, context: Context) -> list[int]:
        """Note the process that it would start.

        Raises:
            LaunchError: it has no package or executable.
        """
        texts = {key: self.text(context, key) for key in ("package", "executable", "name", "namespace")}
        for key in ("package", "executable"):
            if not texts[key]:
                raise LaunchError(f"{type(self).__name__} needs {key}", self.place, f"add {key}=")
        parameters, files = self.read_parameters(context)
        arguments = [perform(context, word) for word in self.named.get("arguments") or []]
        ros = [perform(context, word) for word in self.named.get("ros_arguments") or []]
        return context.add({
            "kind": "node",
            "package": texts["package"],
            "executable": texts["executable"],
            "name": texts["name"],
            "namespace": join_namespace(context.namespace, texts["namespace"]),
            "arguments": arguments,
            "ros_arguments": ros,
            "remaps": [*context.remaps, *self.read_remaps(context)],
            "parameters": {**context.parameters, **parameters},
            "parameter_files": files,
            **describe_process(self, context),
        }, self.place)  # fmt: skip

    def text(self, context: Context, key: str) -> str:
        """A field, empty where it is not given."""
        value = self.named.get(key)
        return "" if value is None else perform(context, value)

    def read_remaps(self, context: Context) -> list[list[str]]:
        """Pairs of a name and its replacement."""
        return [[perform(context, name) for name in pair] for pair in self.named.get("remappings") or []]

    def read_parameters(self, context: Context) -> tuple[dict[str, Any], list[str]]:
        """The values, and the files of values."""
        values: dict[str, Any] = {}
        files = []
        for each in self.named.get("parameters") or []:
            if isinstance(each, Mapping):
                values |= {
                    name: perform_value(context, value) for name, value in flatten(context, each).items()
                }
            elif isinstance(each, Parameter):
                name, value = (*each.words, *each.named.values())[:2]
                values[perform(context, name)] = perform_value(context, value)
            else:
                files.append(perform(context, each))
        return values, files


class Parameter(Recorded):
    """One parameter."""


def flatten(context: Context, values: Mapping[Any, Any], prefix: str = "") -> dict[str, Any]:
    """Nested parameters by their full names."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = prefix + perform(context, key)
        flat |= flatten(context, value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return flat


class LifecycleNode(Node):
    """A node with states."""

    def execute(self, context: Context) -> list[int]:
        """Note the process, and that nothing activates it."""
        context.note(
            self.place,
            "LifecycleNode starts unconfigured",
            "let a task activate it: ros2 lifecycle set NODE configure",
        )
        return super().execute(context)


class ComposableNodeContainer(Node):
    """A container of components."""

    def execute(self, context: Context) -> list[int]:
        """Note the container, and each component as dropped."""
        for each in self.named.get("composable_node_descriptions") or []:
            context.note(each.place, "ComposableNode is not imported: its container starts empty",
                "load it with ros2 component load, or import with --group file")  # fmt: skip
        return super().execute(context)


class PushRosNamespace(Recorded):
    """A namespace for what follows."""

    def execute(self, context: Context) -> list[int]:
        """Set it."""
        namespace = self.words[0] if self.words else self.named["namespace"]
        context.namespace = join_namespace(context.namespace, perform(context, namespace))
        return []


PushROSNamespace = PushRosNamespace


class SetParameter(Recorded):
    """A parameter of all nodes that follow."""

    def execute(self, context: Context) -> list[int]:
        """Set it."""
        name = self.words[0] if self.words else self.named["name"]
        value = self.words[1] if len(self.words) > 1 else self.named["value"]
        context.parameters[perform(context, name)] = perform_value(context, value)
        return []


class SetUseSimTime(Recorded):
    """The clock of all nodes that follow."""

    def execute(self, context: Context) -> list[int]:
        """Set it."""
        context.parameters["use_sim_time"] = perform_value(
            context, self.words[0] if self.words else self.named["value"]
        )
        return []


class SetRemap(Recorded):
    """A remapping of all nodes that follow."""

    def execute(self, context: Context) -> list[int]:
        """Set it."""
        source, target = (*self.words, *(self.named[key] for key in ("src", "dst") if key in self.named))
        context.remaps.append([perform(context, source), perform(context, target)])
        return []


def __getattr__(name: str) -> type[Recorded]:
    return make_dropped(name)
