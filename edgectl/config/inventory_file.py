# SPDX-License-Identifier: Apache-2.0
"""Inventory file: tables of its keys, and readers of the hosts and links that it defines."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from edgectl.config.coordination import read_coordination
from edgectl.config.fields import (
    Fields,
    keep_node,
    list_reader,
    read_argument_vector,
    read_environment,
    read_fields,
    read_labels,
    record_reader,
)
from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems
from edgectl.config.quantities import parse_temperature
from edgectl.config.ros_settings import build_ros_settings, read_ros
from edgectl.config.scalars import (
    INVALID,
    NAME_PATTERN,
    NodeReader,
    address_reader,
    check_name,
    enum_reader,
    integer_reader,
    quantity_reader,
    read_bool,
    read_name,
    read_text,
    read_text_or_empty,
    read_version,
    report_wrong_type,
)
from edgectl.config.schema import (
    Schema,
    build_file_schema,
    build_mapping_schema,
    build_object_schema,
    describe_as,
    get_reader_schema,
)
from edgectl.model.inventory import BaseLoad, Capacity, Connection, Host, Limits, Role, Runtime
from edgectl.model.resource import HOST_RESOURCES, MEASURED_HOST_RESOURCES
from edgectl.units import parse_rate, parse_share

MAX_HOSTS = 10_000


LIMITS_KEYS: Mapping[str, NodeReader] = {
    resource.name: quantity_reader(parse_share, above_zero=True) for resource in HOST_RESOURCES
}
CAPACITY_KEYS: Mapping[str, NodeReader] = {
    resource.name: quantity_reader(resource.unit.parse, above_zero=True) for resource in HOST_RESOURCES
}
BASE_KEYS: Mapping[str, NodeReader] = {
    resource.name: quantity_reader(resource.unit.parse) for resource in HOST_RESOURCES
}
# A slice declares all of these, or none.
_SLICE_KEYS = tuple(resource.name for resource in MEASURED_HOST_RESOURCES)


def _describe_capacity() -> Schema:
    return build_object_schema(CAPACITY_KEYS) | {
        "anyOf": [{"required": list(_SLICE_KEYS)}, *_describe_budgets()]
    }


def _describe_budgets() -> list[Schema]:
    """A capacity of declared budgets alone makes no slice."""
    budgets = [key for key in CAPACITY_KEYS if key not in _SLICE_KEYS]
    return [{"propertyNames": {"enum": budgets}, "minProperties": 1}] if budgets else []


@describe_as(_describe_capacity)
def _read_capacity(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    stated = node.value if isinstance(node.value, dict) else {}
    budget_only = bool(stated) and all(key in CAPACITY_KEYS and key not in _SLICE_KEYS for key in stated)
    return record_reader(CAPACITY_KEYS, Capacity, "capacity", () if budget_only else _SLICE_KEYS)(
        node, problems
    )


_read_any_address = address_reader()


@describe_as(
    lambda: {
        "type": "string",
        "pattern": r"^(?!-)[A-Za-z0-9._:%\[\]-]+$",
        "not": {"pattern": "^[^:]+:[0-9]+$"},
    }
)
def _read_address(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """An address or an alias; user and port have keys of their own."""
    value = _read_any_address(node, problems)
    if not isinstance(value, str):
        return value
    user, _, rest = value.rpartition("@")
    host, _, port = rest.partition(":")
    if not host or not port.isdecimal():  # an address of IPv6 has more colons
        host, port = rest, ""
    if "@" not in value and not port:
        return value
    stated = {"host": host, "user": user, "port": port}
    message = "host contains " + " and ".join(f"a {key}" for key in ("user", "port") if stated[key])
    hint = "write " + ", ".join(f"{key}: {text}" for key, text in stated.items() if text)
    problems.add(node.mark, ProblemCode.TEXT, f"{message}: {value!r}", hint)
    return INVALID


DEFAULTS_KEYS: Mapping[str, NodeReader] = {
    "connection": enum_reader(Connection),
    "transport": read_name,
    "port": integer_reader(1, 65535),
    "user": address_reader(),
    "identity_file": read_text,
    "proxy_jump": address_reader(more=","),
    "password_command": read_argument_vector,
    "labels": read_labels,
    "limits": record_reader(LIMITS_KEYS, Limits, "limits"),
    "max_temperature": quantity_reader(parse_temperature),
    "env": read_environment,
    "env_command": read_argument_vector,
    "prelude": read_text_or_empty,
    "runtime": enum_reader(Runtime),
    "swarm": list_reader(read_name),
    "ros": read_ros,
}
EDGE_KEYS: Mapping[str, NodeReader] = {
    "host": _read_address,
    **DEFAULTS_KEYS,
    "capacity": _read_capacity,
    "base": record_reader(BASE_KEYS, BaseLoad, "base"),
}
ROBOT_KEYS: Mapping[str, NodeReader] = {**EDGE_KEYS, "onboard": read_bool, "probe": read_bool}
LINK_KEYS: Mapping[str, NodeReader] = {
    "edge": read_name,
    "robot": read_name,
    "throughput": quantity_reader(parse_rate),
}


INVENTORY_KEYS: Mapping[str, NodeReader] = {
    "version": read_version,
    "fleet": read_name,
    "probe_links": read_bool,
    "coordination": read_coordination,
    "on_event": keep_node,
    "defaults": keep_node,
    "edges": keep_node,
    "robots": keep_node,
    "links": keep_node,
}


def build_inventory_schema() -> Schema:
    """JSON Schema of an inventory file."""
    from edgectl.config.event_hooks import read_event_hooks

    schema = build_object_schema(
        INVENTORY_KEYS,
        ("version",),
        on_event=get_reader_schema(read_event_hooks),
        defaults=build_object_schema(DEFAULTS_KEYS),
        edges=build_mapping_schema(NAME_PATTERN.pattern, build_object_schema(EDGE_KEYS)),
        robots=build_mapping_schema(NAME_PATTERN.pattern, build_object_schema(ROBOT_KEYS)),
        links={"type": "array", "items": build_object_schema(LINK_KEYS, tuple(LINK_KEYS))},
    ) | {"dependentRequired": {"coordination": ["fleet"]}}
    return build_file_schema(
        "inventory", schema | {"anyOf": [{"required": ["edges"]}, {"required": ["robots"]}]}
    )


def _leave_out(_node: Node, _problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    return INVALID


def read_defaults(node: Node, problems: Problems) -> Mapping[str, Any]:
    """What is stated for every host of a file."""
    own = (ROBOT_KEYS.keys() - DEFAULTS_KEYS.keys()) & (
        node.value.keys() if isinstance(node.value, dict) else set()
    )
    for key in sorted(own):
        message, hint = f"{key} has no default", f"write {key} at each host that has it"
        problems.add(node.key_mark(key), ProblemCode.UNKNOWN_KEY, message, hint)
    readers = {**DEFAULTS_KEYS, **dict.fromkeys(own, _leave_out)}
    fields = read_fields(node, problems, readers, what="defaults")
    _check_identity_file(fields, problems)
    return fields.values


def expand_identity_file(host: Host) -> Host:
    """``~`` of the identity file expanded: after the digest, so that the same file has the same digest for
    every user.
    """
    path = host.identity_file
    return (
        replace(host, identity_file=str(Path(path).expanduser()))
        if path is not None and path.startswith("~/")
        else host
    )


def read_host_entries(
    node: Node,
    role: Role,
    defaults: Mapping[str, Any],
    hosts: dict[str, Host],
    places: dict[str, Mark],
    problems: Problems,
) -> None:
    """Add the hosts of one role to ``hosts``, and where they are named to ``places``."""
    if not isinstance(node.value, dict):
        report_wrong_type(
            node,
            problems,
            f"{role}s must be a mapping of names",
            f"write {role}1: {{host: 192.168.1.20}} on a line of its own",
        )
        return
    if len(hosts) + len(node.value) > MAX_HOSTS:
        problems.add(
            node.mark,
            ProblemCode.TOO_MANY,
            f"more than {MAX_HOSTS:,} hosts",
            "split the fleet over several inventories",
        )
        return
    for key, inner in node.value.items():
        check_name(key, node, problems, f"{'an' if role is Role.EDGE else 'a'} {role}")
        if key in hosts:
            first = places[key]
            elsewhere = first.source is not node.mark.source
            problems.add(
                node.key_mark(key),
                ProblemCode.TAKEN,
                f"{key} is already defined in {first.source.file}, line {first.line}"
                if elsewhere
                else f"{key} is already an edge; edges and robots share one namespace",
                "rename or remove one of the two" if elsewhere else "rename one of the two",
            )
            continue
        places[key] = node.key_mark(key)
        hosts[key] = _read_host_entry(key, role, inner, defaults, problems)


def _read_host_entry(
    key: str, role: Role, node: Node, defaults: Mapping[str, Any], problems: Problems
) -> Host:
    what = f"{role} {key}"
    fields = read_fields(node, problems, EDGE_KEYS if role is Role.EDGE else ROBOT_KEYS, what=what)
    values = {**defaults, **fields.values}
    for mapping in ("labels", "env"):
        values[mapping] = {**defaults.get(mapping, {}), **fields.values.get(mapping, {})}
    if "limits" in defaults and "limits" in fields.values:
        values["limits"] = _merge_limits(fields, defaults["limits"])
    values["ros"] = build_ros_settings(fields, defaults.get("ros"), problems)
    local = values.get("connection") is Connection.LOCAL
    if "host" not in fields and isinstance(node.value, dict) and not local:
        problems.add(
            node.mark,
            ProblemCode.MISSING,
            f"{what} needs host",
            "add host: 192.168.1.20 (an address or an ssh_config alias)",
        )
    _check_host_contradictions(fields, problems)
    _check_identity_file(fields, problems)
    return Host(name=key, role=role, **({"host": "127.0.0.1" if local else ""} | values))


def _merge_limits(fields: Fields, default: Limits) -> Limits:
    own: Limits = fields.values["limits"]
    stated = fields.at("limits").value
    changed = {key: own[key] for key in LIMITS_KEYS if isinstance(stated, dict) and key in stated}
    return Limits({**default, **changed})


def _check_host_contradictions(fields: Fields, problems: Problems) -> None:
    if "base" in fields and "capacity" not in fields:
        message = "base counts only on a slice, and this host declares no capacity"
        problems.add(
            fields.node.key_mark("base"),
            ProblemCode.CONTRADICTION,
            message,
            "add capacity: {cpu: .., memory: ..}, or remove base",
        )
    if fields.values.get("onboard") and fields.values.get("probe") is False:
        message = "a robot with probe: false is never contacted, so it cannot run its own tasks"
        problems.add(
            fields.node.key_mark("onboard"),
            ProblemCode.CONTRADICTION,
            message,
            "remove onboard: true or probe: false",
        )


def _check_identity_file(fields: Fields, problems: Problems) -> None:
    """A key that is missing here may be present where the inventory is used, so it is no error."""
    path = fields.values.get("identity_file")
    if isinstance(path, str) and not os.path.exists(os.path.expanduser(path)):  # noqa: PTH110, PTH111
        problems.add(
            fields.at("identity_file").mark,
            ProblemCode.NO_IDENTITY_FILE,
            f"{path}: no such file",
            "write the path of a private key on this machine, or remove identity_file",
            warning=True,
        )


def read_link_entries(
    node: Node, hosts: Mapping[str, Host], links: dict[tuple[str, str], float], problems: Problems
) -> None:
    """Add the declared links to ``links``."""
    if not isinstance(node.value, list):
        report_wrong_type(
            node,
            problems,
            "links must be a list",
            "write - {edge: edge1, robot: robot1, throughput: 54Mbit/s}",
        )
        return
    for inner in node.value:
        fields = read_fields(inner, problems, LINK_KEYS, required=tuple(LINK_KEYS), what="a link")
        ends = [_find_link_host(fields, role, hosts, problems) for role in Role]
        if None in ends or "throughput" not in fields.values:
            continue
        pair = (str(ends[0]), str(ends[1]))
        if pair in links:
            problems.add(
                inner.mark,
                ProblemCode.TAKEN,
                f"the link of {pair[0]} and {pair[1]} is declared twice",
                "remove one of the two",
            )
        links[pair] = fields.values["throughput"]


def _find_link_host(fields: Fields, role: Role, hosts: Mapping[str, Host], problems: Problems) -> str | None:
    wanted = fields.values.get(role.value)
    if wanted is None or (wanted in hosts and hosts[wanted].role is role):
        return wanted
    known = [host.name for host in hosts.values() if host.role is role]
    problems.add(
        fields.at(role.value).mark,
        ProblemCode.UNKNOWN_NAME,
        f"unknown {role} {wanted}",
        problems.did_you_mean(wanted, known, f"the {role}s are"),
    )
    return None
