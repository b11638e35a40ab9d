# SPDX-License-Identifier: Apache-2.0
"""``coordination`` of an inventory: the etcd that grants the fleet and keeps the manager's state."""

import re
from collections.abc import Mapping
from typing import Any

from edgectl.config.fields import Fields, read_argument_vector, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import INVALID, NodeReader, read_text
from edgectl.config.schema import build_object_schema, describe_as, get_reader_schema
from edgectl.model.inventory import Coordination

_DEFAULT_PORT, _MAX_ENDPOINTS = 2379, 9
_HOST = r"(?:\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9](?:[A-Za-z0-9._-]*[A-Za-z0-9])?)"
_ENDPOINT = rf"({_HOST})(?::([0-9]{{1,5}}))?"
_ADDRESS_PATTERN = (
    rf"^etcds?://{_HOST}(?::[0-9]{{1,5}})?(?:,{_HOST}(?::[0-9]{{1,5}})?){{0,{_MAX_ENDPOINTS - 1}}}$"
)
_EXAMPLE = "write etcd://10.0.0.5:2379,10.0.0.6:2379 (etcds:// for TLS)"
_TLS_KEYS = ("ca", "cert", "key")


@describe_as(lambda: {"type": "string", "pattern": _ADDRESS_PATTERN})
def _read_address(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    """(tls, endpoints) of ``etcd://HOST:PORT,HOST:PORT``."""
    value = read_text(node, problems)
    if not isinstance(value, str):
        return value
    scheme, separator, rest = value.partition("://")
    if not separator or scheme not in ("etcd", "etcds"):
        return _refuse(node, problems, "coordination must be an address of etcd", _EXAMPLE)
    if "@" in rest:
        # The text may hold a password: it is not shown.
        problems.add(
            node.mark.redact(),
            ProblemCode.PASSWORD,
            "coordination contains a user or a password",
            "write coordination: {address: etcd://10.0.0.5:2379, user: edgectl, password_command: [..]}",
        )
        return INVALID
    endpoints = [_parse_endpoint(each) for each in rest.split(",")]
    for text, endpoint in zip(rest.split(","), endpoints, strict=True):
        if endpoint is None:
            return _refuse(node, problems, f"no address of etcd: {text!r}", _EXAMPLE)
    if len(set(endpoints)) < len(endpoints):
        return _refuse(node, problems, "coordination names an address twice", "remove one of the two")
    if len(endpoints) > _MAX_ENDPOINTS:
        return _refuse(
            node, problems, f"more than {_MAX_ENDPOINTS} addresses of etcd", "name three or five of them"
        )
    return scheme == "etcds", tuple(endpoints)


def _parse_endpoint(text: str) -> tuple[str, int] | None:
    match = re.fullmatch(_ENDPOINT, text)
    if match is None:
        return None
    port = int(match[2] or _DEFAULT_PORT)
    return (match[1].strip("[]"), port) if 1 <= port <= 65535 else None


def _refuse(node: Node, problems: Problems, message: str, hint: str) -> Any:  # noqa: ANN401 - INVALID
    problems.add(node.mark, ProblemCode.TEXT, message, hint)
    return INVALID


COORDINATION_KEYS: Mapping[str, NodeReader] = {
    "address": _read_address,
    "ca": read_text,
    "cert": read_text,
    "key": read_text,
    "user": read_text,
    "password_command": read_argument_vector,
}


@describe_as(
    lambda: {
        "anyOf": [get_reader_schema(_read_address), build_object_schema(COORDINATION_KEYS, ("address",))]
    }
)
def read_coordination(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    """An address, or a mapping with the address, files for TLS, and a user."""
    if not isinstance(node.value, dict):
        address = _read_address(node, problems)
        return address if address is INVALID else Coordination(tls=address[0], endpoints=address[1])
    fields = read_fields(node, problems, COORDINATION_KEYS, required=("address",), what="coordination")
    if "address" not in fields.values or not _check_coordination(fields, problems):
        return INVALID
    tls, endpoints = fields.values.pop("address")
    return Coordination(tls=tls, endpoints=endpoints, **fields.values)


def _check_coordination(fields: Fields, problems: Problems) -> bool:
    """Whether the keys fit together."""
    tls, _ = fields.values["address"]
    unused = [key for key in _TLS_KEYS if key in fields and not tls]
    if unused:
        problems.add(
            fields.node.key_mark(unused[0]),
            ProblemCode.CONTRADICTION,
            f"{unused[0]} counts only with TLS",
            "write etcds:// in the address",
        )
    for one, other in (
        ("cert", "key"),
        ("key", "cert"),
        ("user", "password_command"),
        ("password_command", "user"),
    ):
        if one in fields and other not in fields:
            problems.add(
                fields.node.key_mark(one),
                ProblemCode.CONTRADICTION,
                f"{one} needs {other}",
                f"add {other}: .., or remove {one}",
            )
            return False
    return not unused
