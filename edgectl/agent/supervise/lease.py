# SPDX-License-Identifier: Apache-2.0
"""Lease of the fleet on this host: one manager at a time changes it.

Everything is measured in seconds since boot on this host's own clock. The record is durable before a grant to
another manager is answered, and the epoch in it only grows.
"""

import fcntl
import os
import time
import zlib

from ..link import protocol
from ..link.boot import check_private_dir, make_private_dir
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import proc, system_files
from . import grants, lease_rules, records, task_dirs

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable

_RECORD, _NOTE, _LOCK, _STARTS = protocol.LEASE_FILE, "watch", "lease.lock", "lease.starts"
# One file for each manager that was granted the fleet; of more than these the host keeps the last ones.
_MAX_LISTINGS = 8
# Writers of the record hold its lock for milliseconds. A start lasts until its supervisor has reported.
_WRITE_S, _START_S, _POLL_S = 5.0, 6.0, 0.02


def claim_lease(claim: Document) -> Document:
    """Grant the fleet on this host to a manager, or name its holder."""
    base = _make_lease_dir()
    if not base:
        return {"state": "unwritable"}
    with _Lock(base, _LOCK, fcntl.LOCK_EX, _WRITE_S):
        reply, new = _answer_claim(base, claim)
    if new:
        # A start of the last holder that is under way ends first: this claim is followed by a measurement.
        with _Lock(base, _STARTS, fcntl.LOCK_EX, _START_S):  # noqa: SIM117 - Python 3.6 has no brackets here
            with _Lock(base, _LOCK, fcntl.LOCK_EX, _WRITE_S):
                reply, _ = _answer_claim(base, claim, write=True)
    return reply


def _answer_claim(base: str, claim: Document, *, write: bool = False) -> "tuple[Document, bool]":
    """Reply to a claim, and whether it is a grant of a new epoch, which is made only with ``write``."""
    record, note, now, boot = (
        _read_newest(_RECORD),
        _read_newest(_NOTE),
        proc.read_uptime_s(),
        system_files.read_boot_id(),
    )
    refusal = lease_rules.find_refusal(record, note, claim, now, boot)
    if refusal is not None:
        return refusal, False
    granted = lease_rules.build_grant(record, claim, now, boot)
    new = granted["epoch"] != record.get("epoch")
    if write or not new:
        durable = any(granted[key] != record.get(key) for key in ("holder", "manager"))
        records.write_record(os.path.join(base, _RECORD), granted, durable=durable)
        if claim.get("watch"):
            records.write_record(os.path.join(base, _NOTE), lease_rules.build_note(claim, now, boot))
        _keep_listing(base, claim)
    watch = lease_rules.describe_watch(note, now, boot)
    return {"state": "granted", "epoch": granted["epoch"], "watch": watch or None}, new


def _keep_listing(base: str, claim: Document) -> None:
    """Keep which hosts the manager has. A full disk or a list that is too long is no reason to refuse."""
    path = os.path.join(base, "%s%08x" % (grants.LISTINGS, zlib.crc32(str(claim["holder"]).encode())))
    old = records.read_record(path)
    new = lease_rules.build_listing(old, claim)
    if new == old:
        return
    others = sorted(
        (each for each in grants.list_listings([base]) if each != path), key=os.path.getmtime, reverse=True
    )
    try:
        for each in others[_MAX_LISTINGS - 1 :]:
            os.unlink(each)
        records.write_record(path, new, durable=True)
    except (OSError, ValueError):
        pass


def serve_lease(request: Document) -> Document:
    """Operation ``lease``: claim, renew or release it."""
    if request["action"] == "claim":
        return claim_lease(request["lease"])
    base = _find_lease_dir()
    if not base:
        raise RefusalError("not-holder", "this host knows of no lease")
    with _Lock(base, _LOCK, fcntl.LOCK_EX, _WRITE_S):
        if request["action"] == "renew":
            _renew_lease(base, request["lease"])
            return {"state": "renewed"}
        _release_lease(base, request)
    return {"state": "released"}


def perform_within_lease(request: Document, operation: "Callable[[Document], Document]") -> Document:
    """Carry out a changing request within the lease that it is signed with, which it renews.

    Raises:
        RefusalError: another manager has the fleet, or the lease has run out.
    """
    if request["op"] == protocol.OP_START:
        return perform_before_claims(request, operation)
    base = _find_signed_dir(request)
    return _renew_and_perform(base, request, operation) if base else operation(request)


