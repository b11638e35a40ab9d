# SPDX-License-Identifier: Apache-2.0
"""Digests of what a file means: the same for every order in which it may be written."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from enum import StrEnum
from functools import cache
from typing import Any

from edgectl.model.demand import Demand
from edgectl.model.inventory import Inventory
from edgectl.model.resource import RESOURCES_BY_NAME, ResourceMap
from edgectl.model.task import Task, Tasks

RUN_FIELDS = ("command", "env", "workdir", "kind", "restart", "stop", "ready", "limits", "log", "robots")
OPTIONAL_RUN_FIELDS = ("self_fence", "env_command", "alive", "activation", "image")


def digest_inventory(inventory: Inventory) -> str:
    """Digest of the content of an inventory. A fleet name that is derived from the path of the file does not
    count.
    """
    stated = {"fleet": inventory.fleet} if inventory.is_fleet_named else {}
    return "sha256:" + hash_value({"hosts": inventory.hosts, "links": inventory.links} | stated)


def digest_tasks(tasks: Tasks) -> str:
    """Digest of all tasks and the stated policy, however they are split into files."""
    placeless = {name: replace(task, file="") for name, task in tasks.tasks.items()}
    return "sha256:" + hash_value({"tasks": placeless, "policy": tasks.policy})


def hash_spec(task: Task) -> str:
    """Digest of what runs: 16 hex digits.

    Demand, priority and host rules steer the placement and leave it unchanged.
    """
    return hash_value(_select_run_fields(task))[:16]


def hash_spec_fields(task: Task) -> dict[str, str]:
    """Digest of each field of what runs: 8 hex digits, enough to tell which of them changed."""
    return {name: hash_value(value)[:8] for name, value in _select_run_fields(task).items()}


def _select_run_fields(task: Task) -> dict[str, Any]:
    """The fields that make what runs.

    A secret counts by its name: its value is written as ``***`` wherever it is not revealed.
    """
    stated = {name: getattr(task, name) for name in OPTIONAL_RUN_FIELDS if getattr(task, name)}
    return {name: getattr(task, name) for name in RUN_FIELDS} | stated


def hash_value(value: object) -> str:
    """SHA-256 of the canonical form of ``value``: 64 hex digits."""
    text = json.dumps(
        _to_canonical(value), sort_keys=True, ensure_ascii=True, allow_nan=False, separators=(",", ":")
    )
    return hashlib.sha256(text.encode()).hexdigest()


def _to_canonical(value: Any) -> Any:  # noqa: ANN401
    """Only JSON types; mappings by text keys, sets sorted.

    Of a record the entries that differ from their default.
    """
    if value is None or isinstance(value, str | int | float):
        return value.value if isinstance(value, StrEnum) else value
    if isinstance(value, Demand):
        return {
            RESOURCES_BY_NAME[name].demand_key: _to_canonical(inner) for name, inner in value.stated.items()
        }
    if isinstance(value, ResourceMap):
        return {name: _to_canonical(inner) for name, inner in value.stated.items()}
    if isinstance(value, Mapping):
        return {_key_to_text(key): _to_canonical(inner) for key, inner in value.items()}
    if isinstance(value, tuple):
        return [_to_canonical(inner) for inner in value]
    if isinstance(value, frozenset):
        return sorted(value)
    if is_dataclass(value):
        return _encode_changed_fields(value)
    raise TypeError(f"no canonical form of {type(value).__name__}")


def _encode_changed_fields(value: Any) -> dict[str, Any]:  # noqa: ANN401
    changed = {}
    for name, default in _list_field_defaults(type(value)):  # type: ignore[arg-type]  # a class is hashable; mypy doubts it
        inner = getattr(value, name)
        if inner is not default and inner != default:
            changed[name] = _to_canonical(inner)
    return changed


@cache
def _list_field_defaults(kind: Any) -> tuple[tuple[str, object], ...]:  # noqa: ANN401
    return tuple((item.name, _get_field_default(item)) for item in fields(kind))


def _get_field_default(item: Field[Any]) -> object:
    return item.default_factory() if item.default_factory is not MISSING else item.default


def _key_to_text(key: object) -> str:
    return "\0".join(key) if isinstance(key, tuple) else str(key)
