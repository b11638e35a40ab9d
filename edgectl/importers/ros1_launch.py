# SPDX-License-Identifier: Apache-2.0
"""Reader of ROS 1 launch files (``.launch``): what roslaunch would start. Nothing is run."""

import posixpath
from collections.abc import Callable, Mapping
from dataclasses import replace

from edgectl.config.problems import Mark, ProblemCode
from edgectl.importers.element_rules import (
    build_unknown_element,
    check_root,
)
from edgectl.importers.elements import Element, parse_xml
from edgectl.importers.fault import ImportFaultError, collect_fault
from edgectl.importers.launch_values import (
    MAX_INCLUDE_DEPTH,
    MAX_INCLUDES,
    Launch,
    Machine,
    RosNode,
    Workspace,
    join_names,
    read_referred_file,
)
from edgectl.importers.ros1_attributes import AttributeReader, Ros1Scope
from edgectl.importers.ros1_parameters import load_rosparam, read_parameter
from edgectl.names import format_name_list, suggest_name

_CHILDREN_OF_NODE = ("env", "remap", "param", "rosparam")


def read_ros1_launch(path: str, arguments: Mapping[str, str], workspace: Workspace, launch: Launch) -> None:
    """Add everything that ``roslaunch PATH ARGUMENTS`` would start to ``launch``; problems are collected."""
    reader = _Reader(workspace, launch)
    scope = Ros1Scope(file=path, given=dict(arguments))
    root = reader.load(path)
    if root is None:
        return
    reader.read_file(root, scope)
    for name in sorted(arguments.keys() - scope.used):
        match = suggest_name(name, scope.used)
        hint = f"did you mean {match}?" if match else f"its args are {format_name_list(sorted(scope.used))}"
        launch.problems.add(root.mark, ProblemCode.UNKNOWN_NAME, f"the file declares no arg {name}", hint)


