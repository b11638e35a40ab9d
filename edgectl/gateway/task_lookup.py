"""The host that runs a task, or ran it last, and the instances that have ended."""

from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.gateway.fanout import HostReply, ask_all
from edgectl.gateway.reply_fields import (
    ReplyDocument,
    get_flag,
    get_number,
    get_objects,
    get_optional,
    get_text,
)
from edgectl.model.inventory import Host, Inventory
from edgectl.transport.base import Transport


def find_task_host(
    task: str, inventory: Inventory, transport: Transport, *, timeout: float
) -> tuple[Host | None, tuple[str, ...]]:
    """The host where ``task`` runs, else one that has it in another state; and the hosts that did not answer.

    Of several the youngest instance counts.
    """
    answers = _ask_task_status(task, inventory, transport, timeout)
    known = [name for name, entry in answers.items() if entry]
    best = min(known, key=lambda name: _rank_status(answers[name] or {}), default=None)
    return inventory.hosts[best] if best else None, _list_unanswered(answers)


def list_ended_instances(
    task: str, inventory: Inventory, transport: Transport, *, timeout: float
) -> tuple[frozenset[str], tuple[str, ...]]:
    """The instances of ``task`` that completed or were given up; and the hosts that did not answer."""
    answers = _ask_task_status(task, inventory, transport, timeout)
    over = (
        entry
        for entry in answers.values()
        if entry
        and (get_text(entry, "state") == protocol.COMPLETED or get_flag(entry, "given_up", default=False))
    )
    instances = (get_text(entry, "instance") for entry in over)
    return frozenset(instances), _list_unanswered(answers)


def _ask_task_status(
    task: str, inventory: Inventory, transport: Transport, timeout: float
) -> dict[str, ReplyDocument | None]:
    """The entry of the task on each host: empty where it never ran, None where the host does not answer."""
    hosts = [host for host in inventory.hosts.values() if host.probe]

    def build(host: Host, _left: float) -> dict[str, object]:
        return {"op": protocol.OP_STATUS, "host": host.name, "task": task}

    def decode(reply: HostReply) -> ReplyDocument:
        return get_objects(reply.document, "tasks").get(task, {})

    answers = {
        answer.host.name: None if isinstance(answer.value, HostError) else answer.value
        for answer in ask_all(hosts, transport, build, decode, timeout=timeout)
    }
    return {host.name: answers[host.name] for host in hosts}


def _list_unanswered(answers: Mapping[str, ReplyDocument | None]) -> tuple[str, ...]:
    return tuple(name for name, entry in answers.items() if entry is None)


def _rank_status(entry: ReplyDocument) -> tuple[bool, float]:
    return get_text(entry, "state") not in protocol.ALIVE_STATES, get_optional(
        entry, "age_s", get_number
    ) or 0.0
