"""Requests to the agent of a host, as values. Pure."""

import hashlib
from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.model.check import AliveRule, Check, CheckLocation, OnUnhealthy
from edgectl.model.inventory import Host
from edgectl.model.task import StopRule, Task
from edgectl.rules.environment import drop_secrets, merge_environment
from edgectl.rules.ros import encode_question, encode_ros

Request = dict[str, object]
Hosts = Mapping[str, Host]
# Placeholders in a request that is not filled yet.
NO_INSTANCE, NO_GENERATION, NO_MANAGER = "0", 0, ""
# How long a command without a ready check must have run until it counts as ready: most that die at start do
# so within it (a missing library, a refused connection, a bad argument).
DEFAULT_UP_S = 3.0


def build_instance_id(plan_id: str, task: str, host: str, attempt: int) -> str:
    """The name of one start: the same for a repeated request, another for every other start."""
    return hashlib.sha256("\0".join((plan_id, task, host, str(attempt))).encode()).hexdigest()[:16]


def build_start_request(
    task: Task, host: Host, hosts: Hosts, *, role: str = protocol.ROLE_ACTIVE
) -> Request:
    """Start ``task`` on ``host`` under its supervisor; a ready check on the robot is left to the manager.

    ``role``: whether it is to become active, or to wait inactive. Secrets are masked, instance, generation and manager are placeholders; `fill_start_request` completes it.
    """
    ready = task.ready if task.ready is not None and task.ready.on is CheckLocation.HOST else None
    spec: Request = {
        "command": task.command,
        "prelude": host.prelude,
        "env": merge_environment(task, host, hosts),
        "workdir": task.workdir,
        "kind": task.kind.value,
        "restart": task.restart.value,
        "stop": encode_stop_rule(task.stop),
        "ready": None if ready is None else _encode_check(ready, host),
        "alive": None if task.alive is None else _encode_alive(task.alive, host),
        "ros": encode_ros(task, host, hosts),
        "log": {"max_bytes": int(task.log.max_size), "files": task.log.files},
        "limits": {"cpu": task.limits.cpu, "memory": task.limits.memory},
        "runtime": host.runtime.value,
        "self_fence_s": task.self_fence,
        "spec_hash": task.spec_hash,
        "fields": dict(task.spec_fields),
        "file": task.file,
        "needed": "",
        "activation": _encode_activation(task, host),
    }
    return {
        "op": protocol.OP_START,
        "fleet": host.fleet,
        "host": host.name,
        "task": task.name,
        "instance": NO_INSTANCE,
        "generation": NO_GENERATION,
        "manager": NO_MANAGER,
        "role": role,
        "spec": spec,
    }


def _encode_activation(task: Task, host: Host) -> Request | None:
    """How the instance becomes active and inactive; None: it is active from its start."""
    rule = task.activation
    if rule is None:
        return None
    pair = {"activate": rule.activate, "deactivate": rule.deactivate, "ready": rule.ready}
    checks = {key: None if check is None else _encode_check(check, host) for key, check in pair.items()}
    return {**checks, "lifecycle": rule.lifecycle, "up_s": get_copy_up_time(task)}


def get_copy_up_time(task: Task) -> float:
    """How long (s) an inactive copy must have run until it can be activated; 0 where that can be asked."""
    rule = task.activation
    if rule is None or rule.ready is not None or rule.lifecycle is not None:
        return 0.0
    return DEFAULT_UP_S if task.up is None else task.up


def _encode_check(check: Check, host: Host) -> Request:
    return {**encode_question(check, host), "timeout_s": check.timeout}


def _encode_alive(rule: AliveRule, host: Host) -> Request:
    return {
        **_encode_check(rule.check, host),
        "after_s": rule.after,
        "restart": rule.on_unhealthy is OnUnhealthy.RESTART,
    }


def build_takeover_request(task: Task, host: Host, hosts: Hosts) -> Request:
    """Give the living instance of ``task`` on ``host``, whose supervisor was lost, a new one; completed as a
    start request is.
    """
    return {**build_start_request(task, host, hosts), "op": protocol.OP_TAKE_OVER}


def fill_start_request(
    request: Request,
    *,
    instance: str,
    generation: int,
    manager: str,
    variables: Mapping[str, str],
    needed: str = "",
) -> Request:
    """A start request as it is sent.

    ``manager``: user and machine, for people who find the task on the host. ``variables``: its environment
    with the secrets in clear. ``needed``: marks of the runs of its predecessors.
    """
    spec = request["spec"]
    filled = {**spec, "env": dict(variables), "needed": needed} if isinstance(spec, dict) else spec
    return {**request, "instance": instance, "generation": generation, "manager": manager, "spec": filled}


