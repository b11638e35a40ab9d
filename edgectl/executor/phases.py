"""The phases that actions are made of: each does one thing on one host, or raises the HostError that says why not."""

import time
from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.executor import host_requests
from edgectl.executor.host_requests import Request
from edgectl.executor.secrets import resolve_environment
from edgectl.executor.step_run import RunContext, StepRun
from edgectl.model.inventory import Host
from edgectl.model.result import Phase
from edgectl.model.task import Check, CheckLocation, Task, TaskKind

# A wait is asked for in pieces, so that no channel lives long enough for a silent link to be mistaken for a slow task.
_WAIT_PIECE_S = 15.0
_DEFAULT_READY_S = 10.0
# Beyond the grace: SIGKILL, the sweeps that prove the end, and the way back.
_STOP_MARGIN_S = 20.0
_UNKNOWN_GRACE_S = 40.0


def check_reachable(run: RunContext, host_name: str) -> None:
    """Make sure that a host answers, before anything is done for its sake."""
    host = _get_host(run, host_name)
    run.ask(host, host_requests.build_status_request(host))


def stop_task(act: StepRun, host_name: str, *, instance: str | None, phase: Phase = Phase.STOP) -> None:
    """Stop the task on a host and have it proven gone."""
    host = _get_host(act.run, host_name)
    grace = act.task.stop.grace if act.task else _UNKNOWN_GRACE_S
    request = host_requests.build_stop_request(
        act.name, host, task=act.task, instance=instance, generation=act.generation
    )
    with act.phase(phase, host_name):
        answer = act.run.ask(host, request, timeout=grace + _STOP_MARGIN_S)
        if answer.get("state") not in (protocol.STOPPED, protocol.NOT_RUNNING):
            raise HostError(
                f"{act.name} did not stop completely on {host_name}: processes left {answer.get('left')}",
                hint=f"end them on {host_name}, then apply again",
                host=host_name,
            )


def resolve_variables(act: StepRun, task: Task, host_name: str) -> dict[str, str]:
    """The environment of a start with its secrets in clear, got before anything is touched for its sake."""
    return resolve_environment(task, _get_host(act.run, host_name), act.run.hosts)


def start_task(
    act: StepRun,
    task: Task,
    host_name: str,
    variables: Mapping[str, str],
    *,
    attempt: int = 1,
    phase: Phase = Phase.START,
) -> str:
    """Start the task on a host with ``variables``; the same attempt twice is one start. Returns the instance."""
    host = _get_host(act.run, host_name)
    instance = act.instance(host_name, attempt)
    generation = act.generation + attempt - 1
    request = host_requests.build_start_request(
        task, host, act.run.hosts, instance=instance, generation=generation, variables=variables
    )
    with act.phase(phase, host_name):
        answer = act.run.ask(host, request)
        if answer.get("state") not in (protocol.STARTED, protocol.ALREADY_RUNNING):
            raise HostError(
                f"{act.name} did not start on {host_name}: {answer.get('detail')}", host=host_name
            )
    return str(answer.get("instance") or instance)


def wait_for_ready(act: StepRun, task: Task, host_name: str, instance: str) -> None:
    """Wait until the instance is ready by the task's own check (running, where it has none)."""
    timeout = task.ready.timeout if task.ready else _DEFAULT_READY_S
    deadline = time.monotonic() + timeout
    host = _get_host(act.run, host_name)
    with act.phase(Phase.READY, host_name, side_effect=False):
        wait_for_ready_on_host(act.run, task, host, instance, deadline)
        if task.ready is not None and task.ready.on is CheckLocation.ROBOT:
            _wait_for_check(act, task, task.ready, _get_check_robot(act.run, task), deadline)
            act.run.ask(host, host_requests.build_mark_ready_request(task.name, host, instance=instance))


def wait_for_ready_on_host(run: RunContext, task: Task, host: Host, instance: str, deadline: float) -> None:
    """Ask the host until it says ready.

    Raises:
        HostError: failed, gone, or not ready by the ``deadline`` (monotonic).
    """
    here = task.ready is not None and task.ready.on is CheckLocation.HOST
    hint = f"edgectl logs {task.name}"
    while True:
        piece = max(0.0, min(_WAIT_PIECE_S, deadline - time.monotonic()))
        request = host_requests.build_wait_request(task.name, host, instance=instance, timeout_s=piece)
        entry = run.ask(host, request, timeout=piece + run.options.call_s)
        if _is_ready(task, str(entry.get("state")), checked=here):
            return
        if entry.get("state") not in (protocol.STARTING, protocol.RUNNING):
            raise HostError(f"{task.name} {_describe_end(entry)} on {host.name}", hint=hint, host=host.name)
        if time.monotonic() >= deadline:
            timeout = task.ready.timeout if task.ready else _DEFAULT_READY_S
            why = f": {entry['detail']}" if entry.get("detail") else ""
            raise HostError(
                f"{task.name} was not ready on {host.name} within {timeout:g} s{why}",
                hint=hint,
                host=host.name,
            )


