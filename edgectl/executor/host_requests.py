"""What is asked of a host, as values: used to run a plan and, unsent, to show it (``--dry-run``)."""

import hashlib
from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.model.environment import drop_secrets, merge_environment
from edgectl.model.inventory import Host
from edgectl.model.task import Check, CheckLocation, StopRule, Task

Request = dict[str, object]
Hosts = Mapping[str, Host]


def build_instance_id(plan_id: str, task: str, host: str, attempt: int) -> str:
    """The name of one start: the same for a repeated request, another for every other start."""
    return hashlib.sha256("\0".join((plan_id, task, host, str(attempt))).encode()).hexdigest()[:16]


def build_start_request(
    task: Task,
    host: Host,
    hosts: Hosts,
    *,
    instance: str,
    generation: int,
    variables: Mapping[str, str] | None = None,
) -> Request:
    """Start ``task`` on ``host`` under its supervisor; a ready check that runs on the robot is left to us.

    ``variables``: its environment with the secrets in clear; without it they are masked, and the request is only to be looked at.
    """
    ready = task.ready if task.ready is not None and task.ready.on is CheckLocation.HOST else None
    spec: Request = {
        "command": task.command,
        "prelude": host.prelude,
        "env": merge_environment(task, host, hosts) if variables is None else dict(variables),
        "workdir": task.workdir,
        "kind": task.kind.value,
        "restart": task.restart.value,
        "stop": encode_stop_rule(task.stop),
        "ready": None if ready is None else {"command": ready.command, "timeout_s": ready.timeout},
        "log": {"max_bytes": int(task.log.max_size), "files": task.log.files},
        "limits": {"cpu": task.limits.cpu, "memory": task.limits.memory},
        "runtime": host.runtime.value,
        "self_fence_s": task.self_fence,
        "spec_hash": task.spec_hash,
        "fields": dict(task.spec_fields),
    }
    return {
        "op": protocol.OP_START,
        "host": host.name,
        "task": task.name,
        "instance": instance,
        "generation": generation,
        "spec": spec,
    }


def build_stop_request(
    name: str, host: Host, *, task: Task | None, instance: str | None, generation: int | None = None
) -> Request:
    """Stop what runs as ``name``; a task that left the file (None) is stopped as it was started."""
    rule = None if task is None else encode_stop_rule(task.stop)
    return {
        "op": protocol.OP_STOP,
        "host": host.name,
        "task": name,
        "instance": instance or None,
        "generation": generation,
        "stop": rule,
    }


def encode_stop_rule(rule: StopRule) -> Request:
    """How a task is stopped."""
    return {"signal": rule.signal, "grace_s": rule.grace, "preset": rule.preset}


def build_wait_request(name: str, host: Host, *, instance: str, timeout_s: float) -> Request:
    """Wait on the host until the instance is ready, has failed or is gone."""
    return {
        "op": protocol.OP_WAIT,
        "host": host.name,
        "task": name,
        "instance": instance,
        "timeout_s": timeout_s,
    }


def build_mark_ready_request(name: str, host: Host, *, instance: str) -> Request:
    """Tell the host that a ready check elsewhere said yes."""
    return {"op": protocol.OP_MARK, "host": host.name, "task": name, "instance": instance, "ready": True}


def build_check_request(
    task: Task, rule: Check, host: Host, hosts: Hosts, *, timeout_s: float | None = None
) -> Request:
    """Run a check or hook of ``task`` on ``host``; secrets are for the task alone."""
    return {
        "op": protocol.OP_CHECK,
        "host": host.name,
        "command": rule.command,
        "prelude": host.prelude,
        "env": drop_secrets(merge_environment(task, host, hosts)),
        "timeout_s": rule.timeout if timeout_s is None else timeout_s,
    }


def build_status_request(host: Host, name: str | None = None) -> Request:
    """What the host knows of one task, or of all, without measuring."""
    return {"op": protocol.OP_STATUS, "host": host.name, "task": name}
