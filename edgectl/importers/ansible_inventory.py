# SPDX-License-Identifier: Apache-2.0
"""Hosts of an Ansible inventory in INI or YAML; plugins, scripts and templates are not evaluated."""

import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.config.yaml_parser import parse_yaml
from edgectl.importers.fault import ImportFaultError, collect_fault
from edgectl.importers.host_lists import ImportedHost
from edgectl.importers.launch_values import Launch

MAX_HOSTS = 10_000
MAX_DEPTH = 50
_SECTION = re.compile(r"\[([^\[\]:]+)(?::([a-z]+))?\]\s*(?:[#;].*)?")
_RANGE = re.compile(r"\[([0-9]+|[a-z]):([0-9]+|[a-z])(?::([0-9]+))?\]")
_JUMP = re.compile(r"(?:-J\s*|-o\s*['\"]?ProxyJump[= ])([^\s'\"]+)")
# Variable of Ansible -> field; the first one of a field that is set counts.
_FIELDS = {
    "ansible_host": "address",
    "ansible_ssh_host": "address",
    "ansible_user": "user",
    "ansible_ssh_user": "user",
    "ansible_port": "port",
    "ansible_ssh_port": "port",
    "ansible_ssh_private_key_file": "identity_file",
    "ansible_private_key_file": "identity_file",
}
_PASSWORDS = ("ansible_password", "ansible_ssh_pass", "ansible_become_pass", "ansible_become_password")
_BUILT_IN_GROUPS = ("all", "ungrouped")


@dataclass(frozen=True, slots=True)
class Variable:
    """A value with its place."""

    text: str
    mark: Mark


@dataclass(slots=True)
class Group:
    """A group: its own hosts, children and variables, in the order of the file."""

    hosts: dict[str, None] = field(default_factory=dict)
    children: dict[str, Mark] = field(default_factory=dict)
    variables: dict[str, Variable] = field(default_factory=dict)


@dataclass(slots=True)
class AnsibleInventory:
    """Groups by name, and the variables of each host."""

    groups: dict[str, Group] = field(default_factory=lambda: {"all": Group()})
    hosts: dict[str, dict[str, Variable]] = field(default_factory=dict)

    def group(self, name: str) -> Group:
        """The group of this name, new if there is none."""
        return self.groups.setdefault(name, Group())

    def add_host(self, name: str, group: str, mark: Mark) -> dict[str, Variable]:
        """Add a host to a group; its variables."""
        if len(self.hosts) >= MAX_HOSTS:
            raise ImportFaultError(
                mark, ProblemCode.TOO_MANY, f"more than {MAX_HOSTS:,} hosts", "split the file"
            )
        self.group(group).hosts[name] = None
        return self.hosts.setdefault(name, {})


def read_ansible_hosts(source: Source, problems: Problems, notes: Launch) -> list[ImportedHost]:
    """The hosts in the order of the file, with their groups; problems are collected."""
    inventory = AnsibleInventory()
    if source.file.endswith((".yaml", ".yml", ".json")):
        node = parse_yaml(source, problems)
        if node is not None:
            _read_yaml(node, inventory, problems)
    else:
        _read_ini(source, inventory, problems)
    hosts = []
    for name in inventory.hosts:
        with collect_fault(problems):
            hosts.append(_build_host(name, inventory, notes))
    if not hosts and not problems.errors:
        problems.add(
            Mark(source, 1, 1), ProblemCode.EMPTY, "the file names no host", "name an inventory of Ansible"
        )
    return hosts


def _read_ini(source: Source, inventory: AnsibleInventory, problems: Problems) -> None:
    group, kind = "ungrouped", ""
    for number, line in enumerate(source.lines, 1):
        text = line.strip()
        if not text or text[0] in "#;":
            continue
        mark = Mark(source, number, len(line) - len(line.lstrip()) + 1, len(text))
        with collect_fault(problems):
            if text[0] == "[" and _is_section(text):
                group, kind = _read_section(text, mark)
                inventory.group(group)
            elif kind == "children":
                name = text.split()[0]
                inventory.group(group).children[name] = mark
                inventory.group(name)
            elif kind == "vars":
                inventory.group(group).variables.update([_read_variable(text, mark)])
            else:
                _read_host_line(text, mark, group, inventory)


