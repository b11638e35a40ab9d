# SPDX-License-Identifier: Apache-2.0
"""Watch loop: sample, smooth, plan and, if allowed, apply, over sessions that stay open."""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import field
from typing import Self

# A watch runs for days, and edgectl may be upgraded meanwhile: what later cycles need is imported at once.
import edgectl.executor.run
import edgectl.scheduler.repair  # noqa: F401
from edgectl.dataclass import dataclass
from edgectl.errors import CoordinationError, EdgectlError, LockBusyError, WatchedError
from edgectl.executor.dependencies import add_dependent_starts
from edgectl.gateway.host_probe import DecodedProbe, ProbeOptions
from edgectl.gateway.readings import MAX_EVERY_S, FleetReadings
from edgectl.gateway.smoothing import smooth_snapshot
from edgectl.model.cycle import Cycle
from edgectl.model.plan import Action, Plan
from edgectl.model.policy import Policy
from edgectl.model.result import Outcome, Results
from edgectl.model.snapshot import Snapshot
from edgectl.state.lock import FleetLock
from edgectl.transport.backoff import compute_backoff_s
from edgectl.transport.connections import REFUSED_BACKOFF_S, BackoffTransport, SessionPool
from edgectl.transport.fleet_lease import WatchNote
from edgectl.transport.readings import ReadingFeeds
from edgectl.usecases.control import Control, ControlRequest
from edgectl.usecases.failover_wake import (
    FailoverStage,
    compute_stages,
    find_next_stage_s,
    has_advanced,
    has_replaced_tasks,
    list_failover_times,
    list_rested_hosts,
)
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.fleet_lease import compute_files_digest, hold_fleet, release_fleet
from edgectl.usecases.given_up import take_given_up_reminders
from edgectl.usecases.heartbeat import load_state_with_heartbeats, send_heartbeats
from edgectl.usecases.load_warnings import LoadWarnings
from edgectl.usecases.plan import limit_plan_to_tasks, make_plan
from edgectl.usecases.plan_execution import (
    ApplyOptions,
    confirm_always,
    confirm_and_execute,
    has_nothing_to_do,
)
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.record import get_newest_event_id, list_events_after, record_plan

# A task whose action failed is retried with back-off: each failed move stops the task.
_MIN_BACKOFF_S, _MAX_BACKOFF_S = 30.0, 600.0
# Probe deadline of a watch: a hanging host must not delay a cycle as long as it may delay a single probe.
_PROBE_TIMEOUT_S = 10.0


PlanSignature = tuple[tuple[str, Action | None, str | None], ...]


def policy_from_files(fleet: Fleet) -> Policy:
    """The policy of the task files."""
    return fleet.tasks.policy


def never_reload() -> Fleet | None:
    """Keep the files as they are."""
    return None


def ignore_sample(_snapshot: Snapshot) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchOptions:
    """Options of a watch.

    ``every``: s between the starts of two cycles. ``apply``: execute plans. ``cycles``: end after so many.
    ``policy``: the policy for a fleet; nobody reviews these plans, so ``max_moves`` applies.
    ``debug``: a bug ends the loop instead of one cycle.
    ``refresh``: a new fleet if its files changed, else None; raises EdgectlError if they are broken, and the
    old ones stay in use.
    ``take_over``: replace another watch of the fleet. ``on_sample``: called with what each plan is made from,
    before it.
    """

    every: float = 10.0
    apply: bool = False
    take_over: bool = False
    cycles: int | None = None
    debug: bool = False
    probe: ProbeOptions = field(default_factory=lambda: ProbeOptions(timeout=_PROBE_TIMEOUT_S))
    policy: Callable[[Fleet], Policy] = policy_from_files
    refresh: Callable[[], Fleet | None] = never_reload
    on_sample: Callable[[Snapshot], None] = ignore_sample
    execution: ApplyOptions = field(default_factory=ApplyOptions)
    control: Control = field(default_factory=Control)


def watch_fleet(fleet: Fleet, options: WatchOptions) -> Generator[Cycle, None, None]:
    """Yield one `Cycle` after the other until ``options.control`` requests a stop. An error belongs to its
    cycle; the loop continues.

    Close the iterator (``contextlib.closing``) if it is not read to its end: it holds connections.

    Raises:
        LockBusyError: another watch of this machine applies plans to this fleet.
        WatchedError: one of another machine does, or has taken over.
    """
    with _WatchLoop(fleet, options) as loop:
        yield from loop.cycles()


@dataclass(frozen=True, slots=True, kw_only=True)
class _TaskBackoff:
    """Consecutive ``failures`` of a task's actions; no attempt before ``until`` (uptime, s)."""

    failures: int
    until: float


