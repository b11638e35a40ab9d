# SPDX-License-Identifier: Apache-2.0
"""Traffic of tasks that only the counters of their links saw. Pure."""

import dataclasses
from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.gateway.replies import LinkReply, ProbeReply
from edgectl.model.resource import NETWORK, Usage
from edgectl.model.snapshot import TaskSample, TrafficSource


def attribute_counted_traffic(
    reply: ProbeReply, tasks: Mapping[str, TaskSample], robots_of: Mapping[str, tuple[str, ...]]
) -> dict[str, TaskSample]:
    """The tasks, those that are counted by link only with a share of the traffic of their links.

    It is what the link carries besides TCP and besides the other tasks, evenly among them. Without it that
    traffic would be load of nobody, and be counted a second time by the demand of the task.
    """
    found = dict(tasks)
    if all(task.partial != protocol.UDP_BY_LINK for task in tasks.values()):
        return found
    for robot, link in reply.links.items():
        holders = [name for name in found if _is_counted_by_link(name, robot, found[name], robots_of)]
        if link.source is TrafficSource.COUNTERS and holders:
            share = _compute_rest(robot, link, found) / len(holders)
            found.update({name: _add_traffic(found[name], robot, share) for name in holders})
    return found


def _is_counted_by_link(
    name: str, robot: str, task: TaskSample, robots_of: Mapping[str, tuple[str, ...]]
) -> bool:
    return task.state.alive and task.partial == protocol.UDP_BY_LINK and robot in robots_of.get(name, ())


def _compute_rest(robot: str, link: LinkReply, tasks: Mapping[str, TaskSample]) -> float:
    seen = sum((task.links or {}).get(robot, 0.0) for task in tasks.values() if task.state.alive)
    return max(0.0, min(link.other_bytes_per_s, link.rx_bytes_per_s + link.tx_bytes_per_s - seen))


def _add_traffic(task: TaskSample, robot: str, rate: float) -> TaskSample:
    links = dict(task.links or {})
    links[robot] = links.get(robot, 0.0) + rate
    used = Usage({**task.used, NETWORK.name: task.used[NETWORK.name] + rate})
    return dataclasses.replace(task, links=links, used=used)
