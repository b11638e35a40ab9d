"""One supervisor per task: starts it, pumps its log, restarts it by policy, records how it ended, reaps its whole tree.

It is forked from the agent, leaves the manager's session for good, and lives as long as its task or its wish to restart it.
"""

import os
import select
import signal
import time

from . import backoff, lease, life, metrics, proc, record, scope, shell, signals, spawn
from .logs import Log

_BLOCK = 65536
_READY_FIRST_S, _READY_SLOWEST_S, _READY_TRY_S = 0.3, 5.0, 10.0
# (signal, ``main`` or ``tree``, seconds): for what an ended command leaves behind.
_LEFTOVERS = (("TERM", "tree", 5.0),)
_KILL = ("KILL", "tree", 10.0)
# A machine that slept wakes with this timer where it stood, but with an older lease.
_LEASE_LOOK_S = 2.0


class Supervisor:
    """The loop that keeps one task as its spec wants it."""

    def __init__(self, folder: str, lock: int, report: int, identity: dict, spec: dict, why: str) -> None:
        """``why``: what keeps the limits from being enforced; empty in a scope."""
        self.folder, self.lock, self.report, self.spec = folder, lock, report, spec
        self.identity = identity
        self.log = Log(folder, int(spec["log"]["max_bytes"]), int(spec["log"]["files"]))
        self.env = shell.environment(spec.get("env"))
        self.env["EDGECTL_INSTANCE"] = identity["instance"]
        name, _, value = life.cookie(folder).partition("=")
        self.env[name] = value
        self.env["EDGECTL_METRICS"] = metrics.file(folder)
        self.pid, self.ticks, self.pipe, self.started = 0, 0, -1, 0.0
        self.status = {
            "instance": identity["instance"],
            "state": "starting",
            "restarts": 0,
            "exit_code": None,
            "last_exit": None,
        }
        self.status.update(detail="", limits=scope.verdict(spec.get("limits"), why))
        self.history, self.stopping, self.next_start, self.code = [], False, None, 0
        self.fence_s, self.begun, self.next_look = float(spec.get("self_fence_s") or 0.0), proc.uptime(), 0.0
        self.check, self.next_check, self.check_every = None, None, _READY_FIRST_S
        self.next_metrics = 0.0
        self.wake, self._wake_end = os.pipe()

    def run(self) -> None:
        """Until the task has ended for good."""
        metrics.begin(self.folder)
        me = proc.process(os.getpid())
        identity = dict(self.identity, supervisor=me.pid, supervisor_ticks=me.ticks)
        record.write(os.path.join(self.folder, "instance"), identity, durable=True)
        self._listen()
        self._spawn()
        spawn.tell(self.report, {"pid": self.pid, "limits": self.status["limits"]})
        while self.pid or self.next_start is not None:
            self._turn()
        metrics.bounded(self.folder)

    def _listen(self) -> None:
        for fd in (self.wake, self._wake_end):
            os.set_blocking(fd, False)
        signal.set_wakeup_fd(self._wake_end)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGTERM, self._stop_asked)

    def _stop_asked(self, *_signal) -> None:
        self.stopping = True

    def _note(self, **changes) -> None:
        """Rewrite the status in place; a file system that refuses must not disturb the task."""
        self.status.update(changes, dropped=self.log.dropped)
        final = self.status["state"] in life.FINAL
        if final:
            self.status["ended"] = round(proc.uptime(), 2)
        try:
            record.write(os.path.join(self.folder, "status"), self.status, durable=final)
        except (OSError, ValueError):
            pass

    def _spawn(self) -> None:
        self.next_start = None
        argv = shell.argv(self.spec["command"], self.spec.get("prelude") or "")
        self.pid, self.pipe = spawn.spawn(argv, self.env, self.spec.get("workdir"), self.lock)
        self.ticks, self.started = proc.process(self.pid).ticks, time.monotonic()
        ready = self.spec.get("ready")
        self.next_check, self.check_every = (self.started, _READY_FIRST_S) if ready else (None, 0.0)
        self._note(
            state="starting" if ready else "running",
            pid=self.pid,
            ticks=self.ticks,
            exit_code=None,
            detail="",
        )

    def _turn(self) -> None:
        """Wait for the next thing to do, and do it."""
        poll = select.poll()
        poll.register(self.wake, select.POLLIN)
        if self.pipe >= 0:
            poll.register(self.pipe, select.POLLIN)
        for fd, _ in poll.poll(self._patience_ms()):
            if fd == self.pipe:
                self._pump()
            else:
                _drain(fd)
        self._watch_ready()
        ended = self._reap()
        if ended is not None:
            self._ended(ended)
        due = self.next_start is not None and time.monotonic() >= self.next_start
        if self.fence_s and (due or time.monotonic() >= self.next_look):
            self._watch_lease()  # before a restart: a host that stood still may have lost its task to another
        if self.next_start is not None and self.stopping:
            self.next_start = None
            self._note(state="stopped", pid=0, detail="")
        elif self.next_start is not None and due:
            self._restart()
        self._watch_metrics()

    def _patience_ms(self) -> float:
        now = time.monotonic()
        times = [self.next_metrics - now]
        if self.fence_s:
            times.append(self.next_look - now)
        if self.next_start is not None:
            times.append(self.next_start - now)
        if self.check is not None:
            times.append(min(0.5, self.check.deadline - now))
        elif self.next_check is not None:
            times.append(self.next_check - now)
        return max(0.0, min(times)) * 1000.0 + 1.0

    def _watch_metrics(self) -> None:
        if time.monotonic() >= self.next_metrics:
            self.next_metrics = time.monotonic() + metrics.bounded(self.folder)

    def _pump(self) -> None:
        data = os.read(self.pipe, _BLOCK)
        if data:
            return self.log.write(data)
        os.close(self.pipe)
        self.pipe = -1
        return None

    def _watch_ready(self) -> None:
        """Poll the ready check until it succeeds once."""
        if self.check is not None:
            result = self.check.poll()
            if result is None:
                return
            self.check = None
            if result["exit"] == 0 and self.pid:
                self.next_check = None
                self._note(state="ready", detail="")
        elif self.next_check is not None and self.pid and time.monotonic() >= self.next_check:
            ready = self.spec["ready"]
            limit = min(_READY_TRY_S, float(ready.get("timeout_s") or _READY_TRY_S))
            self.next_check = time.monotonic() + self.check_every
            self.check_every = min(_READY_SLOWEST_S, self.check_every * 1.5)
            prelude, folder = (
                self.spec.get("prelude") or "",
                spawn.working_dir(self.spec.get("workdir"), self.env),
            )
            self.check = shell.Command(ready["command"], prelude, self.env, limit, folder)

    def _reap(self):
        """Collect every child that ended; the wait status of the main process where it is among them."""
        ended = None
        while True:
            try:
                seen = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            except ChildProcessError:
                return ended
            if seen is None or (self.check is not None and seen.si_pid == self.check.process.pid):
                return ended
            pid, code = os.waitpid(seen.si_pid, 0)
            if pid == self.pid:
                self.code = ended = code

    def _ended(self, code: int) -> None:
        """The main process has ended: clear its leftovers, then restart it or record the end."""
        ran_s, self.pid = time.monotonic() - self.started, 0
        self._cancel_check()
        left = self._end_tree(_LEFTOVERS)
        outcome = spawn.outcome(code)
        self.status["last_exit"] = outcome["exit_code"]
        if self.stopping:
            return self._note(state="stopped", pid=0, left=left, **outcome)
        if left:
            return self._note(
                state="failed",
                pid=0,
                left=left,
                exit_code=outcome["exit_code"],
                detail="processes cannot be stopped: %s" % left,
            )
        clean = code == 0
        if clean and self.spec.get("kind") == "job":
            return self._note(state="completed", pid=0, **outcome)
        policy = self.spec.get("restart", "on-failure")
        if policy == "never" or (policy == "on-failure" and clean):
            return self._note(state="failed", pid=0, given_up=policy == "never", **outcome)
        return self._plan_restart(ran_s, outcome)

    def _cancel_check(self) -> None:
        self.next_check = None
        if self.check is not None:
            self.check.end()
            self.check = None

    def _plan_restart(self, ran_s: float, outcome: dict) -> None:
        now = time.monotonic()
        self.history = backoff.kept(self.history, ran_s)
        pause = backoff.delay(self.history, now, _jitter())
        if pause is None:
            detail = "%s; %d restarts in 10 minutes" % (outcome["detail"], backoff.MOST)
            return self._note(
                state="crashloop", pid=0, given_up=True, exit_code=outcome["exit_code"], detail=detail
            )
        self.next_start = now + pause
        detail = "%s; starts again in %.1f s" % (outcome["detail"], pause)
        return self._note(state="starting", pid=0, exit_code=outcome["exit_code"], detail=detail)

    def _restart(self) -> None:
        self.history.append(time.monotonic())
        self.status["restarts"] += 1
        metrics.begin(self.folder)
        try:
            self._spawn()
        except OSError as error:
            self.next_start = None
            self._note(state="failed", pid=0, detail=str(error))

    def _watch_lease(self) -> None:
        """Stop for good where no manager was heard of for too long: it may have started the task elsewhere."""
        left_s = self.fence_s - (proc.uptime() - max(self.begun, lease.last(self.identity["host"])))
        self.next_look = time.monotonic() + min(_LEASE_LOOK_S, left_s)
        if left_s > 0 or not (self.pid or self.next_start is not None):
            return
        from .stop import steps

        self._cancel_check()
        left = self._end_tree(steps(self.spec.get("stop") or {}), forced=True)
        outcome = spawn.outcome(self.code) if self.pid else {"exit_code": self.status["exit_code"]}
        self.pid, self.next_start = 0, None
        detail = "fenced: no manager call for %g s" % self.fence_s + (
            ", but processes cannot be stopped: %s" % left if left else ""
        )
        state = "stopped" if self.stopping else "failed"
        self._note(
            state=state,
            pid=0,
            left=left,
            exit_code=outcome["exit_code"],
            last_exit=outcome["exit_code"],
            detail=detail,
        )

    def _end_tree(self, steps: tuple, *, forced: bool = False) -> list:
        """Signal all below this process, step by step and then with KILL, until nothing is left; pids that would not go.

        While a stop is under way the agent that asked for it sends the signals, unless ``forced``; here they are only awaited.
        """
        steps, sent, since = [*steps, _KILL], set(), time.monotonic()
        while True:
            self._reap()
            table = proc.processes()
            left = proc.descendants({os.getpid()}, table) - {os.getpid()}
            if not left:
                break
            if forced or not self.stopping:
                if time.monotonic() - since > steps[0][2]:
                    since = time.monotonic()
                    del steps[0]
                if not steps:
                    break
                sent |= self._signal(steps[0], left, table, sent)
            self._watch_metrics()
            self._await(0.05)
        self._await(0.0)
        if self.pipe >= 0:
            os.close(self.pipe)
            self.pipe = -1
        return sorted(left)

    def _signal(self, step: tuple, left: set, table: dict, sent: set) -> set:
        """Carry out one step on what is left; the main process gets its signal once, newcomers of the tree get it too."""
        if step[1] == "main":
            from .stop import main_process

            left = set() if sent else {main_process(self.pid, table)} & left
        return signals.send_each(
            [(pid, table[pid].ticks) for pid in sorted(left)], signals.number(step[0]), sent
        )

    def _await(self, seconds: float) -> None:
        """Pump the log for a moment."""
        deadline = time.monotonic() + seconds
        while self.pipe >= 0 and select.select([self.pipe], [], [], max(0.0, deadline - time.monotonic()))[0]:
            self._pump()
        time.sleep(max(0.0, deadline - time.monotonic()))


def _jitter() -> float:
    """Uniform in -1..1, without module random, which takes memory in every supervisor."""
    return int.from_bytes(os.urandom(4), "little") / 0x7FFFFFFF - 1.0


def _drain(fd: int) -> None:
    try:
        while os.read(fd, 4096):
            pass
    except BlockingIOError:
        pass