def _is_section(text: str) -> bool:
    """Whether a line that begins with a bracket is a section, and not a host such as ``[a:c]-edge``."""
    return _RANGE.match(text) is None


def _read_section(text: str, mark: Mark) -> tuple[str, str]:
    found = _SECTION.fullmatch(text)
    if found is None:
        raise ImportFaultError(
            mark, ProblemCode.SYNTAX, "this is no section", "write [GROUP], [GROUP:vars] or [GROUP:children]"
        )
    if (found[2] or "") not in ("", "children", "vars"):
        message = f"unknown kind of section :{found[2]}"
        raise ImportFaultError(mark, ProblemCode.WORD, message, "write :children or :vars, or remove it")
    return found[1].strip(), found[2] or ""


def _read_variable(text: str, mark: Mark) -> tuple[str, Variable]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise ImportFaultError(
            mark, ProblemCode.SYNTAX, "a variable is missing its value", "write NAME=VALUE"
        )
    value = value.strip()
    if len(value) > 1 and value[0] == value[-1] and value[0] in "'\"":
        value = value[1:-1]
    return name.strip(), Variable(value, mark)


def _read_host_line(text: str, mark: Mark, group: str, inventory: AnsibleInventory) -> None:
    try:
        pattern, *words = shlex.split(text, comments=True)
    except ValueError as error:
        raise ImportFaultError(mark, ProblemCode.SYNTAX, "a quote is not closed", "close it") from error
    variables = dict(_read_variable(word, mark) for word in words)
    for name in _expand_ranges(pattern, mark):
        host, _, port = name.rpartition(":") if name.count(":") == 1 else (name, "", "")
        stated = inventory.add_host(host or name, group, mark)
        if port:
            stated["ansible_port"] = Variable(port, mark)
        stated.update(variables)


def _expand_ranges(pattern: str, mark: Mark) -> Iterator[str]:
    """The names of ``edge[01:03]`` and ``edge-[a:c]``."""
    found = _RANGE.search(pattern)
    if found is None:
        if set(pattern) & set("[]{}"):
            raise ImportFaultError(
                mark, ProblemCode.SYNTAX, f"{pattern} is neither a host nor a range", "write edge[01:03]"
            )
        yield pattern
        return
    first, last, step = found[1], found[2], int(found[3] or 1)
    if first.isdecimal() != last.isdecimal() or step < 1:
        raise ImportFaultError(
            mark, ProblemCode.SYNTAX, f"{found[0]} is no range", "write edge[01:03] or edge-[a:c]"
        )
    if first.isdecimal():
        if len(first) > 9 or len(last) > 9 or int(last) - int(first) >= MAX_HOSTS:
            raise ImportFaultError(mark, ProblemCode.TOO_MANY, f"{found[0]} is too large a range", "split it")
        width = len(first) if first.startswith("0") else 0
        middle = [str(number).zfill(width) for number in range(int(first), int(last) + 1, step)]
    else:
        middle = [chr(code) for code in range(ord(first), ord(last) + 1, step)]
    for part in middle:
        yield from _expand_ranges(pattern[: found.start()] + part + pattern[found.end() :], mark)


def _read_yaml(root: Node, inventory: AnsibleInventory, problems: Problems) -> None:
    if not isinstance(root.value, dict):
        problems.add(root.mark, ProblemCode.TYPE, "must be a mapping of groups", "begin with all:")
        return
    for name, node in root.value.items():
        with collect_fault(problems):
            _read_yaml_group(name, node, inventory, 1)


