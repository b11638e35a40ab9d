# SPDX-License-Identifier: Apache-2.0
"""Lease of a fleet in etcd: one key that its holder creates, keeps alive and ends, and the state that only
the holder may write (docs/adr/0080, 0081).

The revision of the key grows with each holder, and hosts refuse an older one. The lease is counted from
before the request left, so it ends earlier here than in etcd.
"""

import base64
import contextlib
import json
import math
import secrets
import threading
from collections.abc import Callable, Iterator

from edgectl.dataclass import dataclass
from edgectl.errors import CoordinationError
from edgectl.model.text import clean_text
from edgectl.transport.etcd_client import (
    Document,
    EtcdClient,
    KeyValue,
    build_invalid_reply,
    encode_text,
    read_integer,
    read_pairs,
    read_responses,
)

# Another machine has the fleet of a dead manager within 10 s: etcd ends a lease within 0.5 s, and who waits
# asks every 0.3 s. A living one loses it after three renewals without an answer.
ETCD_LEASE_S = 8
_RENEWAL_SHARE, _RETRY_S, _REVOKE_TIMEOUT_S = 1 / 4, 0.5, 2.0
_MAX_TEXT, _MAX_CYCLE_S, _ID_BYTES = 80, 86_400.0, 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Holder:
    """Who holds the fleet: ``manager`` and ``session`` as on hosts, ``who`` and ``verb`` for messages.

    ``every_s``: the cycle of a watch, else 0. ``left_s``: until its lease ends unless it is renewed.
    """

    manager: str
    session: str
    who: str
    verb: str
    every_s: float = 0.0
    left_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetKeys:
    """What etcd has of a fleet. ``id``: the name of all managers that share it; empty before the first one.

    ``state``: what the last holder saved, at ``state_revision``.
    """

    id: str = ""
    holder: Holder | None = None
    holder_revision: int = 0
    holder_lease: int = 0
    state: bytes | None = None
    state_revision: int = 0


def read_fleet_keys(client: EtcdClient, fleet: str) -> FleetKeys:
    """What etcd has of ``fleet``, as a majority of its members has it.

    Raises:
        CoordinationError: it does not answer.
    """
    return parse_fleet_keys(client.call("kv/range", _build_range(fleet)), fleet)


def _build_range(fleet: str) -> Document:
    prefix = _name_key(fleet, "")
    return {"key": encode_text(prefix), "range_end": encode_text(prefix[:-1] + "0"), "limit": 8}


def _name_key(fleet: str, name: str) -> str:
    return f"edgectl/{fleet}/{name}"


def parse_fleet_keys(document: object, fleet: str) -> FleetKeys:
    """The keys of ``fleet`` in the answer to a range.

    Raises:
        CoordinationError: it is not valid.
    """
    pairs = {each.key: each for each in read_pairs(document)}
    name, holder, state = (pairs.get(_name_key(fleet, key)) for key in ("id", "holder", "state"))
    return FleetKeys(
        id="" if name is None else _parse_id(name),
        holder=None if holder is None else _parse_holder(holder.value),
        holder_revision=0 if holder is None else holder.revision,
        holder_lease=0 if holder is None else holder.lease,
        state=None if state is None else state.value,
        state_revision=0 if state is None else state.revision,
    )


def _parse_id(pair: KeyValue) -> str:
    text = pair.value.decode(errors="replace")
    if len(text) != 2 * _ID_BYTES or not all(letter in "0123456789abcdef" for letter in text):
        raise build_invalid_reply("id")
    return text


def _parse_holder(value: bytes) -> Holder:
    try:
        document = json.loads(value)
    except (ValueError, RecursionError):
        document = {}
    fields = document if isinstance(document, dict) else {}
    every = fields.get("every_s", 0.0)
    number = isinstance(every, int | float) and math.isfinite(every)
    return Holder(
        manager=clean_text(fields.get("manager", ""), _MAX_TEXT),
        session=clean_text(fields.get("session", ""), _MAX_TEXT),
        who=clean_text(fields.get("who", ""), _MAX_TEXT) or "another edgectl",
        verb=clean_text(fields.get("verb", ""), _MAX_TEXT) or "?",
        every_s=min(_MAX_CYCLE_S, max(0.0, float(every))) if number else 0.0,
    )


