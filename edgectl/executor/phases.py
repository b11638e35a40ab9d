# SPDX-License-Identifier: Apache-2.0
"""Perform the phases of an action: send the requests, check the replies, repeat waits and checks."""

import time
from collections.abc import Mapping
from types import MappingProxyType

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.executor import host_requests
from edgectl.executor.action_phases import (
    WAIT_PIECE_S,
    PlannedPhase,
    PlannedPhases,
    PlannedRequest,
    get_copy_up_time,
)
from edgectl.executor.concurrent_change import check_gone_everywhere
from edgectl.executor.host_requests import Request
from edgectl.executor.image_phases import pull_image
from edgectl.executor.secrets import resolve_environment
from edgectl.executor.state_transfer import perform_state_phase
from edgectl.executor.step_run import RunContext, StepRun
from edgectl.executor.switch import switch_instance
from edgectl.model.check import CheckLocation
from edgectl.model.result import Phase
from edgectl.model.task import Task, TaskKind
from edgectl.model.text import clean_text
from edgectl.rules.need_runs import join_marks, mark_run
from edgectl.rules.ros_nodes import describe_graph
from edgectl.state.lock import describe_manager

# Beyond the grace: SIGKILL, the sweeps that prove the end, and the way back.
_STOP_MARGIN_S = 20.0
_MIN_CHECK_S = 0.1
# Of the text of a reply in a message, characters.
_MAX_DETAIL = 500
_NO_VARIABLES: Mapping[str, str] = MappingProxyType({})


def perform_phases(
    act: StepRun, planned: PlannedPhases, variables: Mapping[str, str] = _NO_VARIABLES
) -> None:
    """Perform phases one after the other; ``variables``: environment of a start with its secrets in clear.

    Raises:
        HostError: one of them failed; those after it were not begun.
    """
    for phase in planned:
        perform_phase(act, phase, variables)


def perform_phase(act: StepRun, planned: PlannedPhase, variables: Mapping[str, str] = _NO_VARIABLES) -> None:
    """Send the requests of one phase, filled with what apply makes, until each has succeeded.

    Raises:
        HostError: the phase failed, or was not done in time.
    """
    match planned.phase:
        case Phase.REACH:
            _reach(act.run, planned.requests[0])
        case Phase.NEEDS:
            _perform_need(act, planned)
        case Phase.PULL:
            pull_image(act, planned)
        case Phase.SAFE:
            _wait_until_safe(act, planned)
        case Phase.HOLD | Phase.RELEASE:
            _run_hook(act, planned)
        case Phase.READY:
            _wait_until_ready(act, planned)
        case _:
            _change_instance(act, planned, variables)


def _change_instance(act: StepRun, planned: PlannedPhase, variables: Mapping[str, str]) -> None:
    """Perform a phase that changes an instance."""
    match planned.phase:
        case Phase.STOP:
            _stop_task(act, planned)
        case Phase.STANDBY:
            _start_standby(act, planned)
        case Phase.ACTIVATE | Phase.DEACTIVATE:
            switch_instance(act, planned, variables)
        case Phase.RESTORE if planned.requests[0].body["op"] == protocol.OP_ACTIVATE:
            switch_instance(act, planned, variables)
        case Phase.START | Phase.RESTORE:
            _start_task(act, planned, variables)
        case Phase.ADOPT:
            _adopt_task(act, planned, variables)
        case _:
            perform_state_phase(act, planned)


def resolve_variables(act: StepRun, task: Task, host_name: str) -> dict[str, str]:
    """The environment of a start with its secrets in clear, read before anything is touched for its sake."""
    return resolve_environment(task, act.run.hosts[host_name], act.run.hosts)


def _send(run: RunContext, request: PlannedRequest, **values: object) -> Request:
    """Send a request with ``values`` in place of what stood for them."""
    return run.ask(request.host, {**request.body, **values}, timeout=request.timeout_s + run.options.call_s)


