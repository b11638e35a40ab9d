"""One action under way: what it may use, its phases as they are timed, told and journalled."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from edgectl.errors import ConnectError, HostError, StateError
from edgectl.executor.host_requests import Request, build_instance_id
from edgectl.model.inventory import Host, Inventory
from edgectl.model.plan import Plan, Step
from edgectl.model.progress import ProgressEvent, ProgressStage
from edgectl.model.result import ActionResult, Outcome, Phase, PhaseResult
from edgectl.model.task import Task, Tasks
from edgectl.state.failpoints import hit_failpoint
from edgectl.state.journal import Journal
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Session, Transport


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """How a plan is carried out.

    ``plan_id`` and ``revision`` name this run. ``generations``: the generation to start each task with.
    ``max_parallel``: actions at once. ``connect_s``, ``call_s``: deadlines of a connection and of a short request.
    ``poll_s``: pause between two looks at a condition. ``stop_requested``: set it, and no further action begins.
    ``fail_fast``: nor after a failure; ``deadline`` (monotonic): nor after it. ``verb``, ``user``: for the journal.
    """

    plan_id: str
    revision: int
    generations: Mapping[str, int] = field(default_factory=dict)
    max_parallel: int = 16
    connect_s: float = 15.0
    call_s: float = 15.0
    poll_s: float = 0.5
    stop_requested: threading.Event = field(default_factory=threading.Event)
    fail_fast: bool = False
    deadline: float | None = None
    verb: str = "apply"
    user: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunContext:
    """Everything that the actions of one apply share. ``tell`` may be called from any thread."""

    plan: Plan
    inventory: Inventory
    tasks: Tasks
    transport: Transport
    journal: Journal
    options: RunOptions
    report_progress: Callable[[ProgressEvent], None]

    @property
    def hosts(self) -> Mapping[str, Host]:
        """Hosts by name."""
        return self.inventory.hosts

    def ask(self, host: Host, request: Request, *, timeout: float | None = None) -> Request:
        """Send ``request`` and return the answer; over a session that turns out lost once more, over a new one: requests repeat safely.

        Raises:
            HostError: the host did not do it.
        """
        timeout = self.options.call_s if timeout is None else timeout
        with self._connect(host) as session, contextlib.suppress(ConnectError):
            return self._send(session, request, timeout)
        with self._connect(host) as session:
            return self._send(session, request, timeout)

    def _connect(self, host: Host) -> Session:
        hit_failpoint("connect")
        return self.transport.connect(host, timeout=self.options.connect_s)

    def _send(self, session: Session, request: Request, timeout: float) -> Request:
        hit_failpoint(f"{request['op']} sent")
        answer: Request = call_agent(session, request, timeout=timeout)
        hit_failpoint(f"{request['op']} acknowledged")
        return answer

    def record(self, event: str, **fields: object) -> None:
        """Journal what follows from an intent already on disk. A journal that fails now ends the run after the actions under way."""
        try:
            self.journal.append(event, **fields)
        except StateError:
            self.options.stop_requested.set()


def _encode_action_entry(step: Step) -> dict[str, object]:
    """An action as the journal has it."""
    return {
        "action": step.action.value,
        "host": step.decision.host,
        "previous_host": step.decision.previous_host,
    }


def _encode_phase_entry(phase: PhaseResult) -> dict[str, object]:
    """A phase as the journal has it."""
    return {
        "phase": phase.phase.value,
        "host": phase.host,
        "seconds": round(phase.seconds, 4),
        "ok": phase.ok,
    }


@dataclass(slots=True, kw_only=True)
class StepRun:
    """The course of one step: begun, phase by phase, ended."""

    run: RunContext
    step: Step
    phases: list[PhaseResult] = field(default_factory=list)
    begun: bool = False

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
        return self.run.options.generations.get(self.name, 1)

    def instance(self, host: str, attempt: int = 1) -> str:
        """The id of a start of the task on ``host`` in this run."""
        return build_instance_id(
            f"{self.run.options.plan_id}:{self.run.options.revision}", self.name, host, attempt
        )

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

    @contextlib.contextmanager
    def phase(self, phase: Phase, host: str, *, side_effect: bool = True) -> Iterator[None]:
        """Time one phase, journal it before it touches the host, tell how it went; errors pass through."""
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
        began = time.monotonic()
        try:
            yield
        except HostError as error:
            self._note(phase, host, began, ok=False, detail=error.message)
            raise
        self._note(phase, host, began, ok=True)

    def _note(self, phase: Phase, host: str, began: float, *, ok: bool, detail: str = "") -> None:
        ended = PhaseResult(phase=phase, host=host, seconds=time.monotonic() - began, ok=ok, detail=detail)
        self.phases.append(ended)
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

    def _journal(self, result: ActionResult) -> None:
        """The end of an action; of one that never began also what it was, for no intent says so."""
        event, what = ("commit", {}) if self.begun else ("skipped", _encode_action_entry(self.step))
        self.run.record(
            event,
            task=self.name,
            outcome=result.outcome.value,
            located=result.located,
            error=result.error,
            downtime_s=result.downtime_s,
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
        result = ActionResult(
            task=self.name,
            action=self.step.action,
            outcome=outcome,
            host=decision.host,
            previous_host=decision.previous_host,
            phases=tuple(self.phases),
            downtime_s=downtime_s,
            error=error.message if error else "",
            hint=error.hint if error else "",
            located=located,
        )
        self._journal(result)
        self.run.report_progress(
            ProgressEvent(
                stage=ProgressStage.ACTION_END, task=self.name, action=self.step.action, result=result
            )
        )
        return result
