# SPDX-License-Identifier: Apache-2.0
"""Background program that hands recorded events to the ``on_event`` programs of a fleet.

edgectl starts it with its job on standard input and does not wait for it, so no cycle waits for a hook, and
an event is delivered even if edgectl has ended. At most one at a time serves each hook of a fleet.
"""

import contextlib
import dataclasses
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edgectl.dataclass import dataclass
from edgectl.errors import EdgectlError
from edgectl.model.event import Event, EventHook, EventKind
from edgectl.state.event_cursor import (
    EventCursor,
    EventCursors,
    digest_event,
    has_begun_anew,
    hold_hook_lock,
    load_cursors,
    name_hook,
    replace_cursor,
    update_cursors,
)
from edgectl.state.json_files import ignore_warning
from edgectl.state.store import Store
from edgectl.state.uptime import Uptime, compute_elapsed_s, read_uptime
from edgectl.transport.backoff import compute_backoff_s
from edgectl.usecases.hook_run import build_hook_document, mask_secrets, run_hook

_SLICE_S = 1.0
_MAX_PAUSE_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CourierJob:
    """The fleet, its state directory, its hooks, and the secrets of its files, which no message may show."""

    fleet: str
    state: Path
    hooks: tuple[EventHook, ...]
    secrets: tuple[str, ...] = ()

    def to_json(self) -> str:
        """The job as the text from which ``read_job`` makes it again."""
        hooks = [
            {item.name: getattr(hook, item.name) for item in dataclasses.fields(hook)} for hook in self.hooks
        ]
        entry = {"fleet": self.fleet, "state": str(self.state), "hooks": hooks, "secrets": self.secrets}
        return json.dumps(entry, default=dict)


def read_job(text: str) -> CourierJob:
    """The job in the text."""
    entry: Mapping[str, Any] = json.loads(text)
    hooks = [
        EventHook(
            **{
                **hook,
                "command": tuple(hook["command"]),
                "kinds": tuple(EventKind(kind) for kind in hook["kinds"]),
            }
        )
        for hook in entry["hooks"]
    ]
    return CourierJob(
        fleet=entry["fleet"], state=Path(entry["state"]), hooks=tuple(hooks), secrets=tuple(entry["secrets"])
    )


def deliver_events(job: CourierJob) -> None:
    """Run the hooks until all events are delivered, or only failing hooks are left: the next edgectl tries
    these again.

    Hooks that another courier serves are left to it: it looks once more after it has given up their locks.
    """
    while job.state.is_dir():
        with contextlib.ExitStack() as held:
            own = [hook for hook in job.hooks if _take_hook(held, job.state, hook)]
            job = dataclasses.replace(job, hooks=tuple(own))
            while (pause := _deliver_due(job)) is not None and job.state.is_dir():
                time.sleep(min(pause, _SLICE_S))
        if not _has_work_left(job):
            return


def _take_hook(held: contextlib.ExitStack, state: Path, hook: EventHook) -> bool:
    return held.enter_context(hold_hook_lock(state, name_hook(hook)))


def _has_work_left(job: CourierJob) -> bool:
    """Whether events came while the lock was given up."""
    return any(events and not cursor.failures for _, cursor, events in _list_pending(job))


def _list_pending(job: CourierJob) -> list[tuple[EventHook, EventCursor, Sequence[Event]]]:
    """Each hook with its cursor and the events that it has not received."""
    if not job.state.is_dir():
        return []
    cursors = load_cursors(job.state).hooks
    found: list[tuple[EventHook, EventCursor, Sequence[Event]]] = []
    with Store.open(job.state, warn=ignore_warning) as store:
        for hook in job.hooks:
            cursor = cursors.get(name_hook(hook))
            if cursor is None:
                continue
            events: Sequence[Event] = store.events(after=max(0, cursor.id - 1))
            if has_begun_anew(cursor, events):
                cursor = dataclasses.replace(cursor, id=0, digest="")
                events = store.events()
            found.append((hook, cursor, [event for event in events if event.id > cursor.id]))
    return found


def _deliver_due(job: CourierJob) -> float | None:
    """Run what is due; seconds until the next hook is due, None if none waits."""
    pauses = []
    for hook, cursor, events in _list_pending(job):
        if not events:
            continue
        wanted = [event for event in events if event.kind in hook.kinds]
        pause = _compute_pause_s(hook, cursor) if wanted else 0.0
        if pause == 0:
            _run_and_record(job, hook, cursor, events[-1], wanted)
        elif not cursor.failures:
            pauses.append(pause)
    return min(pauses, default=None)


def _compute_pause_s(hook: EventHook, cursor: EventCursor) -> float:
    """Seconds until the hook may run again; by the uptime, for clocks are set."""
    if cursor.ran is None:
        return 0.0
    now = read_uptime()
    if now.boot != cursor.ran.boot:
        return 0.0
    rest = hook.every
    if cursor.failures:
        rest = compute_backoff_s(cursor.failures, first_s=max(hook.every, 1.0), max_s=_MAX_PAUSE_S)
    return max(0.0, rest - compute_elapsed_s(cursor.ran, now))


def _run_and_record(
    job: CourierJob, hook: EventHook, cursor: EventCursor, newest: Event, wanted: Sequence[Event]
) -> None:
    reached = dataclasses.replace(cursor, id=newest.id, digest=digest_event(newest))
    if not wanted:
        _save_cursor(job, hook, reached)
        return
    began: Uptime = read_uptime()
    why = run_hook(hook, build_hook_document(hook, job.fleet, wanted, job.secrets), job.secrets)
    if not why:
        _save_cursor(job, hook, dataclasses.replace(reached, ran=began, failures=0))
        return
    untold = () if cursor.failures else (mask_secrets(f"{hook.subject} {why}", job.secrets),)
    _save_cursor(job, hook, dataclasses.replace(cursor, ran=began, failures=cursor.failures + 1), untold)


def _save_cursor(job: CourierJob, hook: EventHook, cursor: EventCursor, untold: tuple[str, ...] = ()) -> None:
    def change(cursors: EventCursors) -> EventCursors:
        after = replace_cursor(cursors, name_hook(hook), cursor)
        return dataclasses.replace(after, untold=(*after.untold, *untold)) if untold else after

    update_cursors(job.state, change)


def main() -> int:
    """Deliver the events of the job on standard input."""
    try:
        deliver_events(read_job(sys.stdin.read()))
    except (EdgectlError, OSError):
        return 1  # the state directory is gone or full; the next edgectl says so
    return 0


if __name__ == "__main__":
    sys.exit(main())
