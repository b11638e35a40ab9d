# SPDX-License-Identifier: Apache-2.0
"""Value of a YAML file with its position."""

from dataclasses import dataclass, field
from typing import TypeAlias

from edgectl.config.problems import Mark

Scalar: TypeAlias = str | int | float | bool | None


@dataclass(slots=True, eq=False)
class Node:
    """One value. ``text``: a scalar as written; ``keys``: positions of a mapping's keys; ``size``: number of
    values in it.

    Not frozen: there may be 100,000 of them, and creating a frozen one takes three times as long.
    """

    value: "Scalar | dict[str, Node] | list[Node]"
    mark: Mark
    text: str = ""
    keys: dict[str, Mark] = field(default_factory=dict)
    size: int = 1

    def key_mark(self, key: str) -> Mark:
        """Position of ``key``, or of the mapping itself if it is missing."""
        return self.keys.get(key, self.mark)

    def inner(self, key: str) -> "Node":
        """The value under ``key`` of a mapping, or the node itself if missing; for its position."""
        return self.value.get(key, self) if isinstance(self.value, dict) else self


def redact_node(node: Node) -> Node:
    """The same value at the same positions, with all lines hidden."""
    value: Scalar | dict[str, Node] | list[Node] = node.value
    if isinstance(value, dict):
        value = {key: redact_node(inner) for key, inner in value.items()}
    elif isinstance(value, list):
        value = [redact_node(inner) for inner in value]
    keys = {key: mark.redact() for key, mark in node.keys.items()}
    return Node(value, node.mark.redact(), keys=keys, size=node.size)


def value_from_node(node: Node) -> object:
    """The value without positions."""
    if isinstance(node.value, dict):
        return {key: value_from_node(inner) for key, inner in node.value.items()}
    if isinstance(node.value, list):
        return [value_from_node(inner) for inner in node.value]
    return node.value


def describe_node_type(node: Node) -> str:
    """Describe the type of the written value."""
    value = node.value
    if value is None:
        return "empty"
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else "a list"
    if isinstance(value, str):
        return "a string"
    return f"{node.text}, which is {'true or false' if isinstance(value, bool) else 'a number'}"
