"""Keep the record of which host was in touch when, for every command that asks one."""

import contextlib
import dataclasses
import threading
from collections.abc import Iterator

from edgectl.errors import HostError, StateError
from edgectl.model.memory import Memory
from edgectl.state.contacts import load_contacts, note
from edgectl.state.memory import load_memory
from edgectl.state.uptime import Uptime
from edgectl.transport.noted import Noted
from edgectl.usecases.fleet import Fleet

# Two requests closer than this count as one where each contact is written before the request leaves.
_OFTEN_S = 1.0


@contextlib.contextmanager
def in_touch(fleet: Fleet) -> Iterator[Fleet]:
    """The fleet over a transport that notes contacts; they are written at the end.

    Where a task stops itself after a silence (``self_fence``), a contact is on disk before its request leaves, so that a command
    that is killed leaves no host believing that it was heard of later than this manager knows.

    A contact that the disk does not take then is a HostError: the request did not leave.
    """
    register = _Register(fleet)
    try:
        yield dataclasses.replace(fleet, transport=Noted(fleet.transport, register.note))
    finally:
        register.save()


def remembered(fleet: Fleet) -> Memory:
    """What this manager remembers of the fleet, its contacts and fences included."""
    memory, contacts = load_memory(fleet.state, fleet.warn), load_contacts(fleet.state, fleet.warn)
    return dataclasses.replace(memory, contact=contacts.instants(fleet.clock(), fleet.uptime()), fenced=contacts.fenced)


class _Register:
    """The contacts of one command; from any thread."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._at_once = any(task.self_fence is not None for task in fleet.tasks.tasks.values())
        self._heard: dict[str, Uptime] = {}
        self._written: dict[str, Uptime] = {}
        self._guard = threading.Lock()

    def note(self, host: str) -> None:
        """``host`` is in touch now."""
        now = self._fleet.uptime()
        with self._guard:
            self._heard[host] = now
            written = self._written.get(host)
            if self._at_once and (written is None or now.seconds - written.seconds > _OFTEN_S):
                self._write(host, now)

    def _write(self, host: str, now: Uptime) -> None:
        try:
            note(self._fleet.state, {host: now})
        except StateError as error:
            raise HostError(error.message, hint=error.hint, host=host) from error
        self._written[host] = now

    def save(self) -> None:
        """Write what was heard. That the disk is full is said, not more: what must be on it was written before."""
        with self._guard:
            try:
                note(self._fleet.state, self._heard)
            except StateError as error:
                self._fleet.warn(f"{error.message}: when the hosts were last in touch is not remembered")