class EtcdLease:
    """The hold of a fleet in etcd by one run of edgectl; safe from any thread.

    ``keys``: what etcd had when it was taken. ``revision`` grows from holder to holder. Once the lease has
    run out by the manager's own clock, it stays so.
    """

    def __init__(
        self,
        client: EtcdClient,
        fleet: str,
        keys: FleetKeys,
        *,
        lease: int,
        until: float,
        ttl_s: float,
        clock: Callable[[], float],
    ) -> None:
        self._client, self._fleet, self._lease = client, fleet, lease
        self._clock, self._ttl_s = clock, ttl_s
        self._lock, self._until = threading.Lock(), until
        self.keys, self.revision = keys, keys.holder_revision

    def is_over(self) -> bool:
        """Whether the lease has run out or was lost: nothing may be sent any more."""
        with self._lock:
            if self._clock() >= self._until:
                self._until = -math.inf
            return self._until == -math.inf

    def renew(self) -> bool:
        """Keep the lease alive; whether etcd has answered."""
        sent = self._clock()
        try:
            reply = self._client.call(
                "lease/keepalive", {"ID": str(self._lease)}, timeout=_RENEWAL_SHARE * self._ttl_s
            )
            left = read_integer(reply.get("result"), "TTL")
        except CoordinationError:
            return False
        with self._lock:
            if left == 0 or self._clock() >= self._until:
                self._until = -math.inf
            else:
                self._until = max(self._until, sent + min(left, self._ttl_s))
        return True

    @contextlib.contextmanager
    def keep_alive(self) -> Iterator[None]:
        """Renew the lease from a thread of its own until the end; then end it in etcd."""
        over = threading.Event()
        keeper = threading.Thread(target=self._renew_until, args=(over,), daemon=True)
        keeper.start()
        try:
            yield
        finally:
            over.set()
            with contextlib.suppress(CoordinationError):
                _revoke_lease(self._client, self._lease)

    def _renew_until(self, over: threading.Event) -> None:
        pause = _RENEWAL_SHARE * self._ttl_s
        while not over.wait(pause) and not self.is_over():
            pause = _RENEWAL_SHARE * self._ttl_s if self.renew() else _RETRY_S

    def save_state(self, state: bytes) -> int:
        """Replace the state of the fleet, if this run still holds it; the revision of the new one.

        Raises:
            CoordinationError: etcd does not answer, or the fleet was lost.
        """
        key, put = _name_key(self._fleet, "holder"), _name_key(self._fleet, "state")
        value = base64.b64encode(state).decode()
        reply = self._client.call(
            "kv/txn",
            {
                "compare": [_build_compare(key, self.revision)],
                "success": [{"request_put": {"key": encode_text(put), "value": value}}],
            },
        )
        if reply.get("succeeded") is not True:
            with self._lock:
                self._until = -math.inf
            raise CoordinationError(
                "the lease of the fleet in etcd has run out: nothing was saved there",
                hint="run apply again: it takes the fleet again",
            )
        return read_integer(reply.get("header"), "revision")


def take_fleet(
    client: EtcdClient, fleet: str, holder: Holder, *, clock: Callable[[], float], ttl_s: int = ETCD_LEASE_S
) -> EtcdLease | Holder:
    """The lease of ``fleet`` for ``holder``, or who has it. ``clock``: s, monotonic, time asleep included.

    An earlier run of the same manager is replaced: the lock of its machine proves that it has ended.

    Raises:
        CoordinationError: etcd does not answer.
    """
    keys = _read_named_keys(client, fleet)
    if keys.holder is not None and keys.holder.manager != holder.manager:
        return _describe_holder(client, keys)
    sent = clock()
    granted = client.call("lease/grant", {"TTL": str(ttl_s)})
    lease, ttl = read_integer(granted, "ID"), min(ttl_s, read_integer(granted, "TTL"))
    reply = client.call("kv/txn", _build_claim(fleet, holder, keys.holder_revision, lease))
    keys = parse_fleet_keys(
        read_responses(reply, 2 if reply.get("succeeded") is True else 1)[-1].get("response_range"), fleet
    )
    # A claim whose reply was lost has succeeded and is refused when it is repeated at another endpoint.
    if keys.holder is None or keys.holder.session != holder.session:
        _revoke_lease(client, lease)
        return _describe_holder(client, keys)
    return EtcdLease(client, fleet, keys, lease=lease, until=sent + ttl, ttl_s=ttl, clock=clock)


def _read_named_keys(client: EtcdClient, fleet: str) -> FleetKeys:
    """The keys of a fleet, which is named if nobody has done so."""
    keys = read_fleet_keys(client, fleet)
    if keys.id:
        return keys
    key, name = encode_text(_name_key(fleet, "id")), encode_text(secrets.token_hex(_ID_BYTES))
    client.call(
        "kv/txn",
        {
            "compare": [_build_compare(_name_key(fleet, "id"), 0)],
            "success": [{"request_put": {"key": key, "value": name}}],
        },
    )
    return read_fleet_keys(client, fleet)


def _build_claim(fleet: str, holder: Holder, replaces: int, lease: int) -> Document:
    """Put the key of the holder with its lease, if it is still at revision ``replaces`` (0: no holder)."""
    key = _name_key(fleet, "holder")
    value = {
        "manager": holder.manager,
        "session": holder.session,
        "who": holder.who,
        "verb": holder.verb,
        "every_s": holder.every_s,
    }
    put = {"key": encode_text(key), "value": encode_text(json.dumps(value)), "lease": str(lease)}
    look = {"request_range": _build_range(fleet)}
    return {
        "compare": [_build_compare(key, replaces)],
        "success": [{"request_put": put}, look],
        "failure": [look],
    }


def _build_compare(key: str, revision: int) -> Document:
    return {"key": encode_text(key), "target": "MOD", "result": "EQUAL", "mod_revision": str(revision)}


def _describe_holder(client: EtcdClient, keys: FleetKeys) -> Holder:
    """The holder, with the time that its lease has left."""
    holder = keys.holder or Holder(manager="", session="", who="another edgectl", verb="?")
    reply = client.call("lease/timetolive", {"ID": str(keys.holder_lease)}) if keys.holder_lease else {}
    left = reply.get("TTL", "0")
    # Minus one: it has ended meanwhile.
    left_s = 0 if left in ("-1", -1) else read_integer(reply, "TTL")
    return Holder(
        manager=holder.manager,
        session=holder.session,
        who=holder.who,
        verb=holder.verb,
        every_s=holder.every_s,
        left_s=left_s,
    )


def _revoke_lease(client: EtcdClient, lease: int) -> None:
    client.call("lease/revoke", {"ID": str(lease)}, timeout=_REVOKE_TIMEOUT_S)