def perform_before_claims(request: Document, operation: "Callable[[Document], Document]") -> Document:
    """As `perform_within_lease`; another manager is granted the fleet only after the end of ``operation``."""
    base = _find_signed_dir(request)
    if not base:
        return operation(request)
    with _Lock(base, _STARTS, fcntl.LOCK_SH, _START_S):
        return _renew_and_perform(base, request, operation)


def _find_signed_dir(request: Document) -> str:
    """The directory of the lease; empty where neither the host nor the request knows of one."""
    base = _find_lease_dir()
    if not base and request.get("lease") is not None:
        raise RefusalError("not-holder", "this host knows of no lease", "apply again")
    return base


def _renew_and_perform(base: str, request: Document, operation: "Callable[[Document], Document]") -> Document:
    with _Lock(base, _LOCK, fcntl.LOCK_EX, _WRITE_S):
        _renew_lease(base, request.get("lease"))
    return operation(request)


def _renew_lease(base: str, signature: "Document | None") -> None:
    record, now = _read_newest(_RECORD), proc.read_uptime_s()
    fault = lease_rules.find_fault(record, signature, now, system_files.read_boot_id())
    if fault:
        raise RefusalError("not-holder", fault + ": nothing was done", "apply again")
    if signature is not None:
        records.write_record(os.path.join(base, _RECORD), lease_rules.extend_record(record, now))


def _release_lease(base: str, request: Document) -> None:
    """End the lease of this session, if it still has it, and remove the note of its watch on request."""
    record, signature, note = _read_newest(_RECORD), request["lease"], _read_newest(_NOTE)
    if all(record.get(key) == signature.get(key) for key in ("holder", "session", "epoch")):
        records.write_record(os.path.join(base, _RECORD), dict(record, until=0.0))
    if request.get("end_watch") and note.get("holder") == lease_rules.get_manager(signature):
        records.write_record(os.path.join(base, _NOTE), {})


class _Lock:
    """A lock of this process alone: neither a supervisor nor a task inherits it.

    No ``contextlib``: it imports collections and functools, a tenth of the CPU of a request.
    """

    def __init__(self, base: str, name: str, kind: int, patience_s: float) -> None:
        self._path = os.path.join(base, name)
        self._kind = kind
        self._patience_s = patience_s
        self._fd = -1

    def __enter__(self) -> None:
        """Take the lock.

        Raises:
            RefusalError: another request has it for longer than the patience.
        """
        self._fd = records.open_private_file(self._path, os.O_RDWR | os.O_CREAT)
        try:
            self._wait()
        except BaseException:
            os.close(self._fd)
            raise

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)

    def _wait(self) -> None:
        deadline = time.monotonic() + self._patience_s
        while True:
            try:
                fcntl.lockf(self._fd, self._kind | fcntl.LOCK_NB)
            except OSError:
                if time.monotonic() >= deadline:
                    raise RefusalError(
                        "busy", "another change is under way on this host", "apply again"
                    ) from None
            else:
                return
            time.sleep(_POLL_S)


def _read_newest(name: str) -> Document:
    """The record with the highest epoch, the note seen last, among all bases."""
    found = [records.read_record(os.path.join(base, name)) for base in _list_existing_dirs()]
    return max(found, key=lambda each: (each.get("epoch", 0), each.get("at", 0.0)), default={})


def _list_existing_dirs() -> "list[str]":
    found = []
    for levels in grants.list_fleet_dirs():
        if os.path.exists(os.path.join(levels[-1], _LOCK)):
            for level in levels:
                check_private_dir(level)
            found.append(levels[-1])
    return found


def _find_lease_dir() -> str:
    """The first directory of the lease that can be written; empty where this host was never asked for one."""
    for folder in _list_existing_dirs():
        try:
            os.close(records.open_private_file(os.path.join(folder, _LOCK), os.O_RDWR))
        except OSError:
            continue
        return folder
    return ""


def _make_lease_dir() -> str:
    """The first directory that accepts the files of the lease; empty where none does."""
    for levels in grants.list_fleet_dirs():
        try:
            for level in levels:
                make_private_dir(level)
            for name in (_RECORD, _NOTE):
                task_dirs.reserve_file(os.path.join(levels[-1], name), records.RECORD_BYTES)
            task_dirs.reserve_file(os.path.join(levels[-1], _STARTS), 0)
            task_dirs.reserve_file(os.path.join(levels[-1], _LOCK), 0)
        except OSError:
            continue
        return levels[-1]
    return ""