def _reach(run: RunContext, request: PlannedRequest) -> None:
    """Ask whether the host is there; what an old instance is told there is not left out."""
    if request.body["op"] == protocol.OP_STATUS:
        run.answering.reach(request.host.name, lambda: _send(run, request))
    else:
        _send(run, request)


def _stop_task(act: StepRun, planned: PlannedPhase) -> None:
    """Stop the task. Where the plan had seen it alive and it is gone, the fleet has changed: look again."""
    request, host = planned.requests[0], planned.host
    body = {**request.body, "generation": act.generation}
    with act.phase(planned.phase, host.name) as remarks:
        answer = act.run.ask(host, body, timeout=request.timeout_s + _STOP_MARGIN_S)
        remarks.extend(describe_graph(answer.get("graph")))
        if answer.get("state") not in (protocol.STOPPED, protocol.NOT_RUNNING):
            left = clean_text(answer.get("left"), _MAX_DETAIL)
            raise HostError(
                f"{act.name} did not stop completely on {host.name}: processes left {left}",
                hint=f"end them on {host.name}, then apply again",
                host=host.name,
            )
        gone = answer.get("state") == protocol.NOT_RUNNING and _was_alive(act, request)
        # In a start-first move the successor may have thrown it out of the ROS graph.
        if gone and not (act.started and host.ros is not None):
            check_gone_everywhere(act, host)


def _was_alive(act: StepRun, request: PlannedRequest) -> bool:
    """Whether the plan had seen the very instance alive that was to be stopped.

    A copy on another host than the recorded one, if that answers, is only reported.
    """
    snapshot = act.run.plan.snapshot
    sample = snapshot.hosts.get(request.host.name)
    task = sample.tasks.get(act.name) if sample is not None else None
    known = snapshot.manager.placements.get(act.name) if snapshot.manager is not None else None
    holder = snapshot.hosts.get(known.host) if known is not None else None
    if known is not None and known.host != request.host.name and holder is not None and holder.ok:
        return False
    return request.body.get("instance") is not None and task is not None and task.state.alive


def _start_task(act: StepRun, planned: PlannedPhase, variables: Mapping[str, str]) -> None:
    """Start the task; the same attempt twice is one start. A restored instance is a second attempt."""
    host = planned.host.name
    with act.phase(planned.phase, host):
        if _send_start(act, planned, variables).get("role") == protocol.ROLE_STANDBY:
            message = f"{act.name} waits inactive on {host}, which the plan did not know"
            raise HostError(message, hint="apply again", host=host)


def _start_standby(act: StepRun, planned: PlannedPhase) -> None:
    """Start an inactive copy and wait until it can be activated; one that waits there already will do."""
    host, wait = planned.host, planned.requests[1]
    deadline = time.monotonic() + planned.timeout_s
    with act.phase(planned.phase, host.name):
        variables = resolve_variables(act, act.run.tasks.tasks[act.name], host.name)
        answer = _send_start(act, planned, variables)
        if answer.get("role") != protocol.ROLE_STANDBY:
            raise HostError(f"{act.name} is not inactive on {host.name}", hint="apply again", host=host.name)
        _wait_on_host(act.run, planned, wait, act.started, deadline)


def _send_start(act: StepRun, planned: PlannedPhase, variables: Mapping[str, str]) -> Request:
    request, host = planned.requests[0], planned.host
    attempt = 2 if planned.phase is Phase.RESTORE else 1
    instance = act.instance(host.name, attempt)
    body = host_requests.fill_start_request(
        request.body,
        instance=instance,
        generation=min(protocol.MAX_GENERATION, act.generation + attempt - 1),
        manager=describe_manager(),
        variables=variables,
        needed=join_marks(act.task, act.needed) if act.task is not None else "",
    )
    answer = act.run.ask(host, body, timeout=request.timeout_s + act.run.options.call_s)
    if answer.get("state") not in (protocol.STARTED, protocol.ALREADY_RUNNING):
        why = clean_text(answer.get("detail"), _MAX_DETAIL) or "no reason was given"
        raise HostError(f"{act.name} did not start on {host.name}: {why}", host=host.name)
    act.started = clean_text(answer.get("instance") or instance, _MAX_DETAIL)
    return answer