def _read_yaml_group(name: str, node: Node, inventory: AnsibleInventory, depth: int) -> None:
    group = inventory.group(name)
    for key, value in _get_mapping(node, f"group {name}").items():
        entries = _get_mapping(value, f"{key} of {name}")
        if key == "hosts":
            for pattern, inner in entries.items():
                variables = _read_yaml_variables(inner, f"host {pattern}")
                for host in _expand_ranges(pattern, value.key_mark(pattern)):
                    inventory.add_host(host, name, value.key_mark(pattern)).update(variables)
        elif key == "vars":
            group.variables |= _read_yaml_variables(value, f"vars of {name}")
        elif key == "children":
            for child, inner in entries.items():
                group.children[child] = value.key_mark(child)
                _read_yaml_group(child, inner, inventory, depth + 1)
        else:
            mark = node.key_mark(key)
            raise ImportFaultError(
                mark,
                ProblemCode.UNKNOWN_KEY,
                f"unknown key {key} of group {name}",
                "known are hosts, children and vars",
            )


def _get_mapping(node: Node, what: str) -> Mapping[str, Node]:
    if node.value is None:
        return {}
    if not isinstance(node.value, dict):
        raise ImportFaultError(
            node.mark, ProblemCode.TYPE, f"{what} must be a mapping", "end each name with a colon"
        )
    return node.value


def _read_yaml_variables(node: Node, what: str) -> dict[str, Variable]:
    return {key: Variable(value.text, value.mark) for key, value in _get_mapping(node, what).items()}


def _list_parents(inventory: AnsibleInventory, name: str) -> list[str]:
    """The groups of a host, the outermost first: later ones override."""
    direct = [group for group, each in inventory.groups.items() if name in each.hosts]
    levels: dict[str, int] = {}

    def climb(group: str, level: int, trail: tuple[str, ...]) -> None:
        if group in trail:
            mark = inventory.groups[group].children[trail[-1]]
            raise ImportFaultError(
                mark, ProblemCode.CYCLE, f"the group {group} contains itself", "remove one of these children"
            )
        if levels.get(group, -1) >= level or level > MAX_DEPTH:
            return
        levels[group] = level
        for parent, each in inventory.groups.items():
            if group in each.children:
                climb(parent, level + 1, (*trail, group))

    for group in direct:
        climb(group, 0, ())
    levels["all"] = MAX_DEPTH + 1
    return sorted(levels, key=lambda group: -levels[group])


def _build_host(name: str, inventory: AnsibleInventory, notes: Launch) -> ImportedHost:
    groups = _list_parents(inventory, name)
    variables: dict[str, Variable] = {}
    for group in groups:
        variables |= inventory.group(group).variables
    variables |= inventory.hosts[name]
    values: dict[str, str] = {}
    for key, variable in variables.items():
        if key in _PASSWORDS:
            notes.note(
                variable.mark, f"{key} is not imported", "use keys, or password_command: in the inventory"
            )
        elif "{{" in variable.text and key.startswith("ansible_"):
            notes.note(
                variable.mark, f"{key} is a template and not imported", "write its value in the inventory"
            )
        elif key in _FIELDS:
            values.setdefault(_FIELDS[key], variable.text)
        elif key in ("ansible_ssh_common_args", "ansible_ssh_extra_args") and (
            jump := _JUMP.search(variable.text)
        ):
            values["proxy_jump"] = jump[1]
        elif key.startswith("ansible_") and key != "ansible_connection":
            notes.note(variable.mark, f"{key} is not imported")
    port = values.get("port", "0")
    if not port.isdecimal() or int(port) > 65535:
        mark = next(variables[key].mark for key in ("ansible_port", "ansible_ssh_port") if key in variables)
        raise ImportFaultError(
            mark, ProblemCode.QUANTITY, f"{port!r} is no port", "write a number from 1 to 65535"
        )
    connection = variables.get("ansible_connection")
    return ImportedHost(
        name=name,
        address=values.get("address", name),
        user=values.get("user", ""),
        port=int(port),
        identity_file=values.get("identity_file", ""),
        proxy_jump=values.get("proxy_jump", ""),
        groups=tuple(group for group in groups if group not in _BUILT_IN_GROUPS),
        local=connection is not None and connection.text == "local",
    )
