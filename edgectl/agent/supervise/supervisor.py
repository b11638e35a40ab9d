# SPDX-License-Identifier: Apache-2.0
"""Supervisor of one task: starts it, writes its log, restarts it by policy, records its end, reaps its whole
tree.

Forked from the agent, it leaves the manager's session for good and lives as long as its task or a pending
restart.
"""

import _signal as signal
import os
import select
import time

from ..link import fast_json, heartbeat, protocol
from ..link.fast_json import Document
from ..measure import metrics, proc
from . import liveness, records, restart_policy, scope, shell, signals, spawn
from .checks import TaskChecks
from .command import Command, MetricsKeeper
from .logfile import LogWriter
from .nodes import NodeWatch
from .successor import is_leaving

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Sequence

# (signal, ``main`` or ``tree``, seconds) for the leftovers of an ended command.
_LEFTOVERS = (("TERM", "tree", 5.0),)
# A short interval: this timer stands still while a machine is suspended, the age of the heartbeat does not.
_HEARTBEAT_CHECK_S = 2.0
# The end of a process that is no child is not signalled.
_ADOPTED_CHECK_S = 0.5
_ADOPTED = "adopted: its first supervisor was lost; no log until it restarts"


class Supervisor:
    """The loop that runs one task according to its spec."""

    def __init__(
        self,
        folder: str,
        lock: int,
        report: int,
        identity: Document,
        spec: Document,
        why: str,
        orphan: "Document | None" = None,
    ) -> None:
        """``why``: the reason that limits are not enforced; empty in a scope. ``orphan``: the status of a
        living task that lost its supervisor and is taken over; ``lock`` is -1 while that task holds it.
        """
        self.folder, self.report, self.spec, self.identity = folder, report, spec, identity
        self.log = LogWriter(folder, int(spec["log"]["max_bytes"]), int(spec["log"]["files"]))
        self.env = shell.build_environment(spec.get("env"))
        self.env["EDGECTL_INSTANCE"] = identity["instance"]
        name, _, value = liveness.build_cookie(folder).partition("=")
        self.env[name] = value
        self.env["EDGECTL_METRICS"] = metrics.get_metrics_path(folder)
        self.command = self._choose_command(lock)
        self.status: Document = {
            "instance": identity["instance"],
            "state": protocol.STARTING,
            "restarts": 0,
            "exit_code": None,
            "last_exit": None,
        }
        self.status.update(detail="", limits=self._describe_limits(why))
        self.history: "list[float]" = []
        self.next_start: "float | None" = None
        self.stopping = False
        self.fence_s, self.begun, self.next_look = (
            float(spec.get("self_fence_s") or 0.0),
            proc.read_uptime_s(),
            0.0,
        )
        self.checks = TaskChecks(folder, identity["instance"], spec, self.env, self.command.find_main_process)
        self.nodes = NodeWatch(folder, spec, self.env)
        self.metrics = MetricsKeeper(folder, identity["instance"])
        self.wake, self._wake_end = os.pipe()
        if orphan is not None:
            self._take_over(orphan)

    def _choose_command(self, lock: int) -> Command:
        """The command of the task, or its container, whose name its checks are given."""
        if not self.spec.get("image"):
            return Command(self.folder, lock, self.log)
        from ..containers.command import ContainerCommand
        from ..containers.create import NAME_VARIABLE, build_container_name

        names = (self.identity[name] for name in ("fleet", "host", "task"))
        self.env[NAME_VARIABLE] = build_container_name(*names)
        return ContainerCommand(self.folder, lock, self.log, self.identity, self.spec)

    def _describe_limits(self, why: str) -> str:
        limits = self.spec.get("limits")
        if not self.spec.get("image"):
            return scope.describe_limits(limits, why)
        # The engine refuses to start a container whose limits it cannot set.
        return "enforced" if any((limits or {}).values()) else ""

    def run(self) -> None:
        """Run until the task has ended for good."""
        me = proc.read_own_process()
        identity = dict(self.identity, supervisor=me.pid, supervisor_ticks=me.ticks)
        if self.command.adopted or self.command.resumed:
            identity.update({"adopted": True} if self.command.adopted else {})
            records.write_record(os.path.join(self.folder, "instance"), identity, durable=True)
            self._install_handlers()
            self.nodes.begin()
            self._record_status()
        else:
            metrics.reset_metrics_file(self.folder)
            records.write_record(os.path.join(self.folder, "instance"), identity, durable=True)
            self._install_handlers()
            self._start_command()
        fast_json.send_document(
            self.report, {"pid": self.command.get_main()[0], "limits": self.status["limits"]}
        )
        while self.command.pid or self.next_start is not None:
            self._run_once()
        self.nodes.end(remove=not self.stopping)
        self.metrics.check()

    def _take_over(self, status: Document) -> None:
        """Continue from the status of an orphan."""
        self.command.take_over(status)
        self.env.update(self.command.get_variables())
        self.status.update(status, detail=_ADOPTED if self.command.adopted else "")
        self.checks.adopt(*self.command.get_main(), status)

    def _install_handlers(self) -> None:
        for fd in (self.wake, self._wake_end):
            os.set_blocking(fd, False)
        signal.set_wakeup_fd(self._wake_end)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGTERM, self._handle_stop)

    def _handle_stop(self, *_signal: object) -> None:
        self.stopping = True

    def _record_status(self, **changes: object) -> None:
        """Rewrite the status in place; a file system that refuses must not disturb the task."""
        self.status.update(changes, dropped=self.log.dropped)
        final = self.status["state"] in protocol.FINAL_STATES
        if final:
            times = os.times()
            self.status.update(
                ended=round(proc.read_uptime_s(), 2),
                # Its own work is not the task's; it has reaped all processes of the task.
                cpu_s=round(times.children_user + times.children_system, 3),
            )
        try:
            records.write_record(os.path.join(self.folder, "status"), self.status, durable=final)
        except (OSError, ValueError):
            pass

    def _start_command(self) -> None:
        self.next_start = None
        self.command.start(self.spec, self.env)
        if not self.command.waits:
            return self._begin_run()
        self._record_status(state=protocol.STARTING, pid=0, detail="")
        return self._hear_runner()

    def _begin_run(self) -> None:
        """Begin the checks of what was just started, and record it."""
        self.env.update(self.command.get_variables())
        self.nodes.begin()
        pid, ticks = self.command.get_main()
        self._record_status(pid=pid, ticks=ticks, exit_code=None, detail="", **self.checks.begin(pid, ticks))

    def _hear_runner(self) -> None:
        """Record what the runner of a container has to say."""
        for note in self.command.read_notes():
            if note["event"] == "started" and not self.status["pid"]:
                self._begin_run()
            elif note["event"] in ("lost", "back"):
                from ..containers.command import describe_loss

                detail = describe_loss(note) if note["event"] == "lost" else ""
                said = detail or "the container engine answers again"
                self.log.write(("edgectl: %s\n" % said).encode())
                self._record_status(detail=detail)

    def _await_event(self) -> None:
        """Wait for output, a signal or the time of a check; take in what there is to read."""
        poll = select.poll()
        poll.register(self.wake, select.POLLIN)
        if self.command.pipe >= 0:
            poll.register(self.command.pipe, select.POLLIN)
        if self.command.notes >= 0:
            poll.register(self.command.notes, select.POLLIN)
        for fd, _ in poll.poll(self._compute_poll_ms()):
            if fd == self.command.pipe:
                self.command.copy_output()
            elif fd != self.wake:
                self._hear_runner()
            else:
                _drain_fd(fd)
                self.checks.activation.look()

    def _run_once(self) -> None:
        """Wait for the next event and handle it."""
        self._await_event()
        # Before the children are reaped: the process of a check that has ended stands in their way.
        self._ask_checks()
        if self._is_watched():
            self.nodes.poll()
        ended = self.command.reap(self.checks.owns_process)
        if ended is not None:
            self._handle_end(ended)
        due = self.next_start is not None and time.monotonic() >= self.next_start
        if self.fence_s and (due or time.monotonic() >= self.next_look):
            # Before a restart: during a suspension another host may have taken over the task.
            self._check_heartbeat()
        if self.next_start is not None and self.stopping:
            self.next_start = None
            self._record_status(state=protocol.STOPPED, pid=0, detail="")
        elif self.next_start is not None and due:
            self._restart()
        self.metrics.check_if_due()

    def _compute_poll_ms(self) -> float:
        now = time.monotonic()
        times = [self.metrics.next_check - now]
        if self.command.adopted and self.command.pid:
            times.append(_ADOPTED_CHECK_S)
        if self.fence_s:
            times.append(self.next_look - now)
        if self.next_start is not None:
            times.append(self.next_start - now)
        checks = (
            self.checks.compute_wait_s(now),
            self.nodes.compute_wait_s(now) if self._is_watched() else None,
        )
        times.extend(each for each in checks if each is not None)
        return max(0.0, min(times)) * 1000.0 + 1.0

    def _is_watched(self) -> bool:
        """Whether a command runs that nobody ends."""
        return bool(self.command.pid) and not self.stopping

    def _ask_checks(self) -> None:
        """Record what the checks have learnt; restart a task that has failed by them."""
        if self._is_watched():
            changes, fault = self.checks.follow_role(self.status, self._may_activate)
            if fault:
                self._give_up(fault)
            elif changes:
                self._record_status(**changes)
        changes = self.checks.ask_readiness(self.status)
        if changes:
            self._record_status(**changes)
        if self.stopping:
            self.checks.cancel_health()
        elif self.command.pid:
            changes, fault = self.checks.ask_health(self.status, self._is_leaving)
            if changes:
                self._record_status(**changes)
            if fault:
                self._restart_faulty(fault)

    def _may_activate(self) -> bool:
        return not self.fence_s or self._compute_fence_left_s() > 0

    def _give_up(self, fault: str) -> None:
        """Treat a process that cannot be activated as one that has failed, by the rules of a crash."""
        if self.spec.get("restart", "on-failure") != "never":
            return self._restart_faulty(fault)
        left, outcome = self._end_faulty(fault)
        state = protocol.STOPPED if self.stopping else protocol.FAILED
        return self._record_status(state=state, pid=0, left=left, given_up=True, **outcome)

    def _restart_faulty(self, fault: str) -> None:
        self.log.write(("edgectl: %s; restarting\n" % fault).encode("utf-8", "replace"))
        ran_s = time.monotonic() - self.command.started
        left, outcome = self._end_faulty(fault)
        if self.stopping or left:
            state = protocol.FAILED if left else protocol.STOPPED
            return self._record_status(state=state, pid=0, left=left, **outcome)
        return self._schedule_restart(ran_s, outcome)

    def _end_faulty(self, fault: str) -> "tuple[list[int], Document]":
        """End the task as a stop does; the remaining pids, and the exit with ``fault`` as its detail."""
        self.checks.cancel()
        left = self._end_tree(signals.list_stop_steps(self.spec.get("stop") or {}), forced=True)
        outcome = dict(spawn.describe_exit(self.command.code), detail=fault)
        self.command.pid, self.status["last_exit"] = 0, outcome["exit_code"]
        return left, outcome

    def _handle_end(self, code: int) -> None:
        """Handle the end of the main process: clear its leftovers, then restart it or record the end."""
        ran_s, self.command.pid = time.monotonic() - self.command.started, 0
        self.checks.cancel()
        left = self._end_tree(_LEFTOVERS)
        outcome = self.command.describe_end(code)
        self.status["last_exit"] = outcome["exit_code"]
        stopped = self.stopping or (not left and self._is_leaving())
        interrupted = self.command.interrupted and not stopped
        if interrupted:
            outcome["detail"] = "asked to end by its engine, or by someone through it"
        final = restart_policy.decide_end(self.spec, outcome, left, stopped, interrupted)
        if final is None:
            self._schedule_restart(ran_s, outcome)
        else:
            self._record_status(pid=0, **final)

    def _is_leaving(self) -> bool:
        """Whether a successor starts elsewhere: it may well have thrown this one out of the ROS graph."""
        return is_leaving(self.folder, self.identity["instance"])

    def _schedule_restart(self, ran_s: float, outcome: Document) -> None:
        now = time.monotonic()
        self.history = restart_policy.select_history(self.history, ran_s)
        pause = restart_policy.compute_delay(self.history, now, _draw_jitter())
        if pause is None:
            detail = "%s; %d restarts in 10 minutes" % (outcome["detail"], restart_policy.MAX_RESTARTS)
            return self._record_status(
                state=protocol.CRASHLOOP, pid=0, given_up=True, exit_code=outcome["exit_code"], detail=detail
            )
        self.next_start = now + pause
        detail = "%s; restarting in %.1f s" % (outcome["detail"], pause)
        return self._record_status(
            state=protocol.STARTING, pid=0, exit_code=outcome["exit_code"], detail=detail
        )

    def _restart(self) -> None:
        self.history.append(time.monotonic())
        self.status["restarts"] += 1
        self.metrics.reset()
        try:
            self._start_command()
        except OSError as error:
            self.next_start = None
            self._record_status(state=protocol.FAILED, pid=0, detail=str(error))

    def _check_heartbeat(self) -> None:
        """Stop for good after ``self_fence_s`` without a heartbeat: a manager may have started the task
        elsewhere.
        """
        left_s = self._compute_fence_left_s()
        # A standby does nothing that another instance could do at the same time.
        spared = self.checks.activation.is_standby()
        pause_s = _HEARTBEAT_CHECK_S if spared else min(_HEARTBEAT_CHECK_S, left_s)
        self.next_look = time.monotonic() + pause_s
        if spared or left_s > 0 or not (self.command.pid or self.next_start is not None):
            return
        self.checks.cancel()
        left = self._end_tree(signals.list_stop_steps(self.spec.get("stop") or {}), forced=True)
        code = self.status["exit_code"]
        if self.command.pid:
            code = spawn.describe_exit(self.command.code)["exit_code"]
        self.command.pid, self.next_start = 0, None
        detail = "fenced: no manager call for %g s" % self.fence_s + (
            ", but processes cannot be stopped: %s" % left if left else ""
        )
        state = protocol.STOPPED if self.stopping else protocol.FAILED
        self._record_status(
            state=state,
            pid=0,
            left=left,
            exit_code=code,
            last_exit=code,
            detail=detail,
        )

    def _compute_fence_left_s(self) -> float:
        """Compute the seconds until the task fences itself unless a request comes."""
        last = max(self.begun, heartbeat.read_last_heartbeat(self.identity["host"]))
        return self.fence_s - (proc.read_uptime_s() - last)

    def _end_tree(self, steps: "Sequence[tuple[str, str, float]]", *, forced: bool = False) -> "list[int]":
        """End all processes of the task by ``steps``; the remaining pids.

        During a stop the agent that requested it sends the signals, unless ``forced``; here their end is
        only awaited.
        """

        def take_turn() -> None:
            self.command.reap(self.checks.owns_process)
            self.metrics.check_if_due()

        return self.command.end_tree(steps, lambda: forced or not self.stopping, take_turn)


def _draw_jitter() -> float:
    """Draw uniformly from -1..1, without module random, which takes memory in every supervisor."""
    return int.from_bytes(os.urandom(4), "little") / 0x7FFFFFFF - 1.0


def _drain_fd(fd: int) -> None:
    try:
        while os.read(fd, 4096):
            pass
    except BlockingIOError:
        pass
