# SPDX-License-Identifier: Apache-2.0
"""Position of each ``on_event`` hook in the history: which events it has received, and when it ran."""

import contextlib
import dataclasses
import fcntl
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.formats.digest import hash_value
from edgectl.formats.kinds import DocumentKind
from edgectl.model.encoding import Instant
from edgectl.model.event import Event, EventHook
from edgectl.state.json_files import Warn, ignore_warning, load_or_set_aside, write_json
from edgectl.state.paths import open_private_file
from edgectl.state.uptime import Uptime

CURSOR_FILE_NAME = "on_event.json"
_UPDATE_LOCK = "on_event.json.lock"


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCursor:
    """Events up to ``id`` are delivered; ``digest`` is that of the event ``id``, by which a history that
    began anew is recognised. ``ran``: the last start of the program; ``failures`` in a row. ``seen``: when an
    edgectl last had the hook in its files (s since 1970), give or take an hour.
    """

    id: int = 0
    digest: str = ""
    ran: Uptime | None = None
    failures: int = 0
    seen: Instant = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCursors:
    """The cursors by ``name_hook``, and messages about failures that nobody was told yet."""

    hooks: Mapping[str, EventCursor] = field(default_factory=dict)
    untold: tuple[str, ...] = ()


_KIND = DocumentKind(name="file of delivered events", version=1, model=EventCursors)


def name_hook(hook: EventHook) -> str:
    """The name of a hook in the file: the same as long as it tells the same program of the same kinds."""
    return hash_value((hook.command, hook.notifier, hook.options, frozenset(hook.kinds)))[:16]


def digest_event(event: Event) -> str:
    """Digest of an event without its id."""
    return hash_value((event.at, event.kind, event.host, event.task, event.message))[:16]


def load_cursors(state: Path, warn: Warn = ignore_warning) -> EventCursors:
    """The cursors as saved; none where the file is missing or broken."""
    return load_or_set_aside(state / CURSOR_FILE_NAME, _KIND.decode, EventCursors(), warn)


def update_cursors(state: Path, change: Callable[[EventCursors], EventCursors]) -> EventCursors:
    """Read, change and write the cursors while no other process does; the cursors as they were before.

    Raises:
        StateError: the disk does not take them.
        OSError: the directory is gone.
    """
    with _hold_lock(state / _UPDATE_LOCK, wait=True):
        before = load_cursors(state)
        after = change(before)
        if after != before:
            write_json(state / CURSOR_FILE_NAME, _KIND.encode(after), keep=False)
        return before


def replace_cursor(cursors: EventCursors, name: str, cursor: EventCursor) -> EventCursors:
    """``cursors`` with another one for the hook ``name``."""
    return dataclasses.replace(cursors, hooks={**cursors.hooks, name: cursor})


@contextlib.contextmanager
def hold_hook_lock(state: Path, name: str) -> Iterator[bool]:
    """Whether this process is the only one that delivers events to the hook ``name``, until the end."""
    with _hold_lock(state / f"on_event-{name}.lock", wait=False) as held:
        yield held


@contextlib.contextmanager
def _hold_lock(path: Path, *, wait: bool) -> Iterator[bool]:
    descriptor = open_private_file(path, os.O_RDWR)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(descriptor)


def has_begun_anew(cursor: EventCursor, events: Sequence[Event]) -> bool:
    """Whether the history was set aside since, so that its ids began anew. ``events``: those from
    ``cursor.id`` on, oldest first.
    """
    if cursor.id == 0:
        return False
    if not events:
        return True
    return events[0].id == cursor.id and digest_event(events[0]) != cursor.digest