def _adopt_task(act: StepRun, planned: PlannedPhase, variables: Mapping[str, str]) -> None:
    """Let a new supervisor take over the running instance; the same request twice is one takeover."""
    request, host = planned.requests[0], planned.host
    body = host_requests.fill_start_request(
        request.body,
        instance=act.step.instances[host.name],
        generation=act.generation,
        manager=describe_manager(),
        variables=variables,
    )
    with act.phase(planned.phase, host.name):
        act.run.ask(host, body, timeout=request.timeout_s + act.run.options.call_s)


def _wait_until_ready(act: StepRun, planned: PlannedPhase) -> None:
    """Wait for the instance that was started last; a check on the robot is asked there, then marked."""
    deadline = time.monotonic() + planned.timeout_s
    wait, *elsewhere = planned.requests
    with act.phase(Phase.READY, planned.host.name, side_effect=False):
        _wait_on_host(act.run, planned, wait, act.started, deadline)
        if elsewhere:
            check, mark = elsewhere
            if not _repeat_check(act.run, check, deadline):
                asked = act.task.ready.describe() if act.task is not None and act.task.ready else ""
                raise HostError(
                    f"the check on {check.host.name} did not pass within {check.timeout_s:.3g} s: {asked}",
                    host=check.host.name,
                )
            _send(act.run, mark, instance=act.started)


def _wait_on_host(
    run: RunContext, planned: PlannedPhase, wait: PlannedRequest, instance: str, deadline: float
) -> None:
    """Ask the host, in pieces, until the instance is ready; a copy, until it can be activated.

    Raises:
        HostError: failed, gone, or not ready by the ``deadline`` (monotonic).
    """
    host, task, piece = planned.host, run.tasks.tasks[planned.task], wait.timeout_s
    body: Request = {**wait.body, "instance": instance}
    checked = _is_checked_on_host(task, copy=planned.phase is Phase.STANDBY)
    hint = f"edgectl logs {task.name}"
    while True:
        earliest = time.monotonic() + min(piece, run.options.poll_s)
        entry = run.ask(host, {**body, "timeout_s": piece}, timeout=piece + run.options.call_s)
        if _is_ready(task, entry, checked=checked):
            return
        if entry.get("state") not in (protocol.STARTING, protocol.RUNNING, protocol.UNHEALTHY):
            raise HostError(f"{task.name} {_describe_end(entry)} on {host.name}", hint=hint, host=host.name)
        if time.monotonic() >= deadline:
            why = f": {clean_text(entry['detail'], _MAX_DETAIL)}" if entry.get("detail") else ""
            raise HostError(
                f"{task.name} was not ready on {host.name} within {planned.timeout_s:.3g} s{why}",
                hint=hint,
                host=host.name,
            )
        # A host waits as it was asked; one that replies at once shall not keep us busy.
        time.sleep(max(0.0, earliest - time.monotonic()))
        piece = max(0.0, min(WAIT_PIECE_S, deadline - time.monotonic()))


def _is_checked_on_host(task: Task, *, copy: bool) -> bool:
    """Whether the host decides by more than time whether an instance is ready."""
    if copy:
        return not get_copy_up_time(task)
    return task.ready is not None and task.ready.on is CheckLocation.HOST


def _is_ready(task: Task, entry: Request, *, checked: bool) -> bool:
    """Whether a reply to a wait shows the task ready; ``settled`` is false where only its time ran out."""
    state = entry.get("state")
    return (
        state == protocol.READY
        or (state == protocol.RUNNING and not checked and entry.get("settled") is not False)
        or (state == protocol.COMPLETED and task.kind is TaskKind.JOB)
    )


