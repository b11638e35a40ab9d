# SPDX-License-Identifier: Apache-2.0
"""Lease of a fleet by one manager: the grants of the hosts, and the signature of every changing request.

A host grants the fleet to one manager at a time, for a lease on the host's own clock (docs/adr/0042). Here
the lease is counted from before the request left, so it ends earlier than on the host.
"""

import math
import threading
from collections.abc import Callable, Mapping
from typing import Protocol

from edgectl.dataclass import dataclass
from edgectl.errors import RefusedError, ReplyError

LEASE_S = 30.0
# How long a manager waits for hosts that another one took at the same moment and gives back at once.
CONTENTION_S = 3.0
_MAX_EPOCH, _MAX_REVISION, _MAX_SECONDS, _MAX_TEXT = 2**53, 2**63, 1e9, 80
Document = dict[str, object]


class LeaseLostError(RefusedError):
    """The fleet is not held on a host (any more): nothing was sent."""

    kind = "lease"


class Term(Protocol):
    """The lease of the fleet outside of the hosts, in etcd; its ``revision`` grows from holder to holder."""

    revision: int

    def is_over(self) -> bool:
        """Whether it has run out by the manager's own clock, or was lost."""

    def save_state(self, state: bytes) -> int:
        """Replace the shared state of the fleet, if this run still holds it; the revision of the new one.

        Raises:
            CoordinationError: etcd does not answer, or the fleet was lost.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchNote:
    """The watch of a fleet: a cycle each ``every_s``; ``digest`` of its files."""

    every_s: float
    digest: str = ""
    who: str = ""
    age_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseRefusal:
    """Reason for which a host did not grant the fleet. ``watched``: it has another watch; else it is held.

    ``age_s`` since the holder took it (or was seen), ``left_s`` until its lease ends unless it is renewed.
    ``every_s``: the cycle of the watch of the fleet, 0 without one. ``revision``: of etcd, above the claimed
    one where the host refuses for that reason.
    """

    who: str
    verb: str
    age_s: float
    left_s: float
    every_s: float
    watched: bool = False
    revision: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Grant:
    epoch: int
    until: float


class FleetLease:
    """The hold of a fleet by one run of edgectl; safe from any thread.

    ``holder`` names the manager, ``session`` this hold. ``clock``: s, monotonic, time asleep included.
    ``patience_s``: how long to wait for another manager; None: for one cycle of a watch. ``hosts``: those
    on which this manager may place tasks, which others are told (docs/adr/0068). ``term``: the lease in etcd;
    then ``holder`` names all managers that share it, and ``manager`` this one (docs/adr/0080).
    """

    def __init__(
        self,
        *,
        holder: str,
        session: str,
        who: str,
        verb: str,
        clock: Callable[[], float],
        watch: WatchNote | None = None,
        take_over: bool = False,
        patience_s: float | None = None,
        ttl_s: float = LEASE_S,
        hosts: tuple[str, ...] = (),
        manager: str = "",
        term: Term | None = None,
    ) -> None:
        self._identity: Document = {"holder": holder, "session": session}
        self._manager, self.term = manager or holder, term
        self._claim: Document = {
            **self._identity,
            "manager": self._manager,
            "revision": 0 if term is None else term.revision,
            "who": who,
            "verb": verb,
            "ttl_s": ttl_s,
            "watch": None if watch is None else {"every_s": watch.every_s, "digest": watch.digest},
            "take_over": take_over,
            "hosts": list(hosts),
        }
        self._clock, self.ttl_s, self.patience_s = clock, ttl_s, patience_s
        self._lock = threading.Lock()
        self._sent: dict[str, float] = {}
        self._grants: dict[str, _Grant] = {}
        self._silent: set[str] = set()
        self.refusals: dict[str, LeaseRefusal] = {}
        self.watched_by: WatchNote | None = None

    def build_claim(self, host: str) -> Document:
        """The claim to send to ``host`` now."""
        with self._lock:
            self._sent[host] = self._clock()
        return {**self._claim, "name": host}

    def take_reply(self, host: str, reply: object) -> None:
        """Take the reply of ``host`` to the last claim.

        Raises:
            ReplyError: it is none.
        """
        document = reply if isinstance(reply, dict) else {}
        state = document.get("state")
        with self._lock:
            self.refusals.pop(host, None)
            if state == "granted":
                epoch = _read_number(document, "epoch", _MAX_EPOCH)
                self._grants[host] = _Grant(epoch=int(epoch), until=self._sent[host] + self.ttl_s)
                self.watched_by = _read_note(document.get("watch")) or self.watched_by
            elif state in ("held", "watched"):
                self._grants.pop(host, None)
                self.refusals[host] = _read_refusal(document)
            elif state == "unwritable":
                self._grants.pop(host, None)
            else:
                raise ReplyError("the reply to the claim of the fleet is not valid")

    def sign(self, host: str) -> Document:
        """The signature of a changing request to ``host``.

        A lease that ran out on a host that answers means that this manager stood still meanwhile: another one
        may have changed what was seen there, so nothing is sent to any host. A silent host does not count.

        Raises:
            LeaseLostError: the host did not grant the fleet, or a lease has run out.
        """
        if self.term is not None and self.term.is_over():
            raise LeaseLostError(
                "the lease of the fleet in etcd has run out: nothing was sent",
                hint="run apply again: it takes the fleet again",
                host=host,
            )
        now = self._clock()
        with self._lock:
            grant = self._grants.get(host)
            lapsed = [
                name
                for name, each in self._grants.items()
                if now >= each.until and (name == host or name not in self._silent)
            ]
        if grant is None:
            raise LeaseLostError(
                f"{host} did not grant the fleet to this edgectl: nothing was sent",
                hint="apply again",
                host=host,
            )
        if lapsed:
            raise LeaseLostError(
                f"the lease of the fleet on {lapsed[0]} has run out: nothing was sent",
                hint="run apply again: it takes the fleet again",
                host=host,
            )
        return {**self._identity, "epoch": grant.epoch}

    def sign_release(self, host: str) -> Document:
        """The signature that gives ``host`` back; epoch 0 where it was given back before."""
        with self._lock:
            grant = self._grants.pop(host, None)
        return {**self._identity, "manager": self._manager, "epoch": 0 if grant is None else grant.epoch}

    def note_silent(self, host: str) -> None:
        """Note that ``host`` did not answer a heartbeat."""
        with self._lock:
            self._silent.add(host)

    def now(self) -> float:
        """Seconds on the clock of the lease."""
        return self._clock()

    def extend(self, host: str, sent: float) -> None:
        """Note that ``host`` carried out a request that was signed and sent at ``sent`` (`now`)."""
        with self._lock:
            grant = self._grants.get(host)
            if grant is not None:
                self._silent.discard(host)
                until = max(grant.until, sent + self.ttl_s)
                self._grants[host] = _Grant(epoch=grant.epoch, until=until)

    def list_granted(self) -> tuple[str, ...]:
        """The hosts that granted the fleet and whose lease has not run out."""
        now = self._clock()
        with self._lock:
            return tuple(host for host, grant in self._grants.items() if now < grant.until)


def _read_refusal(document: Document) -> LeaseRefusal:
    return LeaseRefusal(
        who=_read_text(document, "who"),
        verb=_read_text(document, "verb"),
        age_s=_read_number(document, "age_s", _MAX_SECONDS),
        left_s=_read_number(document, "left_s", _MAX_SECONDS),
        every_s=_read_number(document, "every_s", _MAX_SECONDS),
        watched=document.get("state") == "watched",
        revision=int(_read_number(document, "revision", _MAX_REVISION)),
    )


def _read_note(value: object) -> WatchNote | None:
    if not isinstance(value, dict):
        return None
    return WatchNote(
        who=_read_text(value, "who"),
        digest=_read_text(value, "digest"),
        every_s=_read_number(value, "every_s", _MAX_SECONDS),
        age_s=_read_number(value, "age_s", _MAX_SECONDS),
    )


def _read_number(document: Mapping[str, object], key: str, most: float) -> float:
    value = document.get(key, 0.0)
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not 0 <= value <= most
        or math.isnan(value)
    ):
        raise ReplyError(f"the reply to the claim of the fleet has no valid {key}")
    return value


def _read_text(document: Mapping[str, object], key: str) -> str:
    text = str(document.get(key, ""))[:_MAX_TEXT]
    return "".join(letter if letter.isprintable() else "?" for letter in text)
