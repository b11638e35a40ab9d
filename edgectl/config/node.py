"""A value of a YAML file together with its place."""

from dataclasses import dataclass, field
from typing import TypeAlias

from edgectl.config.problems import Mark

Scalar: TypeAlias = str | int | float | bool | None


@dataclass(slots=True, eq=False)
class Node:
    """One value. ``text`` is a scalar as written; ``keys`` are the places of a mapping's keys; ``size`` counts the values in it.

    Not frozen: there may be 100,000 of them, and a frozen one takes three times as long to make.
    """

    value: "Scalar | dict[str, Node] | list[Node]"
    mark: Mark
    text: str = ""
    keys: dict[str, Mark] = field(default_factory=dict)
    size: int = 1

    def key_mark(self, key: str) -> Mark:
        """Where ``key`` stands, or the mapping itself where it does not."""
        return self.keys.get(key, self.mark)

    def inner(self, key: str) -> "Node":
        """The value under ``key`` of a mapping, or the node itself where there is none; for its place."""
        return self.value.get(key, self) if isinstance(self.value, dict) else self


def redact_node(node: Node) -> Node:
    """The same value at the same places, of which no line is ever shown."""
    value: Scalar | dict[str, Node] | list[Node] = node.value
    if isinstance(value, dict):
        value = {key: redact_node(inner) for key, inner in value.items()}
    elif isinstance(value, list):
        value = [redact_node(inner) for inner in value]
    keys = {key: mark.redact() for key, mark in node.keys.items()}
    return Node(value, node.mark.redact(), keys=keys, size=node.size)


def value_from_node(node: Node) -> object:
    """The value without its places."""
    if isinstance(node.value, dict):
        return {key: value_from_node(inner) for key, inner in node.value.items()}
    if isinstance(node.value, list):
        return [value_from_node(inner) for inner in node.value]
    return node.value


def describe_node_type(node: Node) -> str:
    """What was written, in words."""
    value = node.value
    if value is None:
        return "empty"
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else "a list"
    if isinstance(value, str):
        return "a string"
    return f"{node.text}, which is {'true or false' if isinstance(value, bool) else 'a number'}"
