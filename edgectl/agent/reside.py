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
        sitter, taken = _settled(host)
        if sitter is not None and _is_same(sitter, request):
            return dict(_described(host, request), state="already-running")
        if taken:
            _end(host, sitter)
            state_word = "replaced"
        folder = seat.make(host)
        lock = take_lock(folder)
        if lock >= 0 and _launch(folder, lock, request):
            return dict(_described(host, request), state=state_word)
    raise RefusalError(
        "start-failed",
        "the profiler does not stay: it fails, or others replace it all the time",
        "edgectl profilers status",
    )


def _settled(host: str) -> tuple:
    """(the profiler that lives or None, whether the seat is taken); where one is only being started, after it has said who it is.

    What is free now may be taken in a moment, by an agent that starts one: only what was seen here may be ended.
    """
    deadline = time.monotonic() + _SETTLE_S
    while True:
        sitter = seat.sitter(host)
        if sitter is not None and sitter.read()[0]:
            return sitter, True
        if not any(seat.is_taken(folder) for folder in seat.folders(host)):
            return None, False
        if time.monotonic() >= deadline:
            return sitter, True
        time.sleep(_POLL_S)


def _is_same(sitter, request: dict) -> bool:
    known = sitter.read()[0]
    return (known.get("wishes"), known.get("every_s"), known.get("ttl_s")) == (
        seat.wishes(request),
        float(request["every_s"]),
        float(request["ttl_s"]),
    )


def _launch(folder: str, lock: int, request: dict) -> bool:
    """Whether the profiler has said that it lives; it may be replaced before it can. Raises RefusalError."""
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
    if said and "error" in said:
        raise RefusalError("start-failed", said["error"], "try again")
    return said is not None


def stop(request: dict) -> dict:
    """End the profiler; ``stopped`` is said only with proof."""
    host = state.checked_name(request["host"])
    sitter, taken = _settled(host)
    if not taken:
        return {"state": "not-running", "pid": 0}
    ended = _end(host, sitter)
    return {"state": "stopped", "pid": ended[0] if ended else 0}


def _end(host: str, sitter) -> list:
    """End what was seen, and see that it is gone; its pids. One that never said who it is, is whoever holds the lock.

    Raises:
        RefusalError: it does not go.
    """
    seen = (
        [(sitter.pid, sitter.ticks)]
        if sitter is not None
        else [each for folder in seat.folders(host) for each in seat.holders(folder)]
    )
    for name, patience_s in (("TERM", _GRACE_S), ("KILL", _KILL_S)):
        for pid, ticks in seen:
            signals.send(pid, ticks, signals.number(name))
            signals.send(pid, ticks, signals.number("CONT"))
        deadline = time.monotonic() + patience_s
        while any(proc.is_alive(*each) for each in seen) and time.monotonic() < deadline:
            time.sleep(_POLL_S)
    left = ", ".join(str(pid) for pid, ticks in seen if proc.is_alive(pid, ticks))
    if left:
        raise RefusalError(
            "stop-incomplete", "the profiler does not end (pid %s)" % left, "look at it on the host"
        )
    return [pid for pid, _ in seen]


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
        "ttl_left_s": round(
            known.get("ttl_s", 0.0) - (now - max(known.get("begun", now), lease.last(host))), 1
        ),
        "current": known.get("wishes") == seat.wishes(request),
    }