def fill_switch_request(
    request: Request,
    *,
    instance: str,
    generation: int,
    manager: str,
    variables: Mapping[str, str],
    await_go_s: float = 0.0,
) -> Request:
    """A request that makes an instance active or inactive, as it is sent; see `fill_start_request`.

    ``await_go_s``: how long the host waits for the word to go on, once it is prepared; 0: not at all.
    """
    spec = request["spec"]
    filled = {**spec, "env": dict(variables)} if isinstance(spec, dict) else spec
    return {
        **request,
        "instance": instance,
        "generation": generation,
        "manager": manager,
        "spec": filled,
        "await_go_s": await_go_s,
    }


def build_switch_request(op: str, task: Task, host: Host, hosts: Hosts, instance: str) -> Request:
    """Make ``instance`` active or inactive (``op``); completed by `fill_switch_request`."""
    spec: Request = {
        "env": merge_environment(task, host, hosts),
        "prelude": host.prelude,
        "ros": encode_ros(task, host, hosts),
        "activation": _encode_activation(task, host),
    }
    return {
        "op": op,
        "fleet": host.fleet,
        "host": host.name,
        "task": task.name,
        "instance": instance,
        "generation": NO_GENERATION,
        "manager": NO_MANAGER,
        "spec": spec,
        "await_go_s": 0.0,
    }


def build_stop_request(
    name: str, host: Host, *, task: Task | None, instance: str | None, lease_s: float = 0.0
) -> Request:
    """Stop the processes of ``name``; a task that left the files (None) is stopped as it was started.

    The generation is a placeholder. ``lease_s``: how long to wait until a graph of ROS 2 has forgotten its
    nodes.
    """
    rule = None if task is None else encode_stop_rule(task.stop)
    return {
        "op": protocol.OP_STOP,
        "fleet": host.fleet,
        "host": host.name,
        "task": name,
        "instance": instance or None,
        "generation": NO_GENERATION,
        "stop": rule,
        "lease_s": lease_s,
    }


def build_forget_request(
    host: Host, *, task: str | None, master: str = "", nodes: Mapping[str, str] | None = None
) -> Request:
    """Remove what nodes of an ended instance have registered: of a task as ``host`` knows it, or these
    ``nodes`` of a host that is gone.
    """
    return {
        "op": protocol.OP_FORGET,
        "fleet": host.fleet,
        "host": host.name,
        "task": task,
        "master": master,
        "nodes": dict(nodes or {}),
    }


def encode_stop_rule(rule: StopRule) -> Request:
    """How a task is stopped."""
    return {"signal": rule.signal, "grace_s": rule.grace, "preset": rule.preset}


def build_wait_request(
    name: str, host: Host, *, instance: str, timeout_s: float, up_s: float = 0.0
) -> Request:
    """Wait on the host until the instance is ready, has failed or is gone. ``up_s``: without a ready check,
    how long its command must have run.
    """
    return {
        "op": protocol.OP_WAIT,
        "fleet": host.fleet,
        "host": host.name,
        "task": name,
        "instance": instance,
        "timeout_s": timeout_s,
        "up_s": up_s,
    }


def build_mark_ready_request(name: str, host: Host, *, instance: str) -> Request:
    """Mark the instance as ready on the host after a ready check elsewhere passed."""
    return {
        "op": protocol.OP_MARK,
        "fleet": host.fleet,
        "host": host.name,
        "task": name,
        "instance": instance,
        "ready": True,
    }


def build_check_request(
    task: Task, rule: Check, host: Host, hosts: Hosts, *, timeout_s: float | None = None
) -> Request:
    """Run a check or hook of ``task`` on ``host``; secrets are for the task alone."""
    return {
        "op": protocol.OP_CHECK,
        "fleet": host.fleet,
        "host": host.name,
        **encode_question(rule, host),
        "prelude": host.prelude,
        "ros": encode_ros(task, host, hosts),
        "env": drop_secrets(merge_environment(task, host, hosts)),
        "timeout_s": rule.timeout if timeout_s is None else timeout_s,
    }


def build_renewal_request(host: Host, signature: Mapping[str, object]) -> Request:
    """Renew the lease of the fleet on a host."""
    return {
        "op": protocol.OP_LEASE,
        "fleet": host.fleet,
        "host": host.name,
        "action": "renew",
        "lease": signature,
        "end_watch": False,
    }


def build_status_request(host: Host, name: str | None = None) -> Request:
    """The state of one task, or of all, as the host knows it, without a measurement."""
    return {"op": protocol.OP_STATUS, "fleet": host.fleet, "host": host.name, "task": name}
