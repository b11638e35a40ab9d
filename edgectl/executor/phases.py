"""The phases that actions are made of: each does one thing on one host, or raises the HostError that says why not."""

import time
from collections.abc import Mapping

from edgectl.errors import HostError
from edgectl.executor import requests
from edgectl.executor.act import Act, Run
from edgectl.executor.requests import Request
from edgectl.executor.reveal import reveal
from edgectl.model.inventory import Host
from edgectl.model.result import Phase
from edgectl.model.task import Check, Kind, Task, Where

# A wait is asked for in pieces, so that no channel lives long enough for a silent link to be mistaken for a slow task.
_WAIT_PIECE_S = 15.0
_WITHOUT_READY_S = 10.0
# Beyond the grace: SIGKILL, the sweeps that prove the end, and the way back.
_STOP_MARGIN_S = 20.0
_UNKNOWN_GRACE_S = 40.0


def reach(run: Run, host_name: str) -> None:
    """Make sure that a host answers, before anything is done for its sake."""
    host = _host(run, host_name)
    run.ask(host, requests.status(host))


def stop(act: Act, host_name: str, *, instance: str | None, phase: Phase = Phase.STOP) -> None:
    """Stop the task on a host and have it proven gone."""
    host = _host(act.run, host_name)
    grace = act.task.stop.grace if act.task else _UNKNOWN_GRACE_S
    request = requests.stop(act.name, host, task=act.task, instance=instance, generation=act.generation)
    with act.phase(phase, host_name):
        answer = act.run.ask(host, request, timeout=grace + _STOP_MARGIN_S)
        if answer.get("state") not in ("stopped", "not-running"):
            raise HostError(
                f"{act.name} did not stop completely on {host_name}: processes left {answer.get('left')}",
                hint=f"end them on {host_name}, then apply again",
                host=host_name,
            )


def variables(act: Act, task: Task, host_name: str) -> dict[str, str]:
    """The environment of a start with its secrets in clear, got before anything is touched for its sake."""
    return reveal(task, _host(act.run, host_name), act.run.hosts)


def start(act: Act, task: Task, host_name: str, variables: Mapping[str, str], *, attempt: int = 1, phase: Phase = Phase.START) -> str:
    """Start the task on a host with ``variables``; the same attempt twice is one start. Returns the instance."""
    host = _host(act.run, host_name)
    instance = act.instance(host_name, attempt)
    generation = act.generation + attempt - 1
    request = requests.start(task, host, act.run.hosts, instance=instance, generation=generation, variables=variables)
    with act.phase(phase, host_name):
        answer = act.run.ask(host, request)
        if answer.get("state") not in ("started", "already-running"):
            raise HostError(f"{act.name} did not start on {host_name}: {answer.get('detail')}", host=host_name)
    return str(answer.get("instance") or instance)


def await_ready(act: Act, task: Task, host_name: str, instance: str) -> None:
    """Wait until the instance is ready by the task's own check (running, where it has none)."""
    timeout = task.ready.timeout if task.ready else _WITHOUT_READY_S
    deadline = time.monotonic() + timeout
    host = _host(act.run, host_name)
    with act.phase(Phase.READY, host_name, side_effect=False):
        wait_until_ready(act.run, task, host, instance, deadline)
        if task.ready is not None and task.ready.on is Where.ROBOT:
            _poll(act, task, task.ready, _robot(act.run, task), deadline)
            act.run.ask(host, requests.mark_ready(task.name, host, instance=instance))


def wait_until_ready(run: Run, task: Task, host: Host, instance: str, deadline: float) -> None:
    """Ask the host until it says ready.

    Raises:
        HostError: failed, gone, or not ready by the ``deadline`` (monotonic).
    """
    here = task.ready is not None and task.ready.on is Where.HOST
    hint = f"edgectl logs {task.name}"
    while True:
        piece = max(0.0, min(_WAIT_PIECE_S, deadline - time.monotonic()))
        request = requests.wait(task.name, host, instance=instance, timeout_s=piece)
        entry = run.ask(host, request, timeout=piece + run.options.call_s)
        if _is_ready(task, str(entry.get("state")), checked=here):
            return
        if entry.get("state") not in ("starting", "running"):
            raise HostError(f"{task.name} {_ended(entry)} on {host.name}", hint=hint, host=host.name)
        if time.monotonic() >= deadline:
            timeout = task.ready.timeout if task.ready else _WITHOUT_READY_S
            why = f": {entry['detail']}" if entry.get("detail") else ""
            raise HostError(f"{task.name} was not ready on {host.name} within {timeout:g} s{why}", hint=hint, host=host.name)


