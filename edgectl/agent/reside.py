"""Operations ``profiler-start``, ``-stop`` and ``-status``: at most one profiler per host, whoever asks and however often."""

import os
import time

from . import latest, launch, lease, life, logind, proc, seat, shell, signals, state
from .errors import RefusalError
from .start import take_lock

_TRIES = 5
_REPORT_S, _GRACE_S, _KILL_S = 10.0, 2.0, 5.0
# Longer than the agent that starts one waits for it: it holds the lock as long.
_SETTLE_S, _POLL_S = 15.0, 0.02
_MARGIN = 1.5


def start(request: dict) -> dict:
    """Start the profiler; one that lives and was asked for the same is left as it is, one with other wishes is replaced."""
    host = state.checked_name(request["host"])
    logind.check_survival()
    state_word = "started"
    for _ in range(_TRIES):
        sitter = _settled(host)
        if sitter is not None and _is_same(sitter, request):
            return dict(_described(host, request), state="already-running")
        if sitter is not None or any(seat.is_taken(folder) for folder in seat.folders(host)):
            _ended(host)
            state_word = "replaced"
        folder = seat.make(host)
        lock = take_lock(folder)
        if lock >= 0:
            _launch(folder, lock, request)
            return dict(_described(host, request), state=state_word)
    raise RefusalError("busy", "others start profilers here all the time", "try again")


def _settled(host: str):
    """The profiler that lives; where one is only being started, wait until it says who it is."""
    deadline = time.monotonic() + _SETTLE_S
    while True:
        sitter = seat.sitter(host)
        if sitter is not None and sitter.read()[0]:
            return sitter
        if not any(seat.is_taken(folder) for folder in seat.folders(host)) or time.monotonic() >= deadline:
            return sitter
        time.sleep(_POLL_S)


def _is_same(sitter, request: dict) -> bool:
    known = sitter.read()[0]
    return (known.get("wishes"), known.get("every_s"), known.get("ttl_s")) == (
        seat.wishes(request),
        float(request["every_s"]),
        float(request["ttl_s"]),
    )


def _launch(folder: str, lock: int, request: dict) -> None:
    order = dict(
        request, op="profiler-run", folder=folder, lock=lock, wishes=seat.wishes(request),
        every_s=float(request["every_s"]), ttl_s=float(request["ttl_s"]),
    )  # fmt: skip
    # Marked as a process of edgectl's, so that no ``detect`` takes it for a task; no task has this directory.
    name, _, value = life.cookie(folder).partition("=")
    try:
        # The first request to a host finds no place for its stamp.
        lease.renew(request["host"])
        said = launch.apart([], shell.environment({name: value}), order, lock, _REPORT_S)
    finally:
        os.close(lock)
    if said is None or "error" in said:
        raise RefusalError("start-failed", (said or {}).get("error") or "the profiler gave no sign of life", "try again")


def stop(request: dict) -> dict:
    """End the profiler; ``stopped`` is said only with proof."""
    was = _ended(state.checked_name(request["host"]))
    return {"state": "stopped" if was else "not-running", "pid": was[0] if was else 0}


def _ended(host: str) -> list:
    """The pids that were ended. Raises RefusalError where one does not go."""
    ended = []
    for folder in seat.folders(host):
        for name, patience_s in (("TERM", _GRACE_S), ("KILL", _KILL_S)):
            ended += _signalled(folder, name, patience_s)
        if ended:
            seat.leave(folder, "")
        if seat.is_taken(folder):
            left = ", ".join(str(pid) for pid, _ in seat.holders(folder)) or "unknown"
            raise RefusalError("stop-incomplete", "the profiler does not end (pid %s)" % left, "look at it on the host")
    return sorted(set(ended))


def _signalled(folder: str, name: str, patience_s: float) -> list:
    """Signal whoever holds the seat, and wait until nobody does."""
    if not seat.is_taken(folder):
        return []
    found = seat.holders(folder)
    for pid, ticks in found:
        signals.send(pid, ticks, signals.number(name))
        signals.send(pid, ticks, signals.number("CONT"))
    deadline = time.monotonic() + patience_s
    while seat.is_taken(folder) and time.monotonic() < deadline:
        time.sleep(_POLL_S)
    return [pid for pid, _ in found]


def status(request: dict) -> dict:
    """Operation ``profiler-status``; the wishes of the request say whether it measures what is wanted now."""
    return _described(state.checked_name(request["host"]), request)


def _described(host: str, request: dict) -> dict:
    sitter = seat.sitter(host)
    process = proc.process(sitter.pid) if sitter is not None else None
    if sitter is None or process is None:
        return {"state": "not-running", "pid": 0, "detail": seat.last_words(host)}
    known, number, sample = sitter.read()
    now, age = proc.uptime(), max(1e-3, proc.age(process.ticks))
    sample_age = now - sample["at"] if sample else None
    period = sample.get("period_s", known.get("every_s", 1.0))
    late = (age if sample_age is None else sample_age) > max(_MARGIN, latest.FRESH * period)
    return {
        "state": "stalled" if late else "running",
        "pid": sitter.pid,
        "age_s": round(age, 2),
        "every_s": known.get("every_s"),
        "period_s": period,
        "samples": number,
        "sample_age_s": None if sample_age is None else round(sample_age, 3),
        "used_cores": round((process.cpu + process.child_cpu) / age, 5),
        "used_bytes": process.rss,
        "ttl_s": known.get("ttl_s"),
        "ttl_left_s": round(known.get("ttl_s", 0.0) - (now - max(known.get("begun", now), lease.last(host))), 1),
        "current": known.get("wishes") == seat.wishes(request),
    }
