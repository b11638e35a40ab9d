# SPDX-License-Identifier: Apache-2.0
"""Requests to the agent of a host, as values. Pure."""

import hashlib
from collections.abc import Collection, Mapping

from edgectl.agent.link import protocol
from edgectl.model.check import AliveRule, Check, CheckLocation, OnUnhealthy
from edgectl.model.image import ContainerImage
from edgectl.model.inventory import Host
from edgectl.model.latency import HeardRule
from edgectl.model.standby import Activation
from edgectl.model.task import StopRule, Task
from edgectl.rules.environment import drop_secrets, merge_environment
from edgectl.rules.ros import encode_question, encode_ros, fill_host_name

Request = dict[str, object]
Hosts = Mapping[str, Host]
# Placeholders in a request that is not filled yet.
NO_INSTANCE, NO_GENERATION, NO_MANAGER = "0", 0, ""
# Seconds of an activation besides its commands: boot of the agent, set-up files, transitions of a lifecycle.
SWITCH_MARGIN_S = 30.0


def build_instance_id(plan_id: str, task: str, host: str, attempt: int) -> str:
    """The name of one start: the same for a repeated request, another for every other start."""
    return hashlib.sha256("\0".join((plan_id, task, host, str(attempt))).encode()).hexdigest()[:16]


def build_start_request(
    task: Task,
    host: Host,
    hosts: Hosts,
    role: str = protocol.ROLE_ACTIVE,
    *,
    replaces: Collection[str] | None = None,
) -> Request:
    """Start ``task`` on ``host`` under its supervisor; a ready check on the robot is left to the manager.

    ``role``: of a task with an activation, whether the instance is made active once it is ready for that.

    Secrets are masked, instance, generation and manager are placeholders; `fill_start_request` completes it.
    ``replaces``: another instance runs until this one is ready, with nodes at these addresses; None: none.
    """
    return {
        "op": protocol.OP_START,
        "fleet": host.fleet,
        "host": host.name,
        "task": task.name,
        "instance": NO_INSTANCE,
        "generation": NO_GENERATION,
        "manager": NO_MANAGER,
        "role": role,
        "spec": {**_encode_spec(task, host, hosts), "replaces": None if replaces is None else list(replaces)},
        "keep_state": False,
    }


def _encode_spec(task: Task, host: Host, hosts: Hosts) -> Request:
    ready = task.ready if task.ready is not None and task.ready.on is CheckLocation.HOST else None
    return {
        "command": task.command,
        "prelude": host.prelude,
        "env": merge_environment(task, host, hosts),
        "workdir": task.host_workdir,
        "image": None if task.image is None else _encode_image(task, task.image, host),
        "kind": task.kind.value,
        "restart": task.restart.value,
        "stop": encode_stop_rule(task.stop),
        "ready": None if ready is None else _encode_check(ready, host),
        "alive": None if task.alive is None else _encode_alive(task.alive, host),
        "activation": None if task.activation is None else _encode_activation(task, task.activation, host),
        "ros": encode_ros(task, host, hosts),
        "log": {"max_bytes": int(task.log.max_size), "files": task.log.files},
        "limits": {"cpu": task.limits.cpu, "memory": task.limits.memory},
        "runtime": host.runtime.value,
        "self_fence_s": task.self_fence,
        "spec_hash": task.spec_hash,
        "fields": dict(task.spec_fields),
        "file": task.file,
        "needed": "",
        "replaces": None,
    }


def _encode_image(task: Task, image: ContainerImage, host: Host) -> Request:
    """The container of a task; its variables are among those of the task."""
    return {
        "name": image.name,
        "engine": None if image.engine is None else image.engine.value,
        "gpus": image.gpus,
        "devices": list(image.devices),
        "volumes": list(image.volumes),
        "user": image.user,
        "network": image.network,
        "ipc": image.ipc,
        "pull": image.pull.value,
        "args": list(image.args),
        "workdir": task.workdir,
        "managers": list(host.swarm),
    }


def _encode_activation(task: Task, rule: Activation, host: Host) -> Request:
    """How an instance becomes active and inactive, and how it is known that it can."""
    return {
        "activate": None if rule.activate is None else _encode_check(rule.activate, host),
        "deactivate": None if rule.deactivate is None else _encode_check(rule.deactivate, host),
        "lifecycle": None if rule.lifecycle is None else fill_host_name(rule.lifecycle, host),
        "ready": None if rule.ready is None else _encode_check(rule.ready, host),
        "up_s": task.up,
    }


