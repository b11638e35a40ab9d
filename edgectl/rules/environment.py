# SPDX-License-Identifier: Apache-2.0
"""Environment of a task: variables merged from host and task."""

from collections.abc import Mapping

from edgectl.model.inventory import Host
from edgectl.model.secret import Secret
from edgectl.model.task import Task

Variables = Mapping[str, str]
NO_VARIABLES: Variables = {}
_ADDRESS_VARIABLES = ("ROS_IP", "ROS_HOSTNAME")


def merge_environment(
    task: Task,
    host: Host,
    hosts: Mapping[str, Host],
    *,
    host_more: Variables = NO_VARIABLES,
    task_more: Variables = NO_VARIABLES,
) -> dict[str, str]:
    """Variables of ``task`` on ``host``: the host's, then edgectl's own, then the task's, the later winning.

    Secrets are masked. EDGECTL_ROBOT and EDGECTL_ROBOT_HOST name the first robot and its address;
    EDGECTL_ROBOTS and EDGECTL_ROBOT_HOSTS all of them and their addresses, separated by spaces, in the same
    order. ``host_more`` and ``task_more`` are what the two ``env_command`` printed. What its image states
    comes last. What follows from ``ros`` of the host comes first of all; its address is left out where a name
    or an address is stated.
    """
    own = {"EDGECTL_TASK": task.name, "EDGECTL_HOST": host.name, "EDGECTL_ROBOTS": " ".join(task.robots)}
    if task.robots:
        own["EDGECTL_ROBOT_HOSTS"] = " ".join(hosts[robot].host for robot in task.robots if robot in hosts)
        own["EDGECTL_ROBOT"] = task.robots[0]
        own["EDGECTL_ROBOT_HOST"] = hosts[task.robots[0]].host if task.robots[0] in hosts else ""
    image = task.image.env if task.image is not None else NO_VARIABLES
    return _add_derived(host, {**host.env, **host_more, **own, **task.env, **task_more, **image})


def merge_host_environment(host: Host) -> dict[str, str]:
    """Variables of every task on ``host``, without those of any task."""
    return _add_derived(host, host.env)


def _add_derived(host: Host, stated: Variables) -> dict[str, str]:
    derived = host.ros.derive_variables() if host.ros is not None else NO_VARIABLES
    return {name: value for name, value in derived.items() if not _is_addressed(name, stated)} | {**stated}


def _is_addressed(name: str, stated: Variables) -> bool:
    """Whether ``name`` is an address of ROS 1 nodes that a stated one takes the place of."""
    return name in _ADDRESS_VARIABLES and any(other in stated for other in _ADDRESS_VARIABLES)


def drop_secrets(variables: Variables) -> dict[str, str]:
    """The variables without secrets: what checks and hooks get."""
    return {name: value for name, value in variables.items() if not isinstance(value, Secret)}


def reveal_secrets(variables: Variables) -> dict[str, str]:
    """The variables with every secret in clear: what the request that starts a task carries."""
    return {name: value.reveal() if isinstance(value, Secret) else value for name, value in variables.items()}
