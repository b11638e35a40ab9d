# SPDX-License-Identifier: Apache-2.0
"""Tasks in the reply to a probe -> TaskSamples. Pure."""

from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.errors import ReplyError
from edgectl.gateway.replies import (
    TASK_USAGE,
    ProbeReply,
    TaskReply,
    decode_reply,
)
from edgectl.model.resource import RESOURCES, Usage
from edgectl.model.snapshot import (
    TaskSample,
    TaskState,
)
from edgectl.model.standby import is_standby_entry

# Larger ones overflow in a mean or a deviation.
_MAX_METRIC = 1e100
# Of one host, those that it only remembers included.
_MAX_TASKS = 2000


def build_task_samples(
    reply: ProbeReply, answered_at: float, *, detected: frozenset[str], reopened: frozenset[str]
) -> dict[str, TaskSample]:
    """The tasks of a host that answered at ``answered_at`` (s since 1970).

    Ended instances that were ``reopened``, tasks that were neither started by edgectl nor asked for
    (``detected``) and entries without a valid name are left out.

    Raises:
        ReplyError: there are too many.
    """
    if len(reply.tasks) + len(reply.generations) > _MAX_TASKS:
        raise ReplyError(f"more than {_MAX_TASKS} tasks in one reply")
    tasks = {
        name: _decode_task_or_stub(name, entry, answered_at)
        for name, entry in reply.tasks.items()
        if protocol.is_name(name)
    }
    return {
        name: task
        for name, task in tasks.items()
        if not (_has_ended(task) and task.instance in reopened) and (task.managed or name in detected)
    }


def _decode_task_or_stub(name: str, entry: object, answered_at: float) -> TaskSample:
    """The task of one entry. Where the entry cannot be read: its state, or RUNNING, because a task that may
    run here must not be started elsewhere.
    """
    try:
        return _decode_task(name, entry, answered_at)
    except ReplyError as error:
        word = entry.get("state") if isinstance(entry, dict) else None
        state = TaskState(word) if word in tuple(TaskState) else TaskState.RUNNING
        return TaskSample(
            state=TaskState.FAILED if state is TaskState.COMPLETED else state,
            started_at=answered_at,
            detail=f"its entry cannot be read: {error.message}",
        )


def separate_standbys(
    reply: ProbeReply, tasks: Mapping[str, TaskSample]
) -> tuple[dict[str, TaskSample], dict[str, TaskSample]]:
    """``tasks`` without the inactive copies, and these.

    An instance that is becoming active or inactive may be active, and so may one whose role cannot be read.
    """
    inactive = {name for name in tasks if is_standby_entry(reply.tasks.get(name))}
    return (
        {name: task for name, task in tasks.items() if name not in inactive},
        {name: task for name, task in tasks.items() if name in inactive},
    )


def build_generations(reply: ProbeReply, tasks: Mapping[str, TaskSample]) -> dict[str, int]:
    """Generations that the tasks do not show: an instance that no longer counts has used its generation."""
    found = {name: number for name, raw in reply.generations.items() if (number := _read_generation(raw))}
    for name, entry in reply.tasks.items():
        if name not in tasks and isinstance(entry, dict):
            found[name] = max(found.get(name, 0), _read_generation(entry.get("generation")))
    return {name: number for name, number in found.items() if number and protocol.is_name(name)}


def _read_generation(raw: object) -> int:
    """A generation, or 0 where it is none."""
    return raw if type(raw) is int and 0 < raw <= protocol.MAX_GENERATION else 0


def _has_ended(task: TaskSample) -> bool:
    return task.state is TaskState.COMPLETED or task.given_up


def _decode_task(name: str, entry: object, answered_at: float) -> TaskSample:
    where = f"tasks.{name}"
    reply = decode_reply(TaskReply, entry, where)
    usage = decode_reply(TASK_USAGE, entry, where)
    traffic = reply.rx_bytes_per_s + reply.tx_bytes_per_s
    return TaskSample(
        state=reply.state,
        pid=reply.pid,
        # The age of a run that has ended is unknown, and sent as 0.
        started_at=answered_at - reply.age_s if reply.state.alive or reply.pid else 0.0,
        used=Usage(
            {
                resource.name: traffic if resource.per_link else getattr(usage, resource.used_key)
                for resource in RESOURCES
            }
        ),
        links=reply.links or None,
        instance=reply.instance,
        spec_hash=reply.spec_hash,
        generation=reply.generation,
        managed=reply.managed,
        restarts=reply.restarts,
        exit_code=reply.exit_code,
        detail=reply.detail,
        fields={key: value for key, value in reply.fields.items() if key.isidentifier()},
        last_exit=reply.last_exit,
        log_tail=reply.log_tail,
        limits=reply.limits,
        given_up=reply.given_up,
        ended_at=None if reply.ended_s is None else answered_at - reply.ended_s,
        metrics=_select_metrics(reply.metrics),
        file=reply.file,
        orphaned=reply.orphaned,
        adoptable=reply.adoptable,
        needed=reply.needed,
        nodes=reply.nodes,
        partial=reply.partial,
        switching=reply.switching,
        deactivated=reply.deactivated,
        container=reply.container,
    )


def _select_metrics(values: Mapping[str, object]) -> dict[str, float]:
    """The metrics that an agent may send: so many, with such names, and of a size to compute with."""
    found = {
        name: float(value)
        for name, value in values.items()
        if protocol.is_metric_name(name)
        and type(value) in (int, float)
        and isinstance(value, int | float)
        and abs(value) <= _MAX_METRIC
    }
    return dict(list(found.items())[: protocol.MAX_TASK_METRICS])
