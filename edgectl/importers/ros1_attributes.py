# SPDX-License-Identifier: Apache-2.0
"""Attributes of the elements of ROS 1 launch files: which there are, and their values in a scope."""

import posixpath
import re
from dataclasses import dataclass, field, replace

from edgectl.config.problems import ProblemCode
from edgectl.importers.element_rules import CONDITIONS, are_conditions_met, check_attribute_names, split_words
from edgectl.importers.elements import Attribute, Element
from edgectl.importers.fault import ImportFaultError
from edgectl.importers.launch_values import Launch, Workspace, expand_packages
from edgectl.importers.ros1_substitution import substitute_ros1

# Element -> its attributes, those that must be given first.
ATTRIBUTES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "launch": ((), ("deprecated",)),
    "arg": (("name",), ("value", "default", "doc")),
    "env": (("name", "value"), ()),
    "group": ((), ("ns", "clear_params")),
    "include": (("file",), ("ns", "clear_params", "pass_all_args")),
    "machine": (("name", "address"), ("env-loader", "user", "password", "ssh-port", "timeout", "default",
                                      "ros-root", "ros-package-path")),
    "node": (("pkg", "type", "name"), ("args", "machine", "respawn", "respawn_delay", "required", "ns",
                                       "clear_params", "output", "cwd", "launch-prefix")),
    "param": (("name",), ("value", "type", "textfile", "binfile", "command")),
    "remap": (("from", "to"), ()),
    "rosparam": ((), ("command", "file", "param", "ns", "subst_value")),
    "test": ((), ("pkg", "type", "test-name", "name", "args", "clear_params", "cwd", "launch-prefix", "ns",
                  "retry", "time-limit")),
}  # fmt: skip
_GRAPH_NAME = re.compile(r"[A-Za-z~/][\w/]*")
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}


@dataclass(slots=True, kw_only=True)
class Ros1Scope:
    """What applies to the elements that follow. ``given``: args from outside; ``used``: those declared."""

    file: str
    namespace: str = "/"
    arguments: dict[str, str] = field(default_factory=dict)
    given: dict[str, str] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)
    passed: frozenset[str] = frozenset()
    env: dict[str, str] = field(default_factory=dict)
    remaps: tuple[tuple[str, str], ...] = ()
    local: dict[str, object] = field(default_factory=dict)
    trail: tuple[str, ...] = ()

    def copy(self) -> "Ros1Scope":
        """A scope whose changes stay in it; declared args are noted in both."""
        return replace(self, arguments=dict(self.arguments), env=dict(self.env), local=dict(self.local))


class AttributeReader:
    """Reads attributes, with their substitutions replaced, and checks them."""

    def __init__(self, workspace: Workspace, launch: Launch) -> None:
        self.workspace, self.launch = workspace, launch

    def check_attributes(self, element: Element) -> None:
        """Check that the element has the attributes that it needs, and no others. Raises ImportFaultError."""
        needed, others = ATTRIBUTES[element.tag]
        check_attribute_names(element, (*needed, *others, *CONDITIONS))
        for name in needed:
            if not element.attributes.get(name, Attribute(text="", mark=element.mark)).text.strip():
                message = f"{element.tag} needs {name}"
                empty = name == "value" and name in element.attributes
                if not empty:
                    raise ImportFaultError(element.mark, ProblemCode.MISSING, message, f'add {name}=".."')

    def text(self, element: Element, name: str, scope: Ros1Scope, default: str = "") -> str:
        """The attribute with its substitutions replaced."""
        attribute = element.attributes.get(name)
        if attribute is None:
            return default
        return substitute_ros1(
            attribute.text, attribute.mark, scope.arguments, scope.file, self.workspace, self.launch
        )

    def boolean(self, element: Element, name: str, scope: Ros1Scope) -> bool | None:
        """The attribute as roslaunch reads a truth value; None where it is not given."""
        if name not in element.attributes:
            return None
        value = self.text(element, name, scope).strip().lower()
        if value not in _BOOLEANS:
            mark = element.attributes[name].mark
            message = f"{name} must be true or false, not {value!r}"
            raise ImportFaultError(mark, ProblemCode.WORD, message, "write true, false, 1 or 0")
        return _BOOLEANS[value]

    def is_wanted(self, element: Element, scope: Ros1Scope) -> bool:
        """Whether ``if`` and ``unless`` of the element hold."""
        return are_conditions_met(element, lambda name: self.boolean(element, name, scope))

    def graph_name(self, element: Element, name: str, scope: Ros1Scope) -> str:
        """The attribute as a name of the ROS graph. Raises ImportFaultError."""
        value = self.text(element, name, scope)
        if value and not _GRAPH_NAME.fullmatch(value):
            mark = element.attributes[name].mark
            message = f"{value!r} is no name of the ROS graph"
            raise ImportFaultError(mark, ProblemCode.NAME, message, "use letters, digits, _ and /")
        return value

    def words(self, element: Element, name: str, scope: Ros1Scope) -> tuple[str, ...]:
        """The attribute as the words of a command line."""
        return split_words(element, name, self.text(element, name, scope))

    def find_file(self, element: Element, name: str, scope: Ros1Scope) -> str:
        """The path of a file that an attribute names, on this machine."""
        mark = element.attributes[name].mark
        path = expand_packages(self.text(element, name, scope), self.workspace, mark)
        return posixpath.normpath(path)
