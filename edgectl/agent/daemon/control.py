# SPDX-License-Identifier: Apache-2.0
"""Operations ``profiler-start``, ``profiler-stop`` and ``profiler-status``: at most one resident profiler per
host.
"""

import os
import time

from ..link import heartbeat, protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import proc
from ..supervise import launch, liveness, lockfile, logind, shell, signals, state_dir
from . import pidfile, reader
from .pidfile import ProfilerProcess

_TRIES = 5
_REPORT_S, _GRACE_S, _KILL_S = 10.0, 2.0, 5.0
# Longer than the wait of the agent that starts one, which holds the lock meanwhile.
_SETTLE_S, _POLL_S = 15.0, 0.02
_MARGIN = 1.5


def start_profiler(request: Document) -> Document:
    """Start the profiler; one with the same probe spec and settings is kept, any other is replaced."""
    host = state_dir.check_name(request["host"])
    logind.check_survives_logout()
    state = protocol.STARTED
    for _ in range(_TRIES):
        profiler, taken = _wait_for_profiler(host)
        if profiler is not None and _is_as_requested(profiler, request):
            return dict(_build_profiler_status(host, request), state=protocol.ALREADY_RUNNING)
        if taken:
            _end_profiler(host, profiler)
            state = protocol.REPLACED
        folder = pidfile.make_folder(host)
        lock = lockfile.take_lock(folder)
        if lock >= 0 and _launch_profiler(folder, lock, request):
            return dict(_build_profiler_status(host, request), state=state)
    raise RefusalError(
        "start-failed",
        "the profiler does not keep running: it fails, or other managers replace it",
        "edgectl profilers status",
    )


def _wait_for_profiler(host: str) -> "tuple[ProfilerProcess | None, bool]":
    """Wait for (the living profiler or None, whether the lock is taken) until a starting one has recorded its
    identity.

    A free lock may be taken in a moment, by an agent that starts a profiler: only one that was seen here may
    be ended.
    """
    deadline = time.monotonic() + _SETTLE_S
    while True:
        profiler = pidfile.find_profiler(host)
        if profiler is not None and profiler.read()[0]:
            return profiler, True
        if not any(pidfile.is_locked(folder) for folder in pidfile.list_folders(host)):
            return None, False
        if time.monotonic() >= deadline:
            return profiler, True
        time.sleep(_POLL_S)


def _is_as_requested(profiler: ProfilerProcess, request: Document) -> bool:
    known = profiler.read()[0]
    return (known.get("probe_spec"), known.get("every_s"), known.get("ttl_s")) == (
        pidfile.build_probe_spec(request),
        float(request["every_s"]),
        float(request["ttl_s"]),
    )


def _launch_profiler(folder: str, lock: int, request: Document) -> bool:
    """Launch; whether the profiler has reported, which another start may prevent by replacing it.

    Raises RefusalError.
    """
    order = dict(
        request,
        op=protocol.OP_PROFILER_RUN,
        folder=folder,
        lock=lock,
        probe_spec=pidfile.build_probe_spec(request),
        every_s=float(request["every_s"]),
        ttl_s=float(request["ttl_s"]),
    )
    # The cookie keeps ``detect`` from matching the profiler; no task has this directory.
    name, _, value = liveness.build_cookie(folder).partition("=")
    try:
        # The first request to a host has no directory for its heartbeat yet.
        heartbeat.record_heartbeat(request["host"])
        report = launch.launch_agent([], shell.build_environment({name: value}), order, lock, _REPORT_S)
    finally:
        os.close(lock)
    if report and "error" in report:
        raise RefusalError("start-failed", report["error"], "try again")
    return report is not None


def stop_profiler(request: Document) -> Document:
    """End the profiler; ``stopped`` is replied only with proof."""
    host = state_dir.check_name(request["host"])
    profiler, taken = _wait_for_profiler(host)
    if not taken:
        return {"state": protocol.NOT_RUNNING, "pid": 0}
    ended = _end_profiler(host, profiler)
    return {"state": protocol.STOPPED, "pid": ended[0] if ended else 0}


def _end_profiler(host: str, profiler: "ProfilerProcess | None") -> "list[int]":
    """End the profiler that was seen, with proof; returns its pids.

    Without an identity, the holders of the lock are ended.

    Raises:
        RefusalError: it does not end.
    """
    seen = (
        [(profiler.pid, profiler.ticks)]
        if profiler is not None
        else [each for folder in pidfile.list_folders(host) for each in pidfile.find_holders(folder)]
    )
    for name, patience_s in (("TERM", _GRACE_S), ("KILL", _KILL_S)):
        for pid, ticks in seen:
            signals.send_signal(pid, ticks, signals.parse_signal(name))
            signals.send_signal(pid, ticks, signals.parse_signal("CONT"))
        deadline = time.monotonic() + patience_s
        while any(proc.is_process_alive(*each) for each in seen) and time.monotonic() < deadline:
            time.sleep(_POLL_S)
    left = ", ".join(str(pid) for pid, ticks in seen if proc.is_process_alive(pid, ticks))
    if left:
        raise RefusalError(
            protocol.STOP_INCOMPLETE,
            "the profiler does not end (pid %s)" % left,
            "check the process on the host",
        )
    return [pid for pid, _ in seen]


def report_profiler(request: Document) -> Document:
    """Operation ``profiler-status``; ``current`` compares its probe spec with that of the request."""
    return _build_profiler_status(state_dir.check_name(request["host"]), request)


def _build_profiler_status(host: str, request: Document) -> Document:
    profiler = pidfile.find_profiler(host)
    process = proc.read_process(profiler.pid) if profiler is not None else None
    if profiler is None or process is None:
        return {"state": protocol.NOT_RUNNING, "pid": 0, "detail": pidfile.read_end_reason(host)}
    known, number, sample = profiler.read()
    now, age = proc.read_uptime_s(), max(1e-3, proc.age_s_from_ticks(process.ticks))
    sample_age = now - sample["at"] if sample else None
    period: float = sample["period_s"] if sample else known.get("every_s", 1.0)
    late = (age if sample_age is None else sample_age) > max(_MARGIN, reader.MAX_AGE_PERIODS * period)
    return {
        "state": protocol.STALLED if late else protocol.RUNNING,
        "pid": profiler.pid,
        "age_s": round(age, 2),
        "every_s": known.get("every_s"),
        "period_s": period,
        "samples": number,
        "sample_age_s": None if sample_age is None else round(sample_age, 3),
        "used_cores": round((process.cpu + process.child_cpu) / age, 5),
        "used_bytes": process.rss,
        "ttl_s": known.get("ttl_s"),
        "ttl_left_s": round(
            known.get("ttl_s", 0.0)
            - (now - max(known.get("begun", now), heartbeat.read_last_heartbeat(host))),
            1,
        ),
        "current": known.get("probe_spec") == pidfile.build_probe_spec(request),
    }