class _Reader(AttributeReader):
    """A method per element."""

    def __init__(self, workspace: Workspace, launch: Launch) -> None:
        super().__init__(workspace, launch)
        self.default_machine = ""

    def load(self, path: str) -> Element | None:
        source = self.workspace.read(path, self.launch.problems)
        return parse_xml(source, self.launch.problems) if source is not None else None

    def read_file(self, root: Element, scope: Ros1Scope) -> None:
        if not check_root(root, self.launch.problems):
            return
        with collect_fault(self.launch.problems):
            self.check_attributes(root)
        if "deprecated" in root.attributes:
            self.launch.note(root.mark, f"the file is deprecated: {root.attributes['deprecated'].text}")
        self.read_children(root, scope)

    def read_children(self, parent: Element, scope: Ros1Scope) -> None:
        handlers: dict[str, Callable[[Element, Ros1Scope], None]] = {
            "arg": self.read_arg,
            "env": self.read_env,
            "group": self.read_group,
            "include": self.read_include,
            "machine": self.read_machine,
            "node": self.read_node,
            "param": self.read_param,
            "remap": self.read_remap,
            "rosparam": self.read_rosparam,
            "test": self.drop_test,
        }
        for element in parent.children:
            with collect_fault(self.launch.problems):
                if element.tag not in handlers:
                    raise build_unknown_element(element, handlers)
                self.check_attributes(element)
                if self.is_wanted(element, scope):
                    handlers[element.tag](element, scope)

    def read_arg(self, element: Element, scope: Ros1Scope) -> None:
        name = self.text(element, "name", scope)
        if "value" in element.attributes and "default" in element.attributes:
            message = f"arg {name} has both value and default"
            raise ImportFaultError(element.mark, ProblemCode.CONTRADICTION, message, "keep one of the two")
        if name in scope.arguments and name not in scope.passed:
            message = f"arg {name} is declared twice"
            raise ImportFaultError(element.mark, ProblemCode.TAKEN, message, "remove one of the two")
        scope.used.add(name)
        if "value" in element.attributes:
            if name in scope.given and name not in scope.passed:
                message = f"arg {name} has a fixed value and is given, too"
                hint = "write default= instead of value=, or do not give it"
                raise ImportFaultError(element.mark, ProblemCode.CONTRADICTION, message, hint)
            scope.arguments[name] = self.text(element, "value", scope)
        elif name in scope.given:
            scope.arguments[name] = scope.given[name]
        elif "default" in element.attributes:
            scope.arguments[name] = self.text(element, "default", scope)
        else:
            message = f"arg {name} has no value"
            raise ImportFaultError(element.mark, ProblemCode.MISSING, message, f"give it: {name}:=VALUE")
        scope.passed -= {name}

    def read_env(self, element: Element, scope: Ros1Scope) -> None:
        scope.env[self.text(element, "name", scope)] = self.text(element, "value", scope)

    def read_remap(self, element: Element, scope: Ros1Scope) -> None:
        pair = (self.graph_name(element, "from", scope), self.graph_name(element, "to", scope))
        scope.remaps = (*(each for each in scope.remaps if each[0] != pair[0]), pair)

    def note_clear_params(self, element: Element, scope: Ros1Scope) -> None:
        if self.boolean(element, "clear_params", scope):
            mark = element.attributes["clear_params"].mark
            self.launch.note(mark, "clear_params is not imported: parameters of earlier runs stay")

    def read_group(self, element: Element, scope: Ros1Scope) -> None:
        self.note_clear_params(element, scope)
        inner = scope.copy()
        inner.namespace = join_names(scope.namespace, self.graph_name(element, "ns", scope))
        self.read_children(element, inner)

    def read_include(self, element: Element, scope: Ros1Scope) -> None:
        self.note_clear_params(element, scope)
        path = self.find_file(element, "file", scope)
        mark = element.attributes["file"].mark
        self.launch.includes += 1
        if len(scope.trail) >= MAX_INCLUDE_DEPTH or self.launch.includes > MAX_INCLUDES:
            loops = path in scope.trail or path == scope.file
            message = "the file includes itself for ever" if loops else "too many includes"
            raise ImportFaultError(
                mark, ProblemCode.INCLUDE, message, "remove this include, or put an if on it"
            )
        inner = Ros1Scope(
            file=path,
            namespace=join_names(scope.namespace, self.graph_name(element, "ns", scope)),
            env=dict(scope.env),
            remaps=scope.remaps,
            local=dict(scope.local),
            trail=(*scope.trail, scope.file),
        )
        passes_all = self.boolean(element, "pass_all_args", scope)
        if passes_all:
            inner.given |= scope.arguments
            inner.passed = frozenset(scope.arguments)
        stated = self.read_include_args(element, scope, inner)
        root = parse_xml(read_referred_file(path, self.workspace, mark), self.launch.problems)
        if root is None:
            return
        self.read_file(root, inner)
        for name, place in stated.items():
            if name not in inner.used:
                match = suggest_name(name, inner.used)
                message = f"{posixpath.basename(path)} declares no arg {name}"
                hint = f"did you mean {match}?" if match else "remove this arg"
                self.launch.problems.add(place, ProblemCode.UNKNOWN_NAME, message, hint)

    def read_include_args(self, element: Element, scope: Ros1Scope, inner: Ros1Scope) -> dict[str, Mark]:
        """Give the args of an include to ``inner``; the place of each."""
        stated = {}
        for child in element.children:
            if child.tag not in ("arg", "env"):
                raise build_unknown_element(child, ("arg", "env"))
            self.check_attributes(child)
            if not self.is_wanted(child, scope):
                continue
            if child.tag == "env":
                self.read_env(child, inner)
                continue
            name = self.text(child, "name", scope)
            if name in stated:
                message = f"arg {name} is given twice"
                raise ImportFaultError(child.mark, ProblemCode.TAKEN, message, "remove one of the two")
            if not child.attributes.keys() & {"value", "default"}:
                message = f"arg {name} of this include has no value"
                raise ImportFaultError(child.mark, ProblemCode.MISSING, message, 'add value=".."')
            key = "value" if "value" in child.attributes else "default"
            stated[name] = child.mark
            inner.given[name] = self.text(child, key, scope)
            inner.passed -= {name}
        return stated

    def read_machine(self, element: Element, scope: Ros1Scope) -> None:
        name, address = self.text(element, "name", scope), self.text(element, "address", scope)
        port = self.text(element, "ssh-port", scope, "0")
        if not port.isdecimal() or int(port) > 65535:
            message = f"{port!r} is no port"
            raise ImportFaultError(
                element.attributes["ssh-port"].mark, ProblemCode.QUANTITY, message, "write a number"
            )
        default = self.text(element, "default", scope, "false").lower()
        machine = Machine(
            name=name,
            address=address,
            user=self.text(element, "user", scope),
            port=int(port),
            default=default == "true",
            mark=element.mark,
        )
        known = self.launch.machines.get(name)
        if known is not None and replace(known, mark=machine.mark) != machine:
            message = f"machine {name} is defined differently on line {known.mark.line}"
            raise ImportFaultError(element.mark, ProblemCode.TAKEN, message, "rename one of the two")
        self.launch.machines[name] = machine
        if machine.default:
            self.default_machine = name
        for key, hint in (
            ("password", "use keys, or password_command: in the inventory"),
            ("env-loader", "write ros: {setup: [/opt/ros/noetic/setup.bash]} in the inventory"),
            ("timeout", ""),
            ("ros-root", ""),
            ("ros-package-path", ""),
        ):
            if key in element.attributes:
                self.launch.note(
                    element.attributes[key].mark, f"{key} of machine {name} is not imported", hint
                )
        for child in element.children:
            self.launch.note(
                child.mark, f"{child.tag} of machine {name} is not imported", "write env: in the inventory"
            )

    def read_node(self, element: Element, scope: Ros1Scope) -> None:
        inner = scope.copy()
        name = self.graph_name(element, "name", scope)
        if "/" in name:
            message = f"the name of a node has no /: {name}"
            raise ImportFaultError(
                element.attributes["name"].mark, ProblemCode.NAME, message, "put the rest into ns"
            )
        namespace = join_names(scope.namespace, self.graph_name(element, "ns", scope))
        node = RosNode(
            version=1,
            mark=element.mark,
            package=self.text(element, "pkg", scope),
            executable=self.text(element, "type", scope),
            name=name,
            namespace=namespace,
            arguments=self.words(element, "args", scope),
            machine=self.find_machine(element, scope),
            respawn=self.boolean(element, "respawn", scope),
            prefix=self.text(element, "launch-prefix", scope),
            parameters=dict(scope.local.items()),
        )
        self.check_twice(node)
        self.read_node_children(element, inner, node)
        node.env, node.remaps = inner.env, inner.remaps
        self.note_node_attributes(element, scope, name)
        self.launch.add_node(node)

    def check_twice(self, node: RosNode) -> None:
        for other in self.launch.nodes:
            if other.version == 1 and other.full_name == node.full_name:
                place = f"{other.mark.source.file}:{other.mark.line}"
                message = f"the node {node.full_name} is defined twice, first at {place}"
                raise ImportFaultError(node.mark, ProblemCode.TAKEN, message, "rename one of the two")

    def find_machine(self, element: Element, scope: Ros1Scope) -> str:
        name = self.text(element, "machine", scope)
        if name and name not in self.launch.machines:
            match = suggest_name(name, self.launch.machines)
            hint = (
                f"did you mean {match}?"
                if match
                else f'define it before: <machine name="{name}" address=".."/>'
            )
            mark = element.attributes["machine"].mark
            raise ImportFaultError(mark, ProblemCode.UNKNOWN_NAME, f"unknown machine {name}", hint)
        return name

    def read_node_children(self, element: Element, inner: Ros1Scope, node: RosNode) -> None:
        for child in element.children:
            if child.tag not in _CHILDREN_OF_NODE:
                raise build_unknown_element(child, _CHILDREN_OF_NODE)
            self.check_attributes(child)
            if not self.is_wanted(child, inner):
                continue
            if child.tag == "env":
                self.read_env(child, inner)
            elif child.tag == "remap":
                self.read_remap(child, inner)
            elif child.tag == "param":
                values, computed = read_parameter(self, child, inner)
                node.parameters |= {name.removeprefix("~"): value for name, value in values.items()}
                node.computed |= {name.removeprefix("~"): words for name, words in computed.items()}
            else:
                load_rosparam(self, child, inner, node)

    def note_node_attributes(self, element: Element, scope: Ros1Scope, name: str) -> None:
        self.note_clear_params(element, scope)
        if self.boolean(element, "required", scope):
            mark = element.attributes["required"].mark
            self.launch.note(mark, f"required of node {name} is not imported: if it ends, the others run on")
        delay = element.attributes.get("respawn_delay")
        if delay is not None:
            self.launch.note(
                delay.mark, f"respawn_delay of node {name} is not imported: restarts back off by themselves"
            )
        if self.text(element, "cwd", scope).lower() == "node":
            self.launch.note(
                element.attributes["cwd"].mark,
                f"cwd of node {name} is not imported",
                "write workdir: in the task",
            )

    def read_param(self, element: Element, scope: Ros1Scope) -> None:
        values, computed = read_parameter(self, element, scope)
        for name, value in values.items():
            if name.startswith("~"):
                scope.local[name[1:]] = value
            else:
                self.launch.parameters[join_names(scope.namespace, name)] = value
        for name, words in computed.items():
            if name.startswith("~"):
                self.launch.note(element.mark, f"param {name} is not imported", "put it into its nodes")
            else:
                self.launch.computed[join_names(scope.namespace, name)] = words

    def read_rosparam(self, element: Element, scope: Ros1Scope) -> None:
        load_rosparam(self, element, scope, None)

    def drop_test(self, element: Element, _scope: Ros1Scope) -> None:
        self.launch.note(element.mark, "test is not imported")