def _is_ready(task: Task, state: str, *, checked: bool) -> bool:
    return (
        state == protocol.READY
        or (state == protocol.RUNNING and not checked)
        or (state == protocol.COMPLETED and task.kind is TaskKind.JOB)
    )


def _describe_end(entry: Request) -> str:
    """What became of a task that does not run, in words."""
    state = {"failed": "failed", "crashloop": "crashed again and again", "completed": "ended at once"}.get(
        str(entry.get("state")), "is gone"
    )
    code = entry.get("exit_code")
    return state if code is None else f"{state} (exit code {code})"


def _wait_for_check(act: StepRun, task: Task, rule: Check, host: Host, deadline: float) -> None:
    """Repeat a check on ``host`` until it says yes."""
    while not _is_check_passing(act.run, task, rule, host, deadline):
        if time.monotonic() >= deadline:
            raise HostError(
                f"check on {host.name} did not say yes within {rule.timeout:g} s: {rule.command}",
                host=host.name,
            )
        time.sleep(act.run.options.poll_s)


def _is_check_passing(run: RunContext, task: Task, rule: Check, host: Host, deadline: float) -> bool:
    left = max(0.1, min(rule.timeout, deadline - time.monotonic()))
    answer = run.ask(
        host,
        host_requests.build_check_request(task, rule, host, run.hosts, timeout_s=left),
        timeout=left + run.options.call_s,
    )
    return answer.get("exit") == 0


def wait_for_safe_handoff(act: StepRun, task: Task, host_name: str) -> None:
    """Wait until a handoff is safe, at most the handoff's timeout; nothing has been touched so far."""
    rule = task.handoff.safe_when
    if rule is None:
        return
    host = _get_check_host(act.run, task, rule, host_name)
    with act.phase(Phase.SAFE, host.name, side_effect=False):
        deadline = time.monotonic() + task.handoff.timeout
        while not _is_check_passing(act.run, task, rule, host, deadline):
            if time.monotonic() >= deadline:
                raise HostError(
                    f"not safe to move {act.name} within {task.handoff.timeout:g} s",
                    hint="apply again later",
                    host=host.name,
                )
            time.sleep(act.run.options.poll_s)


def run_hook(act: StepRun, task: Task, phase: Phase, rule: Check | None, host_name: str) -> None:
    """Run the hold or release hook, where there is one."""
    if rule is None:
        return
    host = _get_check_host(act.run, task, rule, host_name)
    with act.phase(phase, host.name):
        answer = act.run.ask(
            host,
            host_requests.build_check_request(task, rule, host, act.run.hosts),
            timeout=rule.timeout + act.run.options.call_s,
        )
        if answer.get("exit") != 0:
            raise HostError(
                f"{phase.value} hook of {act.name} failed on {host.name}: {_describe_hook_failure(answer)}",
                host=host.name,
            )
    if phase is Phase.RELEASE:
        act.run.record("released", task=act.name)


def _describe_hook_failure(answer: Request) -> str:
    lines = str(answer.get("output") or "").strip().splitlines()
    return (
        lines[-1]
        if lines
        else ("timed out" if answer.get("timed_out") else f"exit code {answer.get('exit')}")
    )


def _get_check_host(run: RunContext, task: Task, rule: Check, host_name: str) -> Host:
    return _get_check_robot(run, task) if rule.on is CheckLocation.ROBOT else _get_host(run, host_name)


def _get_check_robot(run: RunContext, task: Task) -> Host:
    if not task.robots:
        raise HostError(f"{task.name} has no robot on which its check could run")
    robot = _get_host(run, task.robots[0])
    if not robot.probe:
        raise HostError(
            f"the check of {task.name} needs {robot.name}, which is never contacted (probe: false)",
            host=robot.name,
        )
    return robot


def _get_host(run: RunContext, name: str) -> Host:
    host = run.hosts.get(name)
    if host is None:
        raise HostError(
            f"{name} is not in the inventory", hint="put it back until nothing runs there", host=name
        )
    return host
