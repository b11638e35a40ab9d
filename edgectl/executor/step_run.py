# SPDX-License-Identifier: Apache-2.0
"""The run of one action: its phases timed, reported and journalled, and the context that actions share."""

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field

from edgectl.agent.link import protocol
from edgectl.dataclass import dataclass
from edgectl.errors import ConnectError, HostError, RefusedError, StateError
from edgectl.executor.host_requests import Request, build_instance_id
from edgectl.executor.run_options import RunIdentity, RunOptions
from edgectl.model.inventory import Host, Inventory
from edgectl.model.plan import Plan, Step
from edgectl.model.progress import ProgressEvent, ProgressStage
from edgectl.model.result import ActionResult, CarriedState, Outcome, Phase, PhaseResult
from edgectl.model.task import Task, Tasks
from edgectl.state.failpoints import hit_failpoint
from edgectl.state.journal import Journal
from edgectl.transport.agent_client import call_agent, stream_agent_chunks
from edgectl.transport.base import Session, Transport
from edgectl.transport.fleet_lease import FleetLease
from edgectl.transport.held_call import hold_agent_call
from edgectl.transport.silence import AnsweringHosts


@dataclass(frozen=True, slots=True, kw_only=True)
class RunContext:
    """Everything that the actions of one apply share. ``report_progress`` may be called from any thread.

    ``recovery``: the transport of what ends a handoff, which asks a silent host once more.
    ``lease`` signs every changing request.
    """

    plan: Plan
    inventory: Inventory
    tasks: Tasks
    transport: Transport
    recovery: Transport
    journal: Journal
    identity: RunIdentity
    options: RunOptions
    report_progress: Callable[[ProgressEvent], None]
    lease: FleetLease | None = None
    answering: AnsweringHosts = field(default_factory=AnsweringHosts)

    @property
    def hosts(self) -> Mapping[str, Host]:
        """Hosts by name."""
        return self.inventory.hosts

    def ask(
        self, host: Host, request: Request, *, timeout: float | None = None, data: bytes = b""
    ) -> Request:
        """Send ``request`` and return the reply; where the session turns out lost, once more over a new one.

        Requests are idempotent, so the second one does no harm. ``data``: what follows the request.

        Raises:
            HostError: the host did not do it.
            LeaseLostError: another manager may have the fleet by now; nothing was sent.
        """
        timeout = self.options.call_s if timeout is None else timeout
        with self._connect(host) as session, contextlib.suppress(ConnectError):
            return self._send_signed(session, host, request, timeout, data)
        try:
            with self._connect(host) as session:
                return self._send_signed(session, host, request, timeout, data)
        except RefusedError as error:
            # The first one may have arrived, so nobody knows that nothing was done.
            raise HostError(error.message, hint=error.hint, host=host.name) from error

    @contextlib.contextmanager
    def hold(self, host: Host, request: Request, *, timeout: float) -> Iterator[Callable[[], Request]]:
        """Have ``host`` prepare ``request``; what is yielded lets it go on and returns the reply.

        Left without that, the host does nothing. Where the session is lost then, nobody knows whether it was
        carried out: ask again.

        Raises:
            HostError: as `ask`, there and when it goes on.
        """
        signed, sent = request, 0.0
        if self.lease is not None:
            signed, sent = {**request, "lease": self.lease.sign(host.name)}, self.lease.now()
        with self._connect(host) as session:
            hit_failpoint(f"{request['op']} held")
            held = hold_agent_call(session, signed, timeout=timeout)

            def go_on() -> Request:
                hit_failpoint(f"{request['op']} sent")
                held.go()
                answer: Request = held.wait()
                hit_failpoint(f"{request['op']} acknowledged")
                if self.lease is not None:
                    self.lease.extend(host.name, sent)
                return answer

            with contextlib.closing(held):
                yield go_on

    def _send_signed(
        self, session: Session, host: Host, request: Request, timeout: float, data: bytes
    ) -> Request:
        if self.lease is None or request["op"] not in protocol.CHANGING_OPS:
            return self._send(session, request, timeout, data)
        signature, sent = self.lease.sign(host.name), self.lease.now()
        answer = self._send(session, {**request, "lease": signature}, timeout, data)
        self.lease.extend(host.name, sent)
        return answer

    def _connect(self, host: Host) -> Session:
        hit_failpoint("connect")
        return self.transport.connect(host, timeout=self.options.connect_s)

    def stream(self, host: Host, request: Request, *, timeout: float) -> Iterator[bytes]:
        """Send a request whose reply is a stream, to a host that has the agent; its chunks as they come.

        Raises:
            HostError: the host did not do it, or was silent for ``options.call_s``.
        """
        with self._connect(host) as session:
            hit_failpoint(f"{request['op']} sent")
            yield from stream_agent_chunks(
                session, request, idle_timeout=self.options.call_s, timeout=timeout
            )
            hit_failpoint(f"{request['op']} acknowledged")

    def _send(self, session: Session, request: Request, timeout: float, data: bytes) -> Request:
        hit_failpoint(f"{request['op']} sent")
        answer: Request = call_agent(session, request, timeout=timeout, data=data)
        hit_failpoint(f"{request['op']} acknowledged")
        return answer

    def record(self, event: str, **fields: object) -> None:
        """Journal what follows from an intent already on disk.

        Where that fails, the run ends after the actions under way.
        """
        try:
            self.journal.append(event, **fields)
        except StateError:
            self.options.stop_requested.set()


