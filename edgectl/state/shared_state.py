# SPDX-License-Identifier: Apache-2.0
"""State of the manager that all machines of a fleet share through etcd, and what of it this machine has.

The files of this machine are a working copy: installed when the fleet is taken, collected when it is saved.
"""

import hashlib
import json
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.errors import StateError
from edgectl.formats.document import FormatErrors
from edgectl.formats.kinds import DocumentKind
from edgectl.model.encoding import in_document
from edgectl.model.manager_state import ManagerState
from edgectl.state.heartbeats import load_heartbeats, replace_marks
from edgectl.state.json_files import Warn, ignore_warning, load_or_set_aside, write_json
from edgectl.state.manager_state import (
    load_ignored_instances,
    load_manager_state,
    save_ignored_instances,
    save_manager_state,
    select_saved_fields,
)
from edgectl.state.open_work import OpenWork
from edgectl.state.shared_demands import load_shared_demands, save_shared_demands
from edgectl.state.uptime import Uptime

_COPY_FILE_NAME = "coordination.json"
# Compressed, as etcd keeps it (its own bound is 1.5 MiB), and as it is decoded.
_MAX_STORED_BYTES, _MAX_DOCUMENT_BYTES = 1 << 20, 1 << 26


@dataclass(frozen=True, slots=True, kw_only=True)
class PendingStart:
    """A start that a holder of the fleet was about to send."""

    host: str = field(metadata=in_document(required=True))
    generation: int = field(metadata=in_document(required=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedState:
    """What etcd keeps of a fleet.

    ``manager``: without heartbeats; with fences, orphans and the measured demands that are shared.
    ``ignored``: instances whose end no longer counts. ``starts``: by task, those that may have been sent
    since ``manager`` was saved. ``journal``: what the last holder's leaves; an older edgectl shares none.
    """

    manager: ManagerState = field(default=ManagerState(), metadata=in_document(required=True))
    ignored: tuple[str, ...] = ()
    starts: Mapping[str, PendingStart] = field(default_factory=dict)
    journal: OpenWork | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalCopy:
    """Which state of etcd the files of this machine come from: ``revision`` of the fleet's name ``id`` there
    (0: none), ``digest`` of its content, its ``starts`` and ``journal``.
    """

    id: str = ""
    revision: int = 0
    digest: str = ""
    starts: Mapping[str, PendingStart] = field(default_factory=dict)
    journal: OpenWork = OpenWork()


_STATE_KIND = DocumentKind(name="state of a fleet in etcd", version=1, model=SharedState)
_COPY_KIND = DocumentKind(name="file of coordination", version=1, model=LocalCopy)


def encode_shared_state(state: SharedState) -> bytes:
    """The bytes to store.

    Raises:
        StateError: they are too many.
    """
    data = zlib.compress(_format_document(state))
    if len(data) > _MAX_STORED_BYTES:
        raise StateError(
            f"the state of this fleet is too large for etcd ({len(data)} bytes)",
            hint="split the fleet over several inventories",
        )
    return data


def decode_shared_state(data: bytes) -> SharedState:
    """The state in ``data``.

    Raises:
        StateError: it is damaged, or a newer edgectl wrote it.
    """
    try:
        unpacker = zlib.decompressobj()
        document = json.loads(unpacker.decompress(data, _MAX_DOCUMENT_BYTES))
        return _STATE_KIND.decode(document)
    except (zlib.error, ValueError, RecursionError, FormatErrors) as error:
        raise StateError(
            f"the state of this fleet in etcd cannot be read: {str(error)[:200]}",
            hint="use the newest edgectl of your machines, or restore etcd from a backup",
        ) from error


def compute_state_digest(state: SharedState) -> str:
    """The digest of its document: equal on every machine, whatever compresses it."""
    return hashlib.sha256(_format_document(state)).hexdigest()


def _format_document(state: SharedState) -> bytes:
    document = _STATE_KIND.encode(state)
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def load_local_copy(fleet_dir: Path, warn: Warn = ignore_warning) -> LocalCopy:
    """Where the files of this machine come from; empty where not from etcd."""
    return load_or_set_aside(fleet_dir / _COPY_FILE_NAME, _COPY_KIND.decode, LocalCopy(), warn)


def save_local_copy(fleet_dir: Path, copy: LocalCopy) -> None:
    """Replace it.

    Raises:
        StateError: the disk does not take it.
    """
    write_json(fleet_dir / _COPY_FILE_NAME, _COPY_KIND.encode(copy), keep=False)


def collect_shared_state(
    fleet_dir: Path, starts: Mapping[str, PendingStart], journal: OpenWork, warn: Warn = ignore_warning
) -> SharedState:
    """The state of this machine as it is shared, with ``starts`` and ``journal``."""
    marks = load_heartbeats(fleet_dir, warn)
    manager = select_saved_fields(load_manager_state(fleet_dir, warn))
    return SharedState(
        manager=replace(
            manager,
            fenced=marks.fenced,
            orphans=marks.orphans,
            measured=load_shared_demands(fleet_dir, warn),
        ),
        ignored=load_ignored_instances(fleet_dir, warn),
        starts=starts,
        journal=journal,
    )


def install_shared_state(fleet_dir: Path, state: SharedState, hosts: Iterable[str], now: Uptime) -> None:
    """Replace the state of this machine. The silence of ``hosts``, and of those where tasks are placed,
    counts from now: another machine may have been in touch with them until a moment ago.

    Raises:
        StateError: the disk does not take it.
    """
    manager = state.manager
    places = {placement.host for placement in manager.placements.values()}
    if manager.measured != load_shared_demands(fleet_dir):
        save_shared_demands(fleet_dir, manager.measured)
    save_manager_state(fleet_dir, replace(manager, orphans={}))
    save_ignored_instances(fleet_dir, state.ignored)
    replace_marks(
        fleet_dir,
        fenced=manager.fenced,
        orphans=manager.orphans,
        heard=dict.fromkeys({*hosts, *places}, now),
    )


def add_own_places(state: SharedState, fleet_dir: Path, warn: Warn = ignore_warning) -> SharedState:
    """``state`` with the places that only this machine knows, which has managed the fleet without etcd."""
    own = load_manager_state(fleet_dir, warn).placements
    placements = {**own, **state.manager.placements}
    return replace(state, manager=replace(state.manager, placements=placements))
