# SPDX-License-Identifier: Apache-2.0
"""Requests that hand over the state of a task, as values. Pure."""

from edgectl.agent.link import protocol
from edgectl.executor.host_requests import NO_GENERATION, NO_INSTANCE, Hosts, Request
from edgectl.model.check import Check
from edgectl.model.inventory import Host
from edgectl.model.standby import StateRule
from edgectl.model.task import Task
from edgectl.rules.environment import drop_secrets, merge_environment
from edgectl.rules.ros import encode_ros

# How long a topic may take until its last message has come, or has been read.
_TOPIC = Check(timeout=30.0)
# Placeholder in a request that is not filled yet.
_NO_HASH = "0" * 64


def get_save(rule: StateRule) -> Check:
    """What saves the state, with its timeout; without a command where a topic has it."""
    return rule.save or _TOPIC


def get_load(rule: StateRule) -> Check:
    """What loads the state, as `get_save`."""
    return rule.load or _TOPIC


def build_save_request(
    task: Task, rule: StateRule, host: Host, hosts: Hosts, instance: str | None
) -> Request:
    """Keep the state of ``instance`` (None: the living one) on its host."""
    command = _build_command(protocol.OP_SAVE_STATE, task, rule, get_save(rule), host, hosts)
    return {**command, "instance": instance, "max_bytes": int(rule.max_bytes)}


def build_load_request(task: Task, rule: StateRule, host: Host, hosts: Hosts, *, repeat: bool) -> Request:
    """Give the state that was sent to ``host`` to the instance there.

    ``repeat``: until the timeout; a topic is offered for as long anyway.
    """
    command = _build_command(protocol.OP_LOAD_STATE, task, rule, get_load(rule), host, hosts)
    return {
        **command,
        "instance": NO_INSTANCE,
        "size": 0,
        "sha256": _NO_HASH,
        "repeat": repeat and rule.topic is None,
    }


def build_read_request(name: str, host: Host) -> Request:
    """Send the state that is kept on ``host``, from ``offset``."""
    return {**_build_base(protocol.OP_READ_STATE, name, host), "offset": 0}


def build_write_request(name: str, host: Host) -> Request:
    """Take room for a state of ``total`` bytes on ``host``, or take a piece of it."""
    counts = dict.fromkeys(("total", "offset", "size", "bytes"), 0)
    return {
        **_build_base(protocol.OP_WRITE_STATE, name, host),
        "generation": NO_GENERATION,
        **counts,
        "packed": False,
    }


def build_drop_request(name: str, host: Host, generation: int) -> Request:
    """Remove what is left of the state of a task on ``host``."""
    return {**_build_base(protocol.OP_DROP_STATE, name, host), "generation": generation}


def _build_base(op: str, name: str, host: Host) -> Request:
    return {"op": op, "fleet": host.fleet, "host": host.name, "task": name}


def _build_command(op: str, task: Task, state: StateRule, rule: Check, host: Host, hosts: Hosts) -> Request:
    """A command of the state as a hook is sent: secrets are for the task alone."""
    version = host.ros.version if host.ros is not None else 1
    return {
        **_build_base(op, task.name, host),
        "generation": NO_GENERATION,
        "command": rule.command,
        "topic": None if state.topic is None else {"name": state.topic, "version": version},
        "prelude": host.prelude,
        "ros": encode_ros(task, host, hosts),
        "env": drop_secrets(merge_environment(task, host, hosts)),
        "workdir": task.host_workdir,
        "timeout_s": rule.timeout,
    }