def _describe_end(entry: Request) -> str:
    """The reason why a task does not run."""
    words = {
        protocol.FAILED: "failed",
        protocol.CRASHLOOP: "crashed again and again",
        protocol.COMPLETED: "ended at once",
    }
    state = words.get(str(entry.get("state")), "is gone")
    code = entry.get("exit_code")
    return state if code is None else f"{state} (exit code {clean_text(code, _MAX_DETAIL)})"


def _repeat_check(run: RunContext, check: PlannedRequest, deadline: float) -> bool:
    """Repeat a check until it passes; False where it did not by the ``deadline`` (monotonic)."""
    while True:
        left = max(_MIN_CHECK_S, min(check.timeout_s, deadline - time.monotonic()))
        body = {**check.body, "timeout_s": left}
        if run.ask(check.host, body, timeout=left + run.options.call_s).get("exit") == 0:
            return True
        if time.monotonic() >= deadline:
            return False
        time.sleep(run.options.poll_s)


def _wait_until_safe(act: StepRun, planned: PlannedPhase) -> None:
    """Wait until a handoff is safe; nothing has been touched so far."""
    with act.phase(Phase.SAFE, planned.host.name, side_effect=False):
        if not _repeat_check(act.run, planned.requests[0], time.monotonic() + planned.timeout_s):
            raise HostError(
                f"not safe to move {act.name} within {planned.timeout_s:.3g} s",
                hint="apply again later",
                host=planned.host.name,
            )


def _run_hook(act: StepRun, planned: PlannedPhase) -> None:
    """Run the hold or release hook."""
    phase, host = planned.phase, planned.host
    with act.phase(phase, host.name):
        answer = _send(act.run, planned.requests[0])
        if answer.get("exit") != 0:
            raise HostError(
                f"{phase.value} hook of {act.name} failed on {host.name}: {_describe_hook_failure(answer)}",
                host=host.name,
            )
    if phase is Phase.RELEASE:
        act.run.record("released", task=act.name)


def _describe_hook_failure(answer: Request) -> str:
    lines = str(answer.get("output") or "").strip().splitlines()
    if lines:
        return clean_text(lines[-1], _MAX_DETAIL)
    return (
        "timed out" if answer.get("timed_out") else f"exit code {clean_text(answer.get('exit'), _MAX_DETAIL)}"
    )


def _perform_need(act: StepRun, planned: PlannedPhase) -> None:
    if planned.timeout_s:
        _wait_for_predecessor(act.run, planned)
    else:
        _note_run_of_need(act, planned)


def _wait_for_predecessor(run: RunContext, planned: PlannedPhase) -> None:
    """Wait for a predecessor that runs already, or for a job to complete."""
    request, deadline = planned.requests[0], time.monotonic() + planned.timeout_s
    if request.body["op"] == protocol.OP_WAIT:
        _wait_on_host(run, planned, request, str(request.body["instance"]), deadline)
        return
    while not _is_reported_completed(_send(run, request), planned.task):
        if time.monotonic() >= deadline:
            raise HostError(f"waits for {planned.task} to complete", hint="apply again once it has")
        time.sleep(run.options.poll_s)


def _note_run_of_need(act: StepRun, planned: PlannedPhase) -> None:
    """Note with which run of a predecessor the task starts."""
    entries = _send(act.run, planned.requests[0]).get("tasks")
    entry = entries.get(planned.task) if isinstance(entries, dict) else None
    if isinstance(entry, dict) and entry.get("state") in protocol.ALIVE_STATES:
        restarts = entry.get("restarts")
        act.needed[planned.task] = mark_run(
            str(entry.get("instance")), restarts if isinstance(restarts, int) else 0
        )


def _is_reported_completed(answer: Request, name: str) -> bool:
    entries = answer.get("tasks")
    entry = entries.get(name) if isinstance(entries, dict) else None
    return isinstance(entry, dict) and entry.get("state") == protocol.COMPLETED
