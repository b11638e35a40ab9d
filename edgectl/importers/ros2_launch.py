# SPDX-License-Identifier: Apache-2.0
"""Reader of ROS 2 launch files in XML and YAML: what ``ros2 launch`` would start. Nothing is run."""

import posixpath
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from edgectl.config.problems import Mark, ProblemCode, Source
from edgectl.config.yaml_parser import parse_yaml
from edgectl.importers.element_rules import (
    CONDITIONS,
    are_conditions_met,
    build_unknown_element,
    check_attribute_names,
    check_root,
    split_words,
)
from edgectl.importers.elements import Attribute, Element, build_yaml_elements, parse_xml
from edgectl.importers.fault import ImportFaultError, collect_fault
from edgectl.importers.launch_values import (
    MAX_INCLUDE_DEPTH,
    MAX_INCLUDES,
    Launch,
    RosNode,
    Workspace,
    expand_packages,
    join_names,
    read_referred_file,
)
from edgectl.importers.ros2_substitution import read_boolean, substitute_ros2
from edgectl.importers.ros_parameters import parse_yaml_scalar, read_parameter_node
from edgectl.names import format_name_list, suggest_name

_PROCESS = ("cwd", "emulate_tty", "launch-prefix", "output", "output_format", "respawn", "respawn_delay",
            "respawn_max_retries", "shell", "sigkill_timeout", "sigterm_timeout")  # fmt: skip
_NODE = ("name", "namespace", "args", "ros_args", "exec_name", "output", *_PROCESS)
# Element -> attributes that it needs, and others.
ATTRIBUTES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "arg": (("name",), ("default", "description", "value")),
    "append_env": (("name", "value"), ("prepend", "separator")),
    "env": (("name", "value"), ()),
    "executable": (("cmd",), ("name", *_PROCESS)),
    "group": ((), ("scoped", "forwarding")),
    "include": (("file",), ("from",)),
    "let": (("name", "value"), ()),
    "node": (("pkg", "exec"), _NODE),
    "node_container": (("pkg", "exec", "name"), _NODE),
    "lifecycle_node": (("pkg", "exec", "name"), (*_NODE, "autostart")),
    "param": ((), ("name", "value", "from", "type", "sep", "value-sep", "allow_substs")),
    "push_ros_namespace": (("namespace",), ()),
    "remap": (("from", "to"), ()),
    "set_env": (("name", "value"), ()),
    "set_parameter": (("name", "value"), ()),
    "set_remap": (("from", "to"), ()),
    "set_use_sim_time": (("value",), ()),
    "unset_env": (("name",), ()),
}
# Elements without a counterpart in a task.
_DROPPED = ("log", "log_debug", "log_error", "log_info", "log_warning", "load_composable_node",
            "opaque_function", "reset", "set_parameters_from_file", "shutdown")  # fmt: skip


@dataclass(slots=True, kw_only=True)
class Ros2Scope:
    """What applies to the actions that follow; an included file changes the scope of its includer."""

    file: str
    arguments: dict[str, str] = field(default_factory=dict)
    namespace: str = "/"
    env: dict[str, str] = field(default_factory=dict)
    remaps: tuple[tuple[str, str], ...] = ()
    parameters: dict[str, object] = field(default_factory=dict)
    parameter_files: tuple[str, ...] = ()
    trail: tuple[str, ...] = ()

    def copy(self) -> "Ros2Scope":
        """A scope whose changes stay in it."""
        return replace(
            self, arguments=dict(self.arguments), env=dict(self.env), parameters=dict(self.parameters)
        )


def read_ros2_launch(path: str, arguments: Mapping[str, str], workspace: Workspace, launch: Launch) -> None:
    """Add everything that ``ros2 launch PATH ARGUMENTS`` would start; problems are collected."""
    reader = _Ros2Reader(workspace, launch)
    root = reader.load(path)
    if root is None:
        return
    reader.read_file(root, Ros2Scope(file=path, arguments=dict(arguments)))
    for name in sorted(arguments.keys() - reader.declared):
        match = suggest_name(name, reader.declared)
        known = (
            f"its args are {format_name_list(sorted(reader.declared))}" if reader.declared else "it has none"
        )
        launch.problems.add(
            root.mark,
            ProblemCode.UNKNOWN_NAME,
            f"the file declares no arg {name}",
            f"did you mean {match}?" if match else known,
        )