def _is_ready(task: Task, state: str, *, checked: bool) -> bool:
    return state == "ready" or (state == "running" and not checked) or (state == "completed" and task.kind is Kind.JOB)


def _ended(entry: Request) -> str:
    """What became of a task that does not run, in words."""
    state = {"failed": "failed", "crashloop": "crashed again and again", "completed": "ended at once"}.get(
        str(entry.get("state")), "is gone"
    )
    code = entry.get("exit_code")
    return state if code is None else f"{state} (exit code {code})"


def _poll(act: Act, task: Task, rule: Check, host: Host, deadline: float) -> None:
    """Repeat a check on ``host`` until it says yes."""
    while not _says_yes(act.run, task, rule, host, deadline):
        if time.monotonic() >= deadline:
            raise HostError(f"check on {host.name} did not say yes within {rule.timeout:g} s: {rule.command}", host=host.name)
        time.sleep(act.run.options.poll_s)


def _says_yes(run: Run, task: Task, rule: Check, host: Host, deadline: float) -> bool:
    left = max(0.1, min(rule.timeout, deadline - time.monotonic()))
    answer = run.ask(host, requests.check(task, rule, host, run.hosts, timeout_s=left), timeout=left + run.options.call_s)
    return answer.get("exit") == 0


def await_safe(act: Act, task: Task, host_name: str) -> None:
    """Wait until a handoff is safe, at most the handoff's timeout; nothing has been touched so far."""
    rule = task.handoff.safe_when
    if rule is None:
        return
    host = _where(act.run, task, rule, host_name)
    with act.phase(Phase.SAFE, host.name, side_effect=False):
        deadline = time.monotonic() + task.handoff.timeout
        while not _says_yes(act.run, task, rule, host, deadline):
            if time.monotonic() >= deadline:
                raise HostError(f"not safe to move {act.name} within {task.handoff.timeout:g} s", hint="apply again later", host=host.name)
            time.sleep(act.run.options.poll_s)


def hook(act: Act, task: Task, phase: Phase, rule: Check | None, host_name: str) -> None:
    """Run the hold or release hook, where there is one."""
    if rule is None:
        return
    host = _where(act.run, task, rule, host_name)
    with act.phase(phase, host.name):
        answer = act.run.ask(host, requests.check(task, rule, host, act.run.hosts), timeout=rule.timeout + act.run.options.call_s)
        if answer.get("exit") != 0:
            raise HostError(f"{phase.value} hook of {act.name} failed on {host.name}: {_last_line(answer)}", host=host.name)
    if phase is Phase.RELEASE:
        act.run.record("released", task=act.name)


def _last_line(answer: Request) -> str:
    lines = str(answer.get("output") or "").strip().splitlines()
    return lines[-1] if lines else ("timed out" if answer.get("timed_out") else f"exit code {answer.get('exit')}")


def _where(run: Run, task: Task, rule: Check, host_name: str) -> Host:
    return _robot(run, task) if rule.on is Where.ROBOT else _host(run, host_name)


def _robot(run: Run, task: Task) -> Host:
    if not task.robots:
        raise HostError(f"{task.name} has no robot on which its check could run")
    robot = _host(run, task.robots[0])
    if not robot.probe:
        raise HostError(f"the check of {task.name} needs {robot.name}, which is never contacted (probe: false)", host=robot.name)
    return robot


def _host(run: Run, name: str) -> Host:
    host = run.hosts.get(name)
    if host is None:
        raise HostError(f"{name} is not in the inventory", hint="put it back until nothing runs there", host=name)
    return host
