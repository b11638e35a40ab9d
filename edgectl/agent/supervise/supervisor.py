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
from . import activation, backoff, liveness, lockfile, records, scope, shell, signals, spawn
from .activation import Activation
from .alive import AliveCheck
from .logfile import LogWriter
from .nodes import NodeWatch
from .ready import ReadyCheck
from .successor import is_leaving

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Sequence

    from ..containers.command import ContainerCommand
    from ..measure.latency_tail import LatencyTail

_BLOCK_BYTES = 65536
# (signal, ``main`` or ``tree``, seconds) for the leftovers of an ended command.
_LEFTOVERS = (("TERM", "tree", 5.0),)
_KILL = ("KILL", "tree", 10.0)
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
        self.folder, self.lock, self.report, self.spec = folder, lock, report, spec
        self.identity = identity
        self.log = LogWriter(folder, int(spec["log"]["max_bytes"]), int(spec["log"]["files"]))
        self.env = shell.build_environment(spec.get("env"))
        self.env["EDGECTL_INSTANCE"] = identity["instance"]
        name, _, value = liveness.build_cookie(folder).partition("=")
        self.env[name] = value
        self.env["EDGECTL_METRICS"] = metrics.get_metrics_path(folder)
        self.container = _prepare_container(folder, identity, spec, self.env)
        self.pid, self.ticks, self.pipe, self.started = 0, 0, -1, 0.0
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
        self.stopping, self.code = False, 0
        self.adopted = self.resumed = False
        self.fence_s, self.begun, self.next_look = (
            float(spec.get("self_fence_s") or 0.0),
            proc.read_uptime_s(),
            0.0,
        )
        self.ready, self.alive = (
            ReadyCheck(spec, self.env, self._find_main_process),
            AliveCheck(spec, self.env),
        )
        self.activation = Activation(folder, identity["instance"], spec, self.env, self._find_main_process)
        self.nodes = NodeWatch(folder, spec, self.env)
        self.next_metrics = 0.0
        self.latency: "LatencyTail | None" = None
        self.wake, self._wake_end = os.pipe()
        if orphan is not None:
            self._take_over(orphan)

    def run(self) -> None:
        """Run until the task has ended for good."""
        me = proc.read_own_process()
        identity = dict(self.identity, supervisor=me.pid, supervisor_ticks=me.ticks)
        if self.adopted or self.resumed:
            if self.adopted:
                identity["adopted"] = True
            records.write_record(os.path.join(self.folder, "instance"), identity, durable=True)
            self._install_handlers()
            self.nodes.begin()
            self._record_status()
        else:
            metrics.reset_metrics_file(self.folder)
            records.write_record(os.path.join(self.folder, "instance"), identity, durable=True)
            self._install_handlers()
            self._start_command()
        main = self.pid if self.container is None else self.status["pid"]
        fast_json.send_document(self.report, {"pid": main, "limits": self.status["limits"]})
        while self.pid or self.next_start is not None:
            self._run_once()
        self.nodes.end(remove=not self.stopping)
        self._check_metrics()

    def _take_over(self, status: Document) -> None:
        """Continue from the status of an orphan; its processes are no children of this one."""
        if self.container is not None:
            return self._resume_container(self.container, status)
        self.adopted, self.code = True, spawn.UNKNOWN_EXIT
        self.status.update(status, detail=_ADOPTED)
        self.pid, self.ticks = int(status.get("pid", 0)), int(status.get("ticks", -1))
        # Without a main process there is an end to handle: only leftovers live.
        self.pid, self.started = self.pid or -1, time.monotonic() - proc.age_s_from_ticks(self.ticks)
        if self.activation.rule:
            self.activation.adopt(self.pid, self.ticks, status)
        if status.get("state") == protocol.STARTING and self._is_active():
            self.ready.begin()
        return None

    def _resume_container(self, container: "ContainerCommand", status: Document) -> None:
        """Follow the container of an orphan by a runner of our own, which has the lock."""
        self.status.update(status, detail="")
        self.pid, self.pipe = container.resume(self.lock)
        self.resumed = True
        pid, self.ticks = container.main
        self.started = time.monotonic() - proc.age_s_from_ticks(self.ticks)
        self.log.begin_run()
        if self.activation.rule:
            self.activation.adopt(pid, self.ticks, status)
        if status.get("state") == protocol.STARTING and self._is_active():
            self.ready.begin()

    def _describe_limits(self, why: str) -> str:
        limits = self.spec.get("limits")
        if self.container is None:
            return scope.describe_limits(limits, why)
        # The engine refuses to start a container whose limits it cannot set.
        return "enforced" if any((limits or {}).values()) else ""

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
        if self.lock < 0:
            self.lock = lockfile.take_lock(self.folder)
            if self.lock < 0:
                raise OSError("the lock of the task is held by a process that it left")
        self.adopted = self.resumed = False
        if self.container is not None:
            return self._start_container(self.container)
        setup = (self.spec.get("ros") or {}).get("setup") or ()
        argv = shell.build_argv(self.spec["command"], self.spec.get("prelude") or "", setup)
        self.pid, self.pipe = spawn.spawn_command(argv, self.env, self.spec.get("workdir"), self.lock)
        self.log.begin_run()
        process = proc.read_process(self.pid)
        return self._begin_run(self.pid, process.ticks if process is not None else -1)

    def _start_container(self, container: "ContainerCommand") -> None:
        """Start the container; at the first start only once it runs, later its note says when."""
        first = not self.status["restarts"]
        self.pid, self.pipe = container.start(self.lock, patient=not first)
        self.log.begin_run()
        if first:
            return self._begin_run(*container.main)
        self.started = time.monotonic()
        return self._record_status(state=protocol.STARTING, pid=0, detail="")

    def _begin_run(self, pid: int, ticks: int) -> None:
        """Begin the checks of what was just started, and record it."""
        self.ticks, self.started = ticks, time.monotonic()
        self.nodes.begin()
        if self.activation.rule:
            self.activation.begin(pid, ticks)
            self.status.update(prepared=False, active=False)
        else:
            self.ready.begin()
        waits = self.activation.rule or self.spec.get("ready")
        self._record_status(
            state=protocol.STARTING if waits else protocol.RUNNING,
            pid=pid,
            ticks=ticks,
            exit_code=None,
            detail="",
        )

    def _hear_runner(self) -> None:
        """Record what the runner of a container has to say."""
        for note in self.container.read_notes() if self.container is not None else ():
            if note["event"] == "started" and not self.status["pid"]:
                self._begin_run(int(note["pid"]), int(note["ticks"]))
            elif note["event"] == "lost":
                from ..containers.command import describe_loss

                self.log.write(("edgectl: %s\n" % describe_loss(note)).encode())
                self._record_status(detail=describe_loss(note))
            elif note["event"] == "back":
                self.log.write(b"edgectl: the container engine answers again\n")
                self._record_status(detail="")

    def _await_event(self) -> None:
        """Wait for output, a signal or the time of a check; take in what there is to read."""
        poll = select.poll()
        poll.register(self.wake, select.POLLIN)
        if self.pipe >= 0:
            poll.register(self.pipe, select.POLLIN)
        if self.container is not None and self.container.notes >= 0:
            poll.register(self.container.notes, select.POLLIN)
        for fd, _ in poll.poll(self._compute_poll_ms()):
            if fd == self.pipe:
                self._copy_output()
            elif fd != self.wake:
                self._hear_runner()
            else:
                _drain_fd(fd)
                self.activation.look()

    def _run_once(self) -> None:
        """Wait for the next event and handle it."""
        self._await_event()
        # Before the children are reaped: the process of a check that has ended stands in their way.
        self._follow_role()
        self._ask_readiness()
        self._ask_health()
        if self.pid and not self.stopping:
            self.nodes.poll()
        ended = self._reap_children()
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
        self._limit_metrics()

    def _compute_poll_ms(self) -> float:
        now = time.monotonic()
        times = [self.next_metrics - now]
        if self.adopted and self.pid:
            times.append(_ADOPTED_CHECK_S)
        if self.fence_s:
            times.append(self.next_look - now)
        if self.next_start is not None:
            times.append(self.next_start - now)
        checks = (
            self.ready.compute_wait_s(now),
            self.alive.compute_wait_s(now),
            self.activation.compute_wait_s(now),
            self.nodes.compute_wait_s(now) if self.pid and not self.stopping else None,
        )
        times.extend(each for each in checks if each is not None)
        return max(0.0, min(times)) * 1000.0 + 1.0

    def _limit_metrics(self) -> None:
        if time.monotonic() >= self.next_metrics:
            self.next_metrics = time.monotonic() + self._check_metrics()

    def _check_metrics(self) -> float:
        """Count the new values of the latency, then limit the file; the seconds until the next check."""
        if self.latency is None and os.path.exists(os.path.join(self.folder, "latency-rule")):
            from ..measure.latency_tail import LatencyTail

            self.latency = LatencyTail(self.folder, self.identity["instance"])
        if self.latency is not None:
            self.latency.poll()
        pause_s, size = metrics.limit_metrics_file(self.folder)
        if self.latency is not None and size is not None:
            self.latency.cut_to(size)
        return pause_s

    def _copy_output(self) -> None:
        data = os.read(self.pipe, _BLOCK_BYTES)
        if data:
            return self.log.write(data)
        os.close(self.pipe)
        self.pipe = -1
        return None

    def _reap_children(self) -> "int | None":
        """Reap every child that ended; the wait status of the main process where it is among them, or is
        adopted and gone.
        """
        ended = None
        if self.adopted and self.pid and not proc.is_process_alive(self.pid, self.ticks):
            ended = spawn.UNKNOWN_EXIT
        while True:
            try:
                seen = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            except ChildProcessError:
                return ended
            if seen is None or self._owns_check(seen.si_pid):
                return ended
            pid, code = os.waitpid(seen.si_pid, 0)
            if pid == self.pid:
                self.code = ended = code

    def _owns_check(self, pid: int) -> bool:
        return any(each.owns_process(pid) for each in (self.ready, self.alive, self.activation))

    def _cancel_checks(self) -> None:
        self.ready.cancel()
        self.alive.cancel()
        self.activation.cancel()

    def _find_main_process(self) -> int:
        if self.container is not None:
            return self.container.main[0]
        return signals.find_main_process(self.pid, proc.read_process_table())

    def _is_active(self) -> bool:
        """Whether the task is to be ready and alive: not while it waits for its activation."""
        return not self.activation.rule or self.activation.active

    def _follow_role(self) -> None:
        """Make the process what the record of the role says, and record what it is."""
        if not self.pid or self.stopping:
            return
        news = self.activation.poll(lambda: not self.fence_s or self._compute_fence_left_s() > 0)
        if news == activation.FAILED:
            self._give_up(self.activation.fault)
        elif news == activation.ACTIVE:
            self.ready.begin()
            state = protocol.STARTING if self.spec.get("ready") else protocol.RUNNING
            self._record_status(state=state, prepared=True, active=True, detail="")
        elif news and self.activation.is_standby():
            self.ready.cancel()
            self.alive.cancel()
            self._record_status(state=protocol.READY, prepared=True, active=False, detail="")
        elif news == activation.PREPARED:
            self._record_status(prepared=True, detail="")
        elif self.activation.fault and self.status["detail"] != self.activation.fault:
            self._record_status(detail=self.activation.fault)

    def _ask_readiness(self) -> None:
        if self.ready.poll():
            self._record_status(state=protocol.READY, detail="")
        elif self.ready.fault and self.status["detail"] != self.ready.fault:
            self._record_status(detail=self.ready.fault)

    def _ask_health(self) -> None:
        """Record whether the task is alive; restart it where its spec says so."""
        if self.stopping:
            self.alive.cancel()
        if not self.pid or self.stopping or self.status["state"] == protocol.STARTING:
            return
        if not self._is_active():
            return
        self.alive.begin()
        fault = self.alive.poll()
        if fault is None or (fault and self._is_leaving()):
            return
        if fault and self.spec["alive"].get("restart"):
            self._restart_unhealthy(fault)
        elif fault and (self.status["state"], self.status["detail"]) != (protocol.UNHEALTHY, fault):
            self._record_status(state=protocol.UNHEALTHY, detail=fault)
        elif not fault and self.status["state"] == protocol.UNHEALTHY:
            state = protocol.READY if self.spec.get("ready") else protocol.RUNNING
            self._record_status(state=state, detail="")

    def _restart_unhealthy(self, fault: str) -> None:
        """End the task as a stop does, and start it again by the rules of a crash."""
        self._record_status(state=protocol.UNHEALTHY, detail=fault)
        self._restart_faulty("not alive: " + fault)

    def _give_up(self, fault: str) -> None:
        """Treat a process that cannot be activated as one that has failed, by the rules of a crash."""
        if self.spec.get("restart", "on-failure") != "never":
            return self._restart_faulty(fault)
        self._cancel_checks()
        left = self._end_tree(signals.list_stop_steps(self.spec.get("stop") or {}), forced=True)
        outcome = dict(spawn.describe_exit(self.code), detail=fault)
        self.pid, self.status["last_exit"] = 0, outcome["exit_code"]
        state = protocol.STOPPED if self.stopping else protocol.FAILED
        return self._record_status(state=state, pid=0, left=left, given_up=True, **outcome)

    def _restart_faulty(self, fault: str) -> None:
        self.log.write(("edgectl: %s; restarting\n" % fault).encode("utf-8", "replace"))
        self._cancel_checks()
        ran_s = time.monotonic() - self.started
        left = self._end_tree(signals.list_stop_steps(self.spec.get("stop") or {}), forced=True)
        outcome = dict(spawn.describe_exit(self.code), detail=fault)
        self.pid, self.status["last_exit"] = 0, outcome["exit_code"]
        if self.stopping or left:
            state = protocol.FAILED if left else protocol.STOPPED
            return self._record_status(state=state, pid=0, left=left, **outcome)
        return self._schedule_restart(ran_s, outcome)

    def _handle_end(self, code: int) -> None:
        """Handle the end of the main process: clear its leftovers, then restart it or record the end."""
        ran_s, self.pid = time.monotonic() - self.started, 0
        self._cancel_checks()
        left = self._end_tree(_LEFTOVERS)
        outcome = spawn.describe_exit(code)
        if self.container is not None:
            self.container.read_notes()
            outcome["detail"] = self.container.detail or outcome["detail"]
        self.status["last_exit"] = outcome["exit_code"]
        if self.stopping or (not left and self._is_leaving()):
            return self._record_status(state=protocol.STOPPED, pid=0, left=left, **outcome)
        if left:
            return self._record_status(
                state=protocol.FAILED,
                pid=0,
                left=left,
                exit_code=outcome["exit_code"],
                detail="processes cannot be stopped: %s" % left,
            )
        clean = code == 0
        if clean and self.spec.get("kind") == "job":
            return self._record_status(state=protocol.COMPLETED, pid=0, **outcome)
        policy = self.spec.get("restart", "on-failure")
        if policy == "never" or (policy == "on-failure" and clean):
            return self._record_status(state=protocol.FAILED, pid=0, given_up=policy == "never", **outcome)
        return self._schedule_restart(ran_s, outcome)

    def _is_leaving(self) -> bool:
        """Whether a successor starts elsewhere: it may well have thrown this one out of the ROS graph."""
        return is_leaving(self.folder, self.identity["instance"])

    def _schedule_restart(self, ran_s: float, outcome: Document) -> None:
        now = time.monotonic()
        self.history = backoff.select_history(self.history, ran_s)
        pause = backoff.compute_delay(self.history, now, _draw_jitter())
        if pause is None:
            detail = "%s; %d restarts in 10 minutes" % (outcome["detail"], backoff.MAX_RESTARTS)
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
        self._check_metrics()
        metrics.reset_metrics_file(self.folder)
        if self.latency is not None:
            self.latency.cut_to(0)
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
        spared = self.activation.is_standby()
        pause_s = _HEARTBEAT_CHECK_S if spared else min(_HEARTBEAT_CHECK_S, left_s)
        self.next_look = time.monotonic() + pause_s
        if spared or left_s > 0 or not (self.pid or self.next_start is not None):
            return
        self._cancel_checks()
        left = self._end_tree(signals.list_stop_steps(self.spec.get("stop") or {}), forced=True)
        outcome = spawn.describe_exit(self.code) if self.pid else {"exit_code": self.status["exit_code"]}
        self.pid, self.next_start = 0, None
        detail = "fenced: no manager call for %g s" % self.fence_s + (
            ", but processes cannot be stopped: %s" % left if left else ""
        )
        state = protocol.STOPPED if self.stopping else protocol.FAILED
        self._record_status(
            state=state,
            pid=0,
            left=left,
            exit_code=outcome["exit_code"],
            last_exit=outcome["exit_code"],
            detail=detail,
        )

    def _compute_fence_left_s(self) -> float:
        """Compute the seconds until the task fences itself unless a request comes."""
        last = max(self.begun, heartbeat.read_last_heartbeat(self.identity["host"]))
        return self.fence_s - (proc.read_uptime_s() - last)

    def _end_tree(self, steps: "Sequence[tuple[str, str, float]]", *, forced: bool = False) -> "list[int]":
        """Signal all below this process, step by step and finally with KILL, until nothing is left.

        Returns the remaining pids. During a stop the agent that requested it sends the signals, unless
        ``forced``; here they are only awaited.
        """
        pending, since = [*steps, _KILL], time.monotonic()
        sent: "set[tuple[int, int, int]]" = set()
        while True:
            self._reap_children()
            table = proc.read_process_table()
            left = self._find_tree(table)
            if not left:
                break
            if forced or not self.stopping:
                if time.monotonic() - since > pending[0][2]:
                    since = time.monotonic()
                    del pending[0]
                if not pending:
                    break
                sent |= self._signal_step(pending[0], left, table, sent)
            self._limit_metrics()
            self._copy_output_for(0.05)
        self._copy_output_for(0.0)
        if self.pipe >= 0:
            os.close(self.pipe)
            self.pipe = -1
        return sorted(left)

    def _find_tree(self, table: "dict[int, proc.Process]") -> "set[int]":
        """Find the processes of the task; those of an orphan are found as they are without a supervisor."""
        left = proc.find_descendants({os.getpid()}, table)
        if self.adopted:
            left |= liveness.find_orphans(liveness.read_instance(self.folder), table)
        if self.container is not None:
            left |= self.container.find_processes(table)
        return left - {os.getpid()}

    def _signal_step(
        self,
        step: "tuple[str, str, float]",
        left: "set[int]",
        table: "dict[int, proc.Process]",
        sent: "set[tuple[int, int, int]]",
    ) -> "set[tuple[int, int, int]]":
        """Send one step to the remaining processes.

        The main process gets its signal once, newcomers of the tree get it too.
        """
        if self.container is not None:
            return self.container.signal_step(signals.parse_signal(step[0]), left, table, sent)
        if step[1] == "main":
            left = set() if sent else {signals.find_main_process(self.pid, table)} & left
        return signals.send_signals(
            [(pid, table[pid].ticks) for pid in sorted(left)], signals.parse_signal(step[0]), sent
        )

    def _copy_output_for(self, seconds: float) -> None:
        """Write the log for ``seconds``."""
        deadline = time.monotonic() + seconds
        while self.pipe >= 0 and select.select([self.pipe], [], [], max(0.0, deadline - time.monotonic()))[0]:
            self._copy_output()
        time.sleep(max(0.0, deadline - time.monotonic()))


def _prepare_container(
    folder: str, identity: Document, spec: Document, env: "dict[str, str]"
) -> "ContainerCommand | None":
    """Prepare the container of a task that has one; its name is among the variables of its checks."""
    if not spec.get("image"):
        return None
    from ..containers.command import ContainerCommand
    from ..containers.create import NAME_VARIABLE, build_container_name

    env[NAME_VARIABLE] = build_container_name(identity["fleet"], identity["host"], identity["task"])
    return ContainerCommand(folder, identity, spec)


def _draw_jitter() -> float:
    """Draw uniformly from -1..1, without module random, which takes memory in every supervisor."""
    return int.from_bytes(os.urandom(4), "little") / 0x7FFFFFFF - 1.0


def _drain_fd(fd: int) -> None:
    try:
        while os.read(fd, 4096):
            pass
    except BlockingIOError:
        pass