def read_included_launch(scope: Ros2Scope, mark: Mark, workspace: Workspace, launch: Launch) -> None:
    """Add what the file of ``scope`` starts, which a Python file includes at ``mark``.

    Raises:
        ImportFaultError: the file cannot be read.
    """
    reader = _Ros2Reader(workspace, launch)
    root = reader.load(scope.file, mark)
    if root is not None:
        reader.read_file(root, scope)


class _Ros2Reader:
    """A method per element. ``declared``: names of args of all files."""

    def __init__(self, workspace: Workspace, launch: Launch) -> None:
        self.workspace, self.launch = workspace, launch
        self.declared: set[str] = set()
        self.handlers: dict[str, Callable[[Element, Ros2Scope], None]] = {
            "arg": self.read_arg,
            "append_env": self.append_env,
            "executable": self.read_executable,
            "group": self.read_group,
            "include": self.read_include,
            "let": self.read_let,
            "lifecycle_node": self.read_lifecycle_node,
            "node": self.read_node,
            "node_container": self.read_container,
            "push_ros_namespace": self.push_namespace,
            "set_env": self.set_env,
            "set_parameter": self.set_parameter,
            "set_remap": self.set_remap,
            "set_use_sim_time": self.set_sim_time,
            "timer": self.read_timer,
            "unset_env": self.unset_env,
        }

    def load(self, path: str, mark: Mark | None = None) -> Element | None:
        """The root of a file; ``mark`` is the place of its include."""
        if mark is not None:
            source: Source | None = read_referred_file(path, self.workspace, mark)
        else:
            source = self.workspace.read(path, self.launch.problems)
        if source is None:
            return None
        if not path.endswith((".yaml", ".yml")):
            return parse_xml(source, self.launch.problems)
        node = parse_yaml(source, self.launch.problems)
        return build_yaml_elements(node, self.launch.problems) if node is not None else None

    def read_file(self, root: Element, scope: Ros2Scope) -> None:
        if check_root(root, self.launch.problems):
            self.read_children(root, scope)

    def read_children(self, parent: Element, scope: Ros2Scope) -> None:
        for element in parent.children:
            with collect_fault(self.launch.problems):
                tag = element.tag.replace("-", "_")
                if tag in _DROPPED:
                    self.launch.note(element.mark, f"{element.tag} is not imported")
                    continue
                if tag not in self.handlers:
                    raise build_unknown_element(element, (*self.handlers, *_DROPPED))
                self.check_attributes(element, tag)
                if self.is_wanted(element, scope):
                    self.handlers[tag](element, scope)

    def check_attributes(self, element: Element, tag: str) -> None:
        if tag not in ATTRIBUTES:
            return
        needed, others = ATTRIBUTES[tag]
        check_attribute_names(element, (*needed, *others, *CONDITIONS))
        for name in needed:
            if name not in element.attributes:
                message = f"{element.tag} needs {name}"
                raise ImportFaultError(element.mark, ProblemCode.MISSING, message, f"add {name}")

    def text(self, element: Element, name: str, scope: Ros2Scope, default: str = "") -> str:
        """The attribute with its substitutions replaced."""
        attribute = element.attributes.get(name)
        return self.fill(attribute, scope) if attribute is not None else default

    def fill(self, attribute: Attribute, scope: Ros2Scope) -> str:
        return substitute_ros2(
            attribute.text,
            attribute.mark,
            scope.arguments,
            scope.env,
            scope.file,
            self.workspace,
            self.launch,
        )

    def boolean(self, element: Element, name: str, scope: Ros2Scope) -> bool | None:
        if name not in element.attributes:
            return None
        return read_boolean(self.text(element, name, scope), name, element.attributes[name].mark)

    def is_wanted(self, element: Element, scope: Ros2Scope) -> bool:
        return are_conditions_met(element, lambda name: self.boolean(element, name, scope))

    def read_arg(self, element: Element, scope: Ros2Scope) -> None:
        name = self.text(element, "name", scope)
        self.declared.add(name)
        if name not in scope.arguments:
            if "default" not in element.attributes:
                message = f"arg {name} has no value"
                raise ImportFaultError(element.mark, ProblemCode.MISSING, message, f"give it: {name}:=VALUE")
            scope.arguments[name] = self.text(element, "default", scope)
        choices = [self.text(child, "value", scope) for child in element.children if child.tag == "choice"]
        if choices and scope.arguments[name] not in choices:
            message = f"arg {name} is {scope.arguments[name]!r}"
            raise ImportFaultError(
                element.mark, ProblemCode.WORD, message, f"its choices are {', '.join(choices)}"
            )

    def read_let(self, element: Element, scope: Ros2Scope) -> None:
        scope.arguments[self.text(element, "name", scope)] = self.text(element, "value", scope)

    def read_group(self, element: Element, scope: Ros2Scope) -> None:
        scoped = self.boolean(element, "scoped", scope) is not False
        self.read_children(element, scope.copy() if scoped else scope)

    def push_namespace(self, element: Element, scope: Ros2Scope) -> None:
        scope.namespace = join_names(scope.namespace, self.text(element, "namespace", scope))

    def set_env(self, element: Element, scope: Ros2Scope) -> None:
        scope.env[self.text(element, "name", scope)] = self.text(element, "value", scope)

    def unset_env(self, element: Element, scope: Ros2Scope) -> None:
        name = self.text(element, "name", scope)
        if scope.env.pop(name, None) is None:
            self.launch.note(element.mark, f"unset_env {name} is not imported", "write env: in the task")

    def append_env(self, element: Element, scope: Ros2Scope) -> None:
        name, value = self.text(element, "name", scope), self.text(element, "value", scope)
        if name in scope.env:
            separator = self.text(element, "separator", scope, ":")
            before = self.boolean(element, "prepend", scope)
            pair = (value, scope.env[name]) if before else (scope.env[name], value)
            scope.env[name] = separator.join(pair)
        else:
            message = f"append_env {name} is not imported: its value on the host is not known here"
            self.launch.note(element.mark, message, "write it in prelude: of the inventory")

    def set_parameter(self, element: Element, scope: Ros2Scope) -> None:
        scope.parameters[self.text(element, "name", scope)] = self.read_value(element, scope)

    def set_sim_time(self, element: Element, scope: Ros2Scope) -> None:
        scope.parameters["use_sim_time"] = self.read_value(element, scope)

    def set_remap(self, element: Element, scope: Ros2Scope) -> None:
        scope.remaps = (*scope.remaps, self.read_pair(element, scope))

    def read_pair(self, element: Element, scope: Ros2Scope) -> tuple[str, str]:
        return self.text(element, "from", scope), self.text(element, "to", scope)

    def read_timer(self, element: Element, scope: Ros2Scope) -> None:
        self.launch.note(element.mark, "the delay of timer is not imported", "write needs: in the tasks")
        self.read_children(element, scope)

    def read_include(self, element: Element, scope: Ros2Scope) -> None:
        mark = element.attributes["file"].mark
        path = posixpath.normpath(expand_packages(self.text(element, "file", scope), self.workspace, mark))
        self.launch.includes += 1
        if len(scope.trail) >= MAX_INCLUDE_DEPTH or self.launch.includes > MAX_INCLUDES:
            loops = path in scope.trail or path == scope.file
            message = "the file includes itself for ever" if loops else "too many includes"
            raise ImportFaultError(
                mark, ProblemCode.INCLUDE, message, "remove this include, or put an if on it"
            )
        for child in element.children:
            if child.tag not in ("arg", "let"):
                raise build_unknown_element(child, ("arg", "let"))
            if not {"name", "value"} <= child.attributes.keys():
                message = f"{child.tag} of this include needs name and value"
                raise ImportFaultError(child.mark, ProblemCode.MISSING, message, "add both")
            scope.arguments[self.text(child, "name", scope)] = self.text(child, "value", scope)
        if path.endswith(".py"):
            self.launch.note(element.mark, f"{path} is not imported: an included Python file is not run",
                f"import it by itself: edgectl import ros {path}")  # fmt: skip
            return
        root = self.load(path, mark)
        if root is not None:
            before, trail = scope.file, scope.trail
            scope.file, scope.trail = path, (*trail, before)
            self.read_file(root, scope)
            scope.file, scope.trail = before, trail

    def read_node(self, element: Element, scope: Ros2Scope) -> None:
        executable = self.text(element, "exec", scope)
        node = RosNode(
            version=2,
            mark=element.mark,
            package=self.text(element, "pkg", scope),
            executable=executable,
            name=self.text(element, "name", scope),
            namespace=join_names(scope.namespace, self.text(element, "namespace", scope)),
            arguments=self.words(element, "args", scope),
            ros_arguments=self.words(element, "ros_args", scope),
            remaps=scope.remaps,
            parameters=dict(scope.parameters),
            env=dict(scope.env),
            **self.read_process(element, scope, executable),
        )
        for child in element.children:
            with collect_fault(self.launch.problems):
                self.read_node_child(child, scope, node)
        self.launch.add_node(node)

    def read_node_child(self, child: Element, scope: Ros2Scope, node: RosNode) -> None:
        known = ("env", "param", "remap")
        if child.tag not in known:
            if child.tag == "composable_node":
                self.drop_component(child)
                return
            raise build_unknown_element(child, known)
        self.check_attributes(child, child.tag)
        if not self.is_wanted(child, scope):
            return
        if child.tag == "env":
            node.env[self.text(child, "name", scope)] = self.text(child, "value", scope)
        elif child.tag == "remap":
            node.remaps = (*node.remaps, self.read_pair(child, scope))
        else:
            self.read_param(child, scope, node, "")

    def drop_component(self, element: Element) -> None:
        self.launch.note(element.mark, "composable_node is not imported: its container starts empty",
            "load it with ros2 component load, or import with --group file")  # fmt: skip

    def read_param(self, element: Element, scope: Ros2Scope, node: RosNode, prefix: str) -> None:
        if "from" in element.attributes:
            if element.attributes.keys() & {"name", "value"}:
                message = "param has either from, or name and value"
                raise ImportFaultError(
                    element.mark, ProblemCode.CONTRADICTION, message, "remove one of the two"
                )
            node.parameter_files = (*node.parameter_files, (self.text(element, "from", scope), ""))
            return
        name = self.text(element, "name", scope)
        if not name:
            raise ImportFaultError(
                element.mark, ProblemCode.MISSING, "param needs name and value, or from", "add name"
            )
        full = f"{prefix}.{name}" if prefix else name
        inner = [child for child in element.children if child.tag == "param"]
        for child in inner:
            self.check_attributes(child, "param")
            self.read_param(child, scope, node, full)
        if "value" in element.attributes:
            node.parameters[full] = self.read_value(element, scope)
        elif not inner:
            raise ImportFaultError(
                element.mark, ProblemCode.MISSING, f"param {full} has no value", "add value"
            )

    def read_value(self, element: Element, scope: Ros2Scope) -> object:
        """The value with the type that YAML gives it, or that the file states."""
        attribute = element.attributes["value"]
        if attribute.node is not None and not (
            isinstance(attribute.node.value, str) and "$(" in attribute.text
        ):
            value = read_parameter_node(attribute.node)
            return (
                value if isinstance(value, bool | int | float | list | dict) else self.fill(attribute, scope)
            )
        text = self.text(element, "value", scope)
        kind = self.text(element, "type", scope)
        separator = self.text(element, "value-sep", scope) or self.text(element, "sep", scope)
        if separator:
            return [parse_yaml_scalar(part) for part in text.split(separator)]
        return text if kind in ("str", "string") else parse_yaml_scalar(text)

    def read_executable(self, element: Element, scope: Ros2Scope) -> None:
        words = self.words(element, "cmd", scope)
        if not words:
            message = "cmd is empty"
            raise ImportFaultError(
                element.attributes["cmd"].mark, ProblemCode.TEXT, message, "write a command"
            )
        if self.boolean(element, "shell", scope):
            words = ("bash", "-c", self.text(element, "cmd", scope))
        env = dict(scope.env)
        for child in element.children:
            if child.tag != "env":
                raise build_unknown_element(child, ("env",))
            self.check_attributes(child, "env")
            env[self.text(child, "name", scope)] = self.text(child, "value", scope)
        self.launch.add_node(
            RosNode(
                version=2,
                mark=element.mark,
                package="",
                executable=words[0],
                name=self.text(element, "name", scope) or posixpath.basename(words[0]),
                namespace=scope.namespace,
                arguments=words[1:],
                env=env,
                **self.read_process(element, scope, words[0]),
            )
        )

    def read_process(self, element: Element, scope: Ros2Scope, name: str) -> dict[str, Any]:
        for key in ("respawn_delay", "respawn_max_retries", "sigkill_timeout", "sigterm_timeout"):
            if key in element.attributes:
                mark = element.attributes[key].mark
                self.launch.note(mark, f"{key} of {name} is not imported", "see restart: and stop: of a task")
        return {
            "respawn": self.boolean(element, "respawn", scope),
            "prefix": self.text(element, "launch-prefix", scope),
            "workdir": self.text(element, "cwd", scope),
        }

    def read_lifecycle_node(self, element: Element, scope: Ros2Scope) -> None:
        self.launch.note(element.mark, "lifecycle_node starts unconfigured",
            "let a task configure and activate it: ros2 lifecycle set NODE configure")  # fmt: skip
        self.read_node(element, scope)

    def read_container(self, element: Element, scope: Ros2Scope) -> None:
        self.read_node(element, scope)

    def words(self, element: Element, name: str, scope: Ros2Scope) -> tuple[str, ...]:
        return split_words(element, name, self.text(element, name, scope))
