# SPDX-License-Identifier: Apache-2.0
"""``ros`` of a host in the inventory: its keys, the rules between them, and the master that a name means."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from edgectl.config.fields import Fields, list_reader, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import INVALID, NodeReader, address_reader, integer_reader, read_text
from edgectl.config.schema import build_object_schema, describe_as
from edgectl.model.inventory import Host
from edgectl.model.ros import MASTER_PORT, RosSettings

_VERSION_OF_KEY = {"master": 1, "domain": 2, "rmw": 2, "discovery_server": 2}
_read_address = address_reader()
# Of the characters of an address alone: it reaches shells, as {master}.
_MASTER_URI = r"http://[A-Za-z0-9._:%\[\]-]+:[0-9]{1,5}/?"


@describe_as(lambda: {"type": "string", "pattern": r"^(~/|/)[^\0]*$"})
def _read_setup_file(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A path on the host: absolute, or below the home directory."""
    path = read_text(node, problems)
    if not isinstance(path, str) or path.startswith(("/", "~/")):
        return path
    problems.add(
        node.mark,
        ProblemCode.TEXT,
        f"{path!r} is no absolute path",
        "write the path on the host, such as /opt/ros/humble/setup.bash or ~/ws/install/setup.bash",
    )
    return INVALID


@describe_as(lambda: {"type": "string", "pattern": r"^(?!-)[A-Za-z0-9._:%@\[\]/-]+$"})
def _read_master(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The name of a host, an address, or a URI."""
    text = read_text(node, problems)
    if not isinstance(text, str) or "://" not in text:
        return text if text is INVALID else _read_address(node, problems)
    if re.fullmatch(_MASTER_URI, text):
        return text
    problems.add(
        node.mark,
        ProblemCode.TEXT,
        f"{text!r} is no URI of a ROS master",
        f"write the name of a host, or http://ADDRESS:{MASTER_PORT}",
    )
    return INVALID


ROS_KEYS: Mapping[str, NodeReader] = {
    "version": integer_reader(1, 2),
    "setup": list_reader(_read_setup_file),
    "master": _read_master,
    "domain": integer_reader(0, 232),
    "rmw": read_text,
    "discovery_server": read_text,
}


@describe_as(lambda: build_object_schema(ROS_KEYS))
def read_ros(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The values as stated; a key of the other version of ROS is a mistake."""
    fields = read_fields(node, problems, ROS_KEYS, what="ros")
    version = fields.values.get("version")
    for key, other in _VERSION_OF_KEY.items():
        if version not in (None, other) and key in fields.values:
            problems.add(
                fields.node.key_mark(key),
                ProblemCode.CONTRADICTION,
                f"{key} is a setting of ROS {other}, and version is {version}",
                f"remove {key}, or write version: {other}",
            )
    return fields.values


def build_ros_settings(
    fields: Fields, default: Mapping[str, Any] | None, problems: Problems
) -> RosSettings | None:
    """What a host states over what ``defaults`` states, key by key; None where neither says anything.

    Defaults that are of the other version of ROS do not count.
    """
    stated = fields.values.get("ros")
    if stated is None and default is None:
        return None
    merged = {**(default or {}), **(stated or {})}
    if "version" not in merged:
        if "ros" in fields:
            problems.add(
                fields.node.key_mark("ros"), ProblemCode.MISSING, "ros needs version", "add version: 1, or 2"
            )
        return None
    version = merged["version"]
    return RosSettings(
        **{key: value for key, value in merged.items() if _VERSION_OF_KEY.get(key, version) == version}
    )


def resolve_master(host: Host, hosts: Mapping[str, Host]) -> Host:
    """``host`` with the URI of its master in place of a name or an address."""
    if host.ros is None or host.ros.master is None or "://" in host.ros.master:
        return host
    name = host.ros.master
    address = hosts[name].host if name in hosts else name
    shown = f"[{address}]" if address.count(":") > 1 and not address.startswith("[") else address
    port = "" if _has_port(shown) else f":{MASTER_PORT}"
    return replace(host, ros=replace(host.ros, master=f"http://{shown}{port}"))


def _has_port(address: str) -> bool:
    _, colon, port = address.rpartition(":")
    return bool(colon) and port.isdecimal() and "]" not in port
