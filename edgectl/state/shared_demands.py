# SPDX-License-Identifier: Apache-2.0
"""Measured demands that the machines of a fleet share through etcd (docs/adr/0177): the copy of this one."""

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.formats.kinds import DocumentKind
from edgectl.model.encoding import in_document
from edgectl.model.manager_state import MeasuredDemand
from edgectl.state.json_files import Warn, ignore_warning, load_or_set_aside, write_json

_DEMANDS_FILE_NAME = "demands.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredDemands:
    """Measured demands by task and class of hosts."""

    measured: Mapping[tuple[str, str], MeasuredDemand] = field(
        default_factory=dict, metadata=in_document(required=True, entries=("task", "class"))
    )


_DEMANDS_KIND = DocumentKind(name="file of shared demands", version=1, model=_StoredDemands)


def load_shared_demands(
    fleet_dir: Path, warn: Warn = ignore_warning
) -> Mapping[tuple[str, str], MeasuredDemand]:
    """The demands; empty where none are shared."""
    path = fleet_dir / _DEMANDS_FILE_NAME
    return load_or_set_aside(path, _DEMANDS_KIND.decode, _StoredDemands(), warn).measured


def save_shared_demands(fleet_dir: Path, measured: Mapping[tuple[str, str], MeasuredDemand]) -> None:
    """Replace them.

    Raises:
        StateError: the disk does not take it.
    """
    stored = _StoredDemands(measured=measured)
    write_json(fleet_dir / _DEMANDS_FILE_NAME, _DEMANDS_KIND.encode(stored), keep=False)
