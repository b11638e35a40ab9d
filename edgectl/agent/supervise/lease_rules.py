# SPDX-License-Identifier: Apache-2.0
"""Rules of the lease of a fleet on one host, on documents and seconds of this host alone. Pure.

Record: ``holder`` (a manager), ``session`` (one hold of it), ``epoch`` (counts the sessions, for ever),
``other_epoch`` (the last one of a manager other than the holder), ``manager`` (the machine of the holder:
managers that share one etcd are one holder), ``term`` (a holder and the last revision of its etcd),
``who`` and ``verb`` for messages, ``since`` and ``until`` (uptime, s), ``ttl_s`` and ``boot_id``. Note: the
watch of the fleet, with ``every_s`` and ``digest`` of its files, last seen ``at`` an uptime.
Listing: the ``hosts`` in the inventory of one ``holder``, and the ``names`` that this machine has there.
"""

from ..link.fast_json import Document

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

MIN_TTL_S, MAX_TTL_S = 0.1, 300.0
_TEXT_LENGTH = 80
# A watch counts as gone after three cycles without it, and not before so many seconds besides one cycle.
_NOTE_CYCLES, _NOTE_S = 3.0, 30.0


def is_live(record: Document, now: float, boot: str) -> bool:
    """Whether the lease is in force: requests of its session are carried out."""
    return bool(record) and record.get("boot_id") == boot and now < float(record.get("until", 0.0))


def compute_left_s(record: Document, now: float, boot: str) -> float:
    """Seconds for which only the holder may take the fleet; 0 where it is free. After a boot it is not known
    how much of a lease is left, so the whole of it passes once more.
    """
    if not record or not record.get("until"):
        return 0.0
    if record.get("boot_id") == boot:
        return max(0.0, float(record["until"]) - now)
    return max(0.0, float(record.get("ttl_s", 0.0)) - now)


def is_fresh(note: Document, now: float, boot: str) -> bool:
    """Whether the watch of the note claimed the fleet lately."""
    every = float(note.get("every_s", 0.0))
    lasts = max(_NOTE_CYCLES * every, every + _NOTE_S)
    return bool(note) and note.get("boot_id") == boot and now - float(note["at"]) < lasts


def find_refusal(
    record: Document, note: Document, claim: Document, now: float, boot: str
) -> "Document | None":
    """The reply to a claim that is declined; None where it is granted."""
    other = is_fresh(note, now, boot) and note.get("holder") != get_manager(claim)
    if claim.get("watch") and other and not claim.get("take_over"):
        return dict(describe_watch(note, now, boot), state="watched")
    left = compute_left_s(record, now, boot)
    later = find_revision(record, claim["holder"])
    if left > 0.0 and record.get("holder") != claim["holder"] or int(claim.get("revision", 0)) < later:
        live = record.get("boot_id") == boot
        age = now - float(record.get("since", 0.0)) if live else now
        return {
            "state": "held",
            "who": record.get("who", ""),
            "verb": record.get("verb", ""),
            "age_s": round(age, 3),
            "left_s": round(left, 3),
            "every_s": describe_watch(note, now, boot).get("every_s", 0.0),
            "revision": later,
        }
    return None


def describe_watch(note: Document, now: float, boot: str) -> Document:
    """The fresh note as a manager receives it; empty without one."""
    if not is_fresh(note, now, boot):
        return {}
    return {
        "who": note.get("who", ""),
        "every_s": note.get("every_s", 0.0),
        "age_s": round(now - float(note["at"]), 3),
        "digest": note.get("digest", ""),
    }


def build_grant(record: Document, claim: Document, now: float, boot: str) -> Document:
    """The record of a claim that is granted; the same session keeps its epoch."""
    ttl = min(MAX_TTL_S, max(MIN_TTL_S, float(claim["ttl_s"])))
    again = is_live(record, now, boot) and _is_same(record, claim)
    return {
        "holder": _truncate_text(claim["holder"]),
        "session": _truncate_text(claim["session"]),
        "manager": _truncate_text(get_manager(claim)),
        "term": _build_term(record, claim),
        "epoch": int(record.get("epoch", 0)) + (0 if again else 1),
        "other_epoch": find_other_epoch(record, claim["holder"]),
        "who": _truncate_text(claim.get("who", "")),
        "verb": _truncate_text(claim.get("verb", "")),
        "since": float(record["since"]) if again else round(now, 3),
        "until": round(now + ttl, 3),
        "ttl_s": ttl,
        "boot_id": boot,
    }


def get_manager(document: Document) -> object:
    """The machine that claims or signs; without etcd it is the holder itself."""
    return document.get("manager", document["holder"])


def find_revision(record: Document, holder: object) -> int:
    """The last revision of its etcd with which ``holder`` was granted the fleet; 0 without one.

    It stays while others hold the fleet in between.
    """
    term = record.get("term") or ["", 0]
    return int(term[1]) if term[0] == holder else 0


def _build_term(record: Document, claim: Document) -> "list[object]":
    if claim.get("revision"):
        return [_truncate_text(claim["holder"]), int(claim["revision"])]
    return record.get("term") or ["", 0]


def build_listing(listing: Document, claim: Document) -> Document:
    """The listing of the manager that claims the fleet, whose last one was ``listing``."""
    hosts = [_truncate_text(host) for host in claim.get("hosts", ())]
    names = {name for name in listing.get("names", ()) if name in hosts}
    names.add(_truncate_text(claim.get("name", "")))
    return {"holder": _truncate_text(claim["holder"]), "hosts": hosts, "names": sorted(names)}


def find_other_epoch(record: Document, holder: object) -> int:
    """The epoch of the last session of a manager other than ``holder``; 0 where there was none."""
    same = record.get("holder") in (None, holder)
    return int(record.get("other_epoch" if same else "epoch", 0))


def build_note(claim: Document, now: float, boot: str) -> Document:
    """The note of the watch that claims the fleet."""
    watch = claim["watch"]
    return {
        "holder": _truncate_text(get_manager(claim)),
        "who": _truncate_text(claim.get("who", "")),
        "every_s": min(86400.0, max(0.0, float(watch["every_s"]))),
        "digest": _truncate_text(watch.get("digest", "")),
        "at": round(now, 3),
        "boot_id": boot,
    }


def find_fault(record: Document, signature: "Document | None", now: float, boot: str) -> str:
    """Why a changing request is not carried out; empty where it is.

    A request without a signature is carried out while nobody holds the fleet.
    """
    live = is_live(record, now, boot)
    if signature is None:
        return "%s holds the fleet" % record.get("who", "another edgectl") if live else ""
    if not _is_same(record, signature) or int(signature["epoch"]) != record.get("epoch"):
        return "%s has taken the fleet" % (record.get("who") or "another edgectl")
    return "" if live else "the lease of the fleet has run out"


def extend_record(record: Document, now: float) -> Document:
    """The record with its lease renewed now."""
    return dict(record, until=round(now + float(record["ttl_s"]), 3))


def _is_same(record: Document, other: Document) -> bool:
    return record.get("holder") == other.get("holder") and record.get("session") == other.get("session")


def _truncate_text(text: "Any") -> str:
    return str(text)[:_TEXT_LENGTH]
