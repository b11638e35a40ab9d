# SPDX-License-Identifier: Apache-2.0
"""Delivery of recorded events to ``on_event``: bookkeeping, and the start of the courier."""

import contextlib
import dataclasses
import os
import sys
import time
from collections.abc import Iterator, Sequence

from edgectl.dataclass import dataclass
from edgectl.errors import StateError
from edgectl.model.event import Event, EventHook, EventKind
from edgectl.model.secret import Secret
from edgectl.state.event_cursor import (
    EventCursor,
    EventCursors,
    digest_event,
    hold_hook_lock,
    load_cursors,
    name_hook,
    update_cursors,
)
from edgectl.usecases.event_courier import CourierJob
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.hook_run import build_hook_document, run_hook

_COURIERS: list[int] = []
# A hook that no edgectl had in its files for so long is forgotten; how often that it is there is noted.
_FORGET_S, _NOTE_EVERY_S = 86400.0, 3600.0


@contextlib.contextmanager
def deliver_recorded_events(fleet: Fleet) -> Iterator[None]:
    """Deliver what is recorded within the block, and what an earlier run left, in the background.

    Nothing of it fails the caller: a hook that cannot be run is a warning, once.
    """
    hooks = {name_hook(hook) for hook in fleet.inventory.on_event}
    try:
        known, now = load_cursors(fleet.state, fleet.warn).hooks, fleet.clock()
        if any(name not in known or abs(now - known[name].seen) > _NOTE_EVERY_S for name in hooks):
            _note_hooks(fleet, hooks, now)
    except (StateError, OSError) as error:
        fleet.warn(f"on_event: {error}")
    yield
    try:
        cursors = load_cursors(fleet.state, fleet.warn)
        if cursors.untold:
            _tell_failures(fleet)
        own = [cursor for name, cursor in cursors.hooks.items() if name in hooks]
        if own and _has_events_after(fleet, own):
            _start_courier(fleet)
    except (StateError, OSError) as error:
        fleet.warn(f"on_event: {error}")


def _note_hooks(fleet: Fleet, hooks: set[str], now: float) -> None:
    """A new hook begins with the next event, and hooks that no file has had for a day are forgotten.

    Other managers may keep this state directory with other hooks, so one that is not ours is no hook that is
    gone.
    """
    newest = fleet.history.use(fleet.state, fleet.warn, lambda store: store.events(limit=1))
    start = EventCursor(id=newest[0].id, digest=digest_event(newest[0])) if newest else EventCursor()

    def change(cursors: EventCursors) -> EventCursors:
        others = {name: each for name, each in cursors.hooks.items() if now - each.seen <= _FORGET_S}
        own = {name: dataclasses.replace(cursors.hooks.get(name, start), seen=now) for name in sorted(hooks)}
        return dataclasses.replace(cursors, hooks=others | own)

    update_cursors(fleet.state, change)


def _tell_failures(fleet: Fleet) -> None:
    before = update_cursors(fleet.state, lambda cursors: dataclasses.replace(cursors, untold=()))
    for message in before.untold:
        fleet.warn(f"{message}; try it with: edgectl events test")


def _has_events_after(fleet: Fleet, cursors: Sequence[EventCursor]) -> bool:
    newest = fleet.history.use(fleet.state, fleet.warn, lambda store: store.events(limit=1))
    if not newest:
        return False
    place = (newest[0].id, digest_event(newest[0]))
    return any((cursor.id, cursor.digest) != place for cursor in cursors)


def _start_courier(fleet: Fleet) -> None:
    """Start the courier in a session of its own, unless each hook has one at work. It is not waited for."""
    _COURIERS[:] = [pid for pid in _COURIERS if _is_running(pid)]
    if not any(_is_unserved(fleet, hook) for hook in fleet.inventory.on_event):
        return
    job = CourierJob(
        fleet=fleet.inventory.fleet,
        state=fleet.state.absolute(),
        hooks=fleet.inventory.on_event,
        secrets=list_file_secrets(fleet),
    )
    # On standard input, so that no secret is on a command line; a file in memory never makes the writer wait.
    data, nowhere = os.memfd_create("courier", os.MFD_CLOEXEC), os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
    try:
        os.write(data, job.to_json().encode())
        os.lseek(data, 0, os.SEEK_SET)
        _COURIERS.append(
            os.posix_spawn(
                sys.executable,
                [sys.executable, "-P", "-m", "edgectl.usecases.event_courier"],
                os.environ,
                file_actions=[
                    (os.POSIX_SPAWN_DUP2, data, 0),
                    (os.POSIX_SPAWN_DUP2, nowhere, 1),
                    (os.POSIX_SPAWN_DUP2, nowhere, 2),
                ],
                setsid=True,
            )
        )
    finally:
        os.close(data)
        os.close(nowhere)


def _is_unserved(fleet: Fleet, hook: EventHook) -> bool:
    with hold_hook_lock(fleet.state, name_hook(hook)) as free:
        return free


def _is_running(pid: int) -> bool:
    """Whether a courier of ours has not ended; one that has is reaped."""
    try:
        return os.waitpid(pid, os.WNOHANG) == (0, 0)
    except ChildProcessError:
        return False


def list_file_secrets(fleet: Fleet) -> tuple[str, ...]:
    """The values that the files mark as secret."""
    environments = [
        *(host.env for host in fleet.inventory.hosts.values()),
        *(task.env for task in fleet.tasks.tasks.values()),
    ]
    found = {value.reveal() for env in environments for value in env.values() if isinstance(value, Secret)}
    return tuple(sorted(found))


@dataclass(frozen=True, slots=True, kw_only=True)
class HookTrial:
    """Result of one hook that was run by hand: why it failed (empty: it did not), and how long it took."""

    hook: EventHook
    failure: str
    seconds: float


def list_tested_hooks(fleet: Fleet, kind: EventKind | None = None) -> tuple[EventHook, ...]:
    """The hooks that receive events of ``kind``, None: of any."""
    return tuple(
        hook for hook in fleet.inventory.on_event if hook.kinds and (kind is None or kind in hook.kinds)
    )


def run_hook_trials(fleet: Fleet, kind: EventKind | None = None) -> tuple[HookTrial, ...]:
    """Run each hook once with an example event of its first kind; with ``kind``, only hooks of that kind."""
    trials = []
    secrets = list_file_secrets(fleet)
    for hook in list_tested_hooks(fleet, kind):
        event = Event(
            at=fleet.clock(),
            kind=kind or hook.kinds[0],
            host=next(iter(fleet.inventory.hosts), None),
            message="a test of on_event; nothing happened",
        )
        began = time.monotonic()
        document = build_hook_document(hook, fleet.inventory.fleet, [event], secrets, test=True)
        why = run_hook(hook, document, secrets)
        trials.append(HookTrial(hook=hook, failure=why, seconds=time.monotonic() - began))
    return tuple(trials)