def _encode_action_entry(step: Step) -> dict[str, object]:
    """An action as a journal entry."""
    return {
        "action": step.action.value,
        "host": step.decision.host,
        "previous_host": step.decision.previous_host,
    }


def _encode_phase_entry(phase: PhaseResult) -> dict[str, object]:
    """A phase as a journal entry."""
    return {
        "phase": phase.phase.value,
        "host": phase.host,
        "seconds": round(phase.seconds, 4),
        "ok": phase.ok,
        **({"detail": phase.detail} if phase.ok and phase.detail else {}),
    }


# After these the old instance is not heard any more; by name, for a deactivated one lives on.
_ENDING_PHASES = ("stop", "deactivate")


def encode_carried_state(state: CarriedState) -> dict[str, object]:
    """A state that was taken along as a journal entry: never the state itself."""
    return {
        "bytes": state.size_bytes,
        "sha256": state.sha256,
        "sent": state.sent_bytes,
        "save_s": round(state.save_s, 4),
        "transfer_s": round(state.transfer_s, 4),
        "load_s": round(state.load_s, 4),
        "age_s": round(state.age_s, 4),
        "host": state.host,
    }


@dataclass(slots=True, kw_only=True)
class StepRun:
    """One step from its intent to its result. ``started``: the instance that was started last. ``needed``:
    marks of the runs of predecessors, by name. ``old_ended``: when the old instance was last stopped
    or deactivated (monotonic clock). ``end_gap_watch``: gives the gap of a move as the robot heard it.
    ``carried``: the state of the task, saved at ``saved_at`` (monotonic); ``spooled``: the hosts where it may
    be kept.
    """

    run: RunContext
    step: Step
    phases: list[PhaseResult] = field(default_factory=list)
    begun: bool = False
    started: str = ""
    needed: dict[str, str] = field(default_factory=dict)
    old_ended: float | None = None
    end_gap_watch: Callable[[Outcome], float | None] | None = None
    carried: CarriedState | None = None
    saved_at: float = 0.0
    spooled: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Name of the task."""
        return self.step.task

    @property
    def task(self) -> Task | None:
        """The task, or None where it left the file."""
        return self.run.tasks.tasks.get(self.step.task)

    @property
    def generation(self) -> int:
        """The generation that a new start of the task gets."""
        return self.run.identity.generations.get(self.name, 1)

    def instance(self, host: str, attempt: int = 1) -> str:
        """The id of a start of the task on ``host`` in this run."""
        identity = self.run.identity
        return build_instance_id(f"{identity.plan_id}:{identity.revision}", self.name, host, attempt)

    def begin(self) -> None:
        """Announce the action, on disk first.

        Raises:
            StateError: the disk does not take it; the action must not go on.
        """
        if self.begun:
            return
        self.run.journal.append(
            "intent", task=self.name, generation=self.generation, **_encode_action_entry(self.step)
        )
        self.begun = True
        self.run.report_progress(
            ProgressEvent(stage=ProgressStage.ACTION_BEGIN, task=self.name, action=self.step.action)
        )

    def begin_recovery(self) -> None:
        """From now on ask a host that was silent in this run once more: a robot may be left on hold there."""
        self.run = dataclasses.replace(self.run, transport=self.run.recovery)

    @contextlib.contextmanager
    def phase(self, phase: Phase, host: str, *, side_effect: bool = True) -> Iterator[list[str]]:
        """Time one phase, journal it before it touches the host, report its result; errors pass through.

        What is appended to the list becomes the detail of a phase that succeeds.
        """
        if side_effect:
            self.run.record("phase", task=self.name, phase=phase.value, host=host)
        self.run.report_progress(
            ProgressEvent(
                stage=ProgressStage.PHASE_BEGIN,
                task=self.name,
                action=self.step.action,
                phase=phase,
                host=host,
            )
        )
        began, remarks = time.monotonic(), list[str]()
        try:
            yield remarks
        except HostError as error:
            self._note(phase, host, began, ok=False, detail=error.message)
            raise
        self._note(phase, host, began, ok=True, detail="; ".join(remarks))

    def _note(self, phase: Phase, host: str, began: float, *, ok: bool, detail: str = "") -> None:
        ended = PhaseResult(phase=phase, host=host, seconds=time.monotonic() - began, ok=ok, detail=detail)
        self.phases.append(ended)
        if phase.value in _ENDING_PHASES:
            self.old_ended = time.monotonic()
        self.run.report_progress(
            ProgressEvent(
                stage=ProgressStage.PHASE_END,
                task=self.name,
                action=self.step.action,
                phase=phase,
                host=host,
                ended=ended,
            )
        )

    def _journal_end(self, result: ActionResult) -> None:
        """Journal the end of an action; of one that never began also the action, which no intent names."""
        event, what = ("commit", {}) if self.begun else ("skipped", _encode_action_entry(self.step))
        self.run.record(
            event,
            task=self.name,
            outcome=result.outcome.value,
            located=result.located,
            error=result.error,
            downtime_s=result.downtime_s,
            **({} if result.gap_s is None else {"gap_s": result.gap_s}),
            **({} if result.state is None else {"state": encode_carried_state(result.state)}),
            phases=[_encode_phase_entry(phase) for phase in self.phases],
            **what,
        )

    def end(
        self,
        outcome: Outcome,
        *,
        located: str | None,
        downtime_s: float | None = None,
        error: HostError | None = None,
    ) -> ActionResult:
        """The result of the action, journalled."""
        decision = self.step.decision
        gap = None if self.end_gap_watch is None else self.end_gap_watch(outcome)
        result = ActionResult(
            task=self.name,
            action=self.step.action,
            outcome=outcome,
            host=decision.host,
            previous_host=decision.previous_host,
            phases=tuple(self.phases),
            downtime_s=downtime_s,
            gap_s=gap,
            error=error.message if error else "",
            hint=error.hint if error else "",
            located=located,
            instance=self.started,
            state=self.carried,
        )
        self._journal_end(result)
        self.run.report_progress(
            ProgressEvent(
                stage=ProgressStage.ACTION_END, task=self.name, action=self.step.action, result=result
            )
        )
        return result