def build_activate_request(
    task: Task, host: Host, hosts: Hosts, *, instance: str, await_go_s: float = 0.0
) -> Request:
    """Make the inactive ``instance`` active; completed as a start request is.

    ``await_go_s`` above 0: the host prepares it and waits so long for ``go`` (`hold_agent_call`).
    """
    return _build_switch_request(protocol.OP_ACTIVATE, task, host, hosts, instance, await_go_s)


def build_deactivate_request(
    task: Task, host: Host, hosts: Hosts, *, instance: str, await_go_s: float = 0.0
) -> Request:
    """Make the active ``instance`` inactive, with proof; otherwise as `build_activate_request`."""
    return _build_switch_request(protocol.OP_DEACTIVATE, task, host, hosts, instance, await_go_s)


def _build_switch_request(
    op: str, task: Task, host: Host, hosts: Hosts, instance: str, await_go_s: float
) -> Request:
    return {
        "op": op,
        "fleet": host.fleet,
        "host": host.name,
        "task": task.name,
        "instance": instance,
        "generation": NO_GENERATION,
        "manager": NO_MANAGER,
        "spec": _encode_spec(task, host, hosts),
        "await_go_s": await_go_s,
    }


def compute_switch_timeout_s(rule: Activation) -> float:
    """Seconds that an activation or a deactivation may take, the way back of a failed one included.

    As the ``timeout`` of a call of these requests, or of `hold_agent_call`.
    """
    checks = [check for check in (rule.activate, rule.deactivate) if check is not None]
    return SWITCH_MARGIN_S + sum(check.timeout for check in checks)


def _encode_check(check: Check, host: Host) -> Request:
    return {**encode_question(check, host), "timeout_s": check.timeout}


def _encode_alive(rule: AliveRule, host: Host) -> Request:
    return {
        **_encode_check(rule.check, host),
        "after_s": rule.after,
        "restart": rule.on_unhealthy is OnUnhealthy.RESTART,
    }


def build_pull_request(task: Task, image: ContainerImage, host: Host, *, timeout_s: float) -> Request:
    """Have the image of ``task`` on ``host``; the instance, for which it is pulled once, is a placeholder."""
    return {
        "op": protocol.OP_PULL,
        "fleet": host.fleet,
        "host": host.name,
        "task": task.name,
        "instance": NO_INSTANCE,
        "image": _encode_image(task, image, host),
        "timeout_s": timeout_s,
    }


def build_takeover_request(task: Task, host: Host, hosts: Hosts) -> Request:
    """Give the living instance of ``task`` on ``host``, whose supervisor was lost, a new one; completed as a
    start request is.
    """
    request = {**build_start_request(task, host, hosts), "op": protocol.OP_TAKE_OVER}
    return {key: request[key] for key in request if key != "keep_state"}


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
        "keep_state": False,
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


def build_leaving_request(name: str, host: Host, *, instance: str, seconds: float) -> Request:
    """Tell the supervisor of an instance that its successor starts elsewhere, for at most ``seconds``; 0: it
    does so no longer.
    """
    return {
        "op": protocol.OP_MARK,
        "fleet": host.fleet,
        "host": host.name,
        "task": name,
        "instance": instance,
        "ready": False,
        "leaving_s": seconds,
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
        "leaving_s": None,
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


def build_hear_request(
    task: Task,
    rule: HeardRule,
    host: Host,
    hosts: Hosts,
    *,
    watch: str,
    action: str,
    after_s: float,
    timeout_s: float,
) -> Request:
    """Begin or end the watcher ``watch`` on a robot. ``after_s``: how long ago the old instance had ended;
    ``timeout_s``: how long to wait until the robot hears the task.
    """
    return {
        "op": protocol.OP_HEAR,
        "fleet": host.fleet,
        "host": host.name,
        "task": task.name,
        "watch": watch,
        "action": action,
        "topic": rule.topic,
        "command": rule.command,
        "prelude": host.prelude,
        "ros": encode_ros(task, host, hosts),
        "env": drop_secrets(merge_environment(task, host, hosts)),
        "after_s": after_s,
        "timeout_s": timeout_s,
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
