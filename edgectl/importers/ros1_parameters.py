# SPDX-License-Identifier: Apache-2.0
"""Parameters that ``param`` and ``rosparam`` of ROS 1 launch files set."""

from edgectl.config.problems import ProblemCode
from edgectl.importers.elements import Element
from edgectl.importers.fault import ImportFaultError
from edgectl.importers.launch_values import (
    RosNode,
    expand_packages,
    has_unknown_package,
    join_names,
    read_referred_file,
)
from edgectl.importers.ros1_attributes import AttributeReader, Ros1Scope
from edgectl.importers.ros1_substitution import substitute_ros1
from edgectl.importers.ros_parameters import flatten_parameters, parse_parameter_value, read_parameter_text


def read_parameter(
    reader: AttributeReader, element: Element, scope: Ros1Scope
) -> tuple[dict[str, object], dict[str, tuple[str, ...]]]:
    """The parameter that an element sets, by its name: its value, or the command that prints it.

    Both are empty if it cannot be had.
    """
    name = reader.graph_name(element, "name", scope)
    given = [key for key in ("value", "textfile", "binfile", "command") if key in element.attributes]
    if len(given) != 1:
        message = f"param {name} needs one of value, textfile and command, and has {len(given)}"
        raise ImportFaultError(element.mark, ProblemCode.MISSING, message, 'add value=".."')
    kind = reader.text(element, "type", scope)
    if given[0] == "value":
        mark = element.attributes["value"].mark
        return {name: parse_parameter_value(reader.text(element, "value", scope), kind, mark)}, {}
    if given[0] == "textfile":
        path = reader.find_file(element, "textfile", scope)
        mark = element.attributes["textfile"].mark
        return {name: read_referred_file(path, reader.workspace, mark).text}, {}
    if given[0] == "command" and kind in ("", "auto", "str", "string"):
        return {}, {name: reader.words(element, "command", scope)}
    reason = f"the output of its command is of type {kind}" if given[0] == "command" else "it is binary"
    hint = f"write it before the command of the task: rosparam set {name} .."
    reader.launch.note(element.mark, f"param {name} is not imported: {reason}", hint)
    return {}, {}


def load_rosparam(reader: AttributeReader, element: Element, scope: Ros1Scope, node: RosNode | None) -> None:
    """Add the parameters of a rosparam element to its node, else to the global ones."""
    command = reader.text(element, "command", scope, "load")
    if command != "load":
        if command not in ("dump", "delete"):
            mark = element.attributes["command"].mark
            raise ImportFaultError(mark, ProblemCode.WORD, f"unknown command {command}", "write load")
        reader.launch.note(element.mark, f"rosparam {command} is not imported")
        return
    prefix = "/".join(
        part for part in (reader.text(element, "ns", scope), reader.text(element, "param", scope)) if part
    )
    if "file" in element.attributes:
        named = reader.text(element, "file", scope)
        if has_unknown_package(named, reader.workspace):
            _load_on_host(reader, element, scope, node, named, prefix)
            return
        path = reader.find_file(element, "file", scope)
        source = read_referred_file(path, reader.workspace, element.attributes["file"].mark)
        text, line = source.text, 1
        file = source
    else:
        text, line, file = element.text, element.text_line, element.mark.source
    if reader.boolean(element, "subst_value", scope):
        text = substitute_ros1(
            text, element.mark, scope.arguments, scope.file, reader.workspace, reader.launch
        )
    values = read_parameter_text(
        text, line, file, reader.launch.problems, element.mark, is_named=bool(prefix)
    )
    flat = flatten_parameters(values, prefix)
    if node is not None:
        node.parameters |= flat
        return
    for name, value in flat.items():
        reader.launch.parameters[join_names(scope.namespace, name)] = value


def _load_on_host(
    reader: AttributeReader, element: Element, scope: Ros1Scope, node: RosNode | None, file: str, prefix: str
) -> None:
    """Let the host read a file of a package that is not on this machine."""
    if node is None or reader.boolean(element, "subst_value", scope):
        expand_packages(file, reader.workspace, element.attributes["file"].mark)
    elif node is not None:
        node.parameter_files = (*node.parameter_files, (file, join_names(node.full_name, prefix)))
