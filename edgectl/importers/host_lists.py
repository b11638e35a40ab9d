# SPDX-License-Identifier: Apache-2.0
"""Hosts of other tools as an inventory."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from edgectl.importers.ros_tasks import to_host_name
from edgectl.importers.yaml_text import FileEntry, FileText

_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._/-]{0,62}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedHost:
    """A host as another tool knows it. Empty and 0: not stated. ``groups`` become labels."""

    name: str
    address: str
    user: str = ""
    port: int = 0
    identity_file: str = ""
    proxy_jump: str = ""
    groups: tuple[str, ...] = field(default=())
    local: bool = False


def build_inventory(hosts: Sequence[ImportedHost], title: str, fleet: str) -> FileText:
    """The inventory with each host as an edge."""
    entries, taken = [], set()
    for host in hosts:
        base = name = to_host_name(host.name)
        number = 1
        while name in taken:
            number += 1
            name = f"{base}-{number}"
        taken.add(name)
        entries.append(FileEntry(name=name, values=_build_values(host)))
    comments = (f"Imported from {title}. Move robots to robots:.",)
    return FileText(comments=comments, keys={"version": 1, "fleet": fleet}, sections={"edges": entries})


def _build_values(host: ImportedHost) -> dict[str, object]:
    values: dict[str, object] = {"connection": "local"} if host.local else {"host": host.address}
    for key in ("user", "port", "identity_file", "proxy_jump"):
        if getattr(host, key) and not host.local:
            values[key] = getattr(host, key)
    if host.groups:
        values["labels"] = {group: "true" for group in sorted(host.groups) if _LABEL.fullmatch(group)}
    return values