class _WatchLoop:
    """State that a watch keeps from cycle to cycle; its size does not grow with their number."""

    def __init__(self, fleet: Fleet, options: WatchOptions) -> None:
        self._options = options
        self._said: list[str] = []
        self._resting: dict[str, _TaskBackoff] = {}
        self._smooth: Snapshot | None = None
        self._planned: PlanSignature = ()
        self._stages: dict[str, FailoverStage] = {}
        self._load_warnings = LoadWarnings()
        self._answering: tuple[str, ...] = ()
        self._take_over = options.take_over
        self._last_hold: Fleet | None = None
        self._alone = FleetLock(fleet.state, verb="watch", clock=fleet.clock, name="watch.lock")
        self._heartbeats = contextlib.ExitStack()
        self._take(fleet)
        self._heard = get_newest_event_id(self._fleet)

    def __enter__(self) -> Self:
        if self._options.apply:
            self._alone.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._last_hold is not None:
            release_fleet(self._last_hold, self._answering, end_watch=True)
        self._heartbeats.close()
        self._pool.close()
        self._alone.__exit__(*exc)

    def _take(self, fleet: Fleet) -> None:
        """Switch to ``fleet`` with new connections; heartbeats go on over these while a cycle waits."""
        self._heartbeats.close()
        feeds = ReadingFeeds()
        self._pool = SessionPool(
            fleet.transport, forget_s=REFUSED_BACKOFF_S, clock=self._now_of(fleet), converse=True, feeds=feeds
        )
        # A plan that is applied is made from what hosts were asked: that renews the hold of the fleet, too.
        pushed = not self._options.apply and self._options.every <= MAX_EVERY_S
        self._readings = FleetReadings[DecodedProbe](feeds, every=self._options.every) if pushed else None
        self._patient = BackoffTransport(self._pool, clock=self._now_of(fleet))
        self._fleet = dataclasses.replace(fleet, transport=self._pool, warn=self._said.append)
        self._heartbeats.enter_context(send_heartbeats(self._fleet, lambda: self._answering))

    @staticmethod
    def _now_of(fleet: Fleet) -> Callable[[], float]:
        return lambda: fleet.uptime().seconds

    def _now(self) -> float:
        """Seconds on a monotonic clock."""
        return self._fleet.uptime().seconds

    def cycles(self) -> Generator[Cycle, None, None]:
        """Yield the cycles. Cycles that a long one overran are skipped; they do not accumulate."""
        number, wish = 0, None
        while wish is not ControlRequest.STOP:
            number += 1
            began = self._now()
            cycle = self._cycle(
                number, paused=self._options.control.paused and wish is not ControlRequest.NOW
            )
            seconds = self._now() - began
            left = self._options.every - math.fmod(seconds, self._options.every)
            last = number == self._options.cycles or self._options.control.stop_requested.is_set()
            yield dataclasses.replace(cycle, seconds=seconds, next_in=None if last else left)
            if last:
                return
            wish = self._wait(began + seconds + left)

    def _wait(self, until: float) -> ControlRequest | None:
        """Wait for the next cycle; it begins at once when the tasks of a silent host may be replaced."""
        while True:
            seconds = max(0.0, until - self._now())
            sooner = find_next_stage_s(self._list_failover_times(), self._options.probe.timeout)
            if sooner is None or sooner >= seconds:
                return self._options.control.wait(seconds)
            wish = self._options.control.wait(sooner)
            stages = compute_stages(self._list_failover_times(), self._options.probe.timeout)
            if wish is not None or has_advanced(self._stages, stages):
                return wish

    def _list_failover_times(self) -> dict[str, float]:
        """Seconds until the tasks of each host may be replaced; a state that cannot be read costs a cycle."""
        if not self._options.apply or not has_replaced_tasks(self._fleet.tasks):
            return {}
        try:
            manager = load_state_with_heartbeats(self._fleet)
        except EdgectlError:
            return {}
        return list_failover_times(self._fleet.tasks, manager, self._fleet.clock())

    def _cycle(self, number: int, *, paused: bool) -> Cycle:
        """Run one cycle; an error is recorded in it."""
        draft = _CycleBuilder(Cycle(number=number, at=self._fleet.clock(), paused=paused))
        self._said.clear()
        try:
            self._round(draft, paused=paused)
        except WatchedError:
            raise
        except LockBusyError as error:
            draft.put(busy=error.message)
        except EdgectlError as error:
            draft.put(error=error.message)
        except OSError as error:
            draft.put(error=f"{error.filename}: {error.strerror}" if error.filename else str(error))
        except Exception as error:
            if self._options.debug:
                raise
            what = f"unexpected {type(error).__name__}: {error}".splitlines()[0]
            draft.put(error=f"{what} (a bug in edgectl; EDGECTL_DEBUG=1 shows where)")
        events = list_events_after(self._fleet, self._heard)
        self._heard = max((event.id for event in events), default=self._heard)
        if draft.cycle.plan is not None:
            self._said += self._load_warnings.list_new(draft.cycle.plan, events)
        return dataclasses.replace(
            draft.cycle, events=events, warnings=tuple(dict.fromkeys(self._said)), resting=self._at_rest()
        )

    def _round(self, draft: "_CycleBuilder", *, paused: bool) -> None:
        self._refresh()
        with self._hold(paused=paused) as (fleet, busy):
            snapshot = self._sample(fleet)
            draft.put(snapshot=snapshot)
            if paused or self._options.control.stop_requested.is_set():
                return
            self._options.on_sample(snapshot)
            plan = self._plan(snapshot)
            draft.put(plan=plan)
            self._said += take_given_up_reminders(fleet, plan)
            if self._options.apply and not has_nothing_to_do(fleet, plan):
                if busy is not None:
                    raise busy
                draft.put(results=self._apply(fleet, plan))

    @contextlib.contextmanager
    def _hold(self, *, paused: bool) -> Iterator[tuple[Fleet, EdgectlError | None]]:
        """The fleet to sample: held from its probe to the end of the actions where this watch applies plans.

        With the error where another edgectl of this machine is changing the fleet, or where it cannot be had
        in etcd; then it is only sampled.
        """
        if paused or not self._options.apply:
            yield self._fleet, None
            return
        every = self._options.every
        note = WatchNote(every_s=every, digest=compute_files_digest(self._fleet))
        lock = FleetLock(
            self._fleet.state, verb="watch", clock=self._fleet.clock, cycle_s=every + _PROBE_TIMEOUT_S
        )
        try:
            lock.__enter__()
        except LockBusyError as error:
            yield self._fleet, error
            return
        with contextlib.ExitStack() as stack:
            stack.push(lock)
            try:
                held = stack.enter_context(
                    hold_fleet(self._fleet, "watch", patience_s=0.0, watch=note, take_over=self._take_over)
                )
            except WatchedError:
                raise
            except (LockBusyError, CoordinationError) as error:
                yield self._fleet, error
                return
            yield held, None

    def _refresh(self) -> None:
        """Load changed files; if they are broken, warn and keep the old ones."""
        try:
            fleet = self._options.refresh()
        except EdgectlError as error:
            self._said.append(f"{error.message}; the files as read before stay in use")
            return
        if fleet is not None and fleet.inventory.fleet != self._fleet.inventory.fleet:
            old, new = self._fleet.inventory.fleet, fleet.inventory.fleet
            self._said.append(
                f"the inventory names fleet {new} now; fleet {old} stays in use until the watch is restarted"
            )
        elif fleet is not None:
            self._pool.close()
            self._take(fleet)
            self._resting = {task: rest for task, rest in self._resting.items() if task in fleet.tasks.tasks}

    def _sample(self, fleet: Fleet) -> Snapshot:
        """Probe the fleet; unreachable hosts are retried with back-off."""
        options = dataclasses.replace(self._options.probe, probe_idle_links=True, readings=self._readings)
        times = self._list_failover_times()
        for host, seconds in list_rested_hosts(times, self._stages, options.timeout).items():
            self._patient.extend_rest(host, seconds)
        self._stages = compute_stages(times, options.timeout)
        snapshot = probe_fleet(dataclasses.replace(fleet, transport=self._patient), options)
        self._answering = tuple(name for name, host in snapshot.hosts.items() if host.ok)
        if fleet.lease is not None:
            self._take_over, self._last_hold = False, fleet
        self._smooth = smooth_snapshot(self._smooth, snapshot, period=self._options.every)
        return snapshot

    def _plan(self, snapshot: Snapshot) -> Plan:
        """Plan from the smoothed loads; tasks in back-off stay as they are."""
        policy = dataclasses.replace(self._options.policy(self._fleet), attended=False)
        plan = make_plan(self._fleet, policy, snapshot=self._smooth or snapshot)
        signature: PlanSignature = (
            *((step.task, step.action, step.decision.host) for step in plan.steps),
            *((found.task, None, found.host) for found in plan.overuses),
        )
        if signature != self._planned:
            self._planned = signature
            record_plan(self._fleet, plan)
        alone = add_dependent_starts(plan.steps, self._fleet.tasks, self._at_rest())
        return limit_plan_to_tasks(plan, {step.task for step in plan.steps} - alone) if alone else plan

    def _at_rest(self) -> tuple[str, ...]:
        now = self._now()
        return tuple(sorted(task for task, rest in self._resting.items() if now < rest.until))

    def _apply(self, fleet: Fleet, plan: Plan) -> Results | None:
        options = dataclasses.replace(
            self._options.execution, stop_requested=self._options.control.stop_requested
        )
        results = confirm_and_execute(fleet, plan, confirm_always, options, verb="watch").results
        self._note_failures(results)
        return results

    def _note_failures(self, results: Results | None) -> None:
        for action in results.actions if results is not None else ():
            if action.outcome is Outcome.DONE:
                self._resting.pop(action.task, None)
            elif action.outcome is Outcome.FAILED:
                failures = 1 + (self._resting[action.task].failures if action.task in self._resting else 0)
                seconds = compute_backoff_s(failures, first_s=_MIN_BACKOFF_S, max_s=_MAX_BACKOFF_S)
                self._resting[action.task] = _TaskBackoff(failures=failures, until=self._now() + seconds)


class _CycleBuilder:
    """A cycle under construction."""

    def __init__(self, cycle: Cycle) -> None:
        self.cycle = cycle

    def put(self, **parts: object) -> None:
        """Set fields of the cycle."""
        self.cycle = dataclasses.replace(self.cycle, **parts)  # type: ignore[arg-type]
