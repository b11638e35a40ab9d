"""Operation ``stop``: the whole process tree, gently and then not, until the kernel proves that nothing is left."""

import os
import time

from . import life, proc, record, shell, signals, start, state, status

_DEFAULT_GRACE_S = 20.0
# roslaunch gives its nodes 15 s after INT and 2 s after TERM, each in a session of its own.
_ROS = (("INT", "main", 20.0), ("TERM", "tree", 5.0))
_KILL_S = 10.0
_LET_GO_S = 5.0
_SWEEP_S = 0.05
_EMPTY_SWEEPS = 2


def stop(request: dict) -> dict:
    """Stop one instance, or whatever lives where ``instance`` is null. ``stopped`` is said only with proof."""
    began = time.monotonic()
    host, task = state.checked_name(request["host"]), state.checked_name(request["task"])
    if request.get("generation") is not None:
        start.check_generation(host, task, int(request["generation"]))
    alive = [trace for trace in life.traces(host, task) if life.is_alive(trace)]
    wanted = [trace for trace in alive if request.get("instance") in (None, trace.instance.get("instance"))]
    if not wanted:
        _forget_failure(host, task)
        return _reply("not-running", [], began)
    left = [pid for trace in wanted for pid in _stopped(trace, request)]
    return _reply("stop-incomplete" if left else "stopped", left, began)


def _reply(word: str, left: list, began: float) -> dict:
    return {"state": word, "left": sorted(left), "seconds": round(time.monotonic() - began, 3)}


def _forget_failure(host: str, task: str) -> None:
    """A task that failed and is told to stop is stopped: its failure is no longer news."""
    trace, alive = status.current(host, task)
    if trace is not None and not alive and trace.status.get("state") in ("failed", "crashloop"):
        _note_stopped(trace)


def _note_stopped(trace) -> None:
    now = life.trace(trace.folder)
    if now.status.get("state") not in ("stopped", "completed"):
        document = dict(now.status, instance=now.instance.get("instance"), state="stopped", pid=0, left=[])
        record.write(os.path.join(trace.folder, "status"), document)


def _stopped(trace, request: dict) -> list:
    """Stop one instance; the pids that are left."""
    if request.get("generation") is not None:
        record.write(
            os.path.join(trace.folder, "generation"), {"generation": int(request["generation"])}, durable=True
        )
    settings = request.get("stop") or trace.instance.get("stop") or {}
    tell_supervisor(trace)
    for name, scope, grace_s in steps(settings):
        if _signalled(trace, signals.number(name), scope, grace_s):
            break
    _signalled(trace, signals.number("KILL"), "tree", _KILL_S)
    left = _proof(trace)
    if not left:
        _note_stopped(trace)
    return left


def steps(settings: dict) -> tuple:
    """(signal, ``main`` or ``tree``, seconds of grace) in order, before KILL."""
    if settings.get("preset") == "ros":
        return _ROS
    grace_s = settings.get("grace_s")
    return (
        (settings.get("signal") or "TERM", "tree", _DEFAULT_GRACE_S if grace_s is None else float(grace_s)),
    )


def tell_supervisor(trace) -> None:
    """No more restarts from here on; the supervisor stays to reap the tree."""
    above = life.supervisor(trace)
    if above:
        ticks = trace.instance["supervisor_ticks"]
        signals.send(above, ticks, signals.number("TERM"))
        signals.send(above, ticks, signals.number("CONT"))


def _signalled(trace, number: int, scope: str, patience_s: float) -> bool:
    """Signal, then sweep until two sweeps in a row find nothing; newcomers get the signal too. False where patience ran out."""
    deadline, empty, sent = time.monotonic() + patience_s, 0, set()
    while empty < _EMPTY_SWEEPS:
        table = proc.processes()
        trace = life.trace(trace.folder)
        pids = life.members(trace, table)
        empty = 0 if pids else empty + 1
        targets = pids if scope == "tree" else {main_process(trace.status.get("pid", 0), table)} & pids
        if scope == "tree" or not sent:
            sent |= signals.send_each([(pid, table[pid].ticks) for pid in sorted(targets)], number, sent)
        if pids and time.monotonic() >= deadline:
            return False
        time.sleep(_SWEEP_S)
    return True


def main_process(pid: int, table: dict) -> int:
    """The command itself: where our shell ``pid`` only waits for it, the shell's one child, since a shell keeps INT to itself."""
    below = proc.children(table)
    while pid in table and proc.cmdline(pid)[:2] == shell.argv("", "")[:2] and len(below.get(pid, ())) == 1:
        pid = below[pid][0]
    return pid


def _proof(trace) -> list:
    """Empty where the lock is free and no process carries cookie or lock; else the pids that are left."""
    deadline = time.monotonic() + _LET_GO_S
    while time.monotonic() < deadline:
        found = life.trace(trace.folder)
        above = life.supervisor(found)
        left = life.members(found, proc.processes())
        if not above and not left and not found.held:
            return []
        time.sleep(_SWEEP_S)
    if above and not left:
        # Its tree is gone but the supervisor does not let go: it is ours, and of no more use.
        signals.send(above, trace.instance["supervisor_ticks"], signals.number("KILL"))
        time.sleep(2 * _SWEEP_S)
        found = life.trace(trace.folder)
        above, left = life.supervisor(found), life.members(found, proc.processes())
    return sorted(left | ({above} if above else set())) or ([0] if life.lock_held(trace.folder) else [])
