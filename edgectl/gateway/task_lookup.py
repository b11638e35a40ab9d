"""Which host runs a task, or ran it last, and which runs are over."""

from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.gateway.fanout import fan_out
from edgectl.gateway.reply_fields import (
    ReplyDocument,
    get_flag,
    get_number,
    get_objects,
    get_optional,
    get_text,
)
from edgectl.model.inventory import Host, Inventory
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Transport

_WORKERS = 32


def find_task_host(
    task: str, inventory: Inventory, transport: Transport, *, timeout: float
) -> tuple[Host | None, tuple[str, ...]]:
    """The host where ``task`` runs, else one that has it in another state; and the hosts that did not answer.

    Between equals the youngest instance counts.
    """
    answers = _ask_task_status(task, inventory, transport, timeout)
    known = [name for name, entry in answers.items() if entry]
    best = min(known, key=lambda name: _rank_status(answers[name] or {}), default=None)
    return inventory.hosts[best] if best else None, _list_unanswered(answers)


def list_ended_instances(
    task: str, inventory: Inventory, transport: Transport, *, timeout: float
) -> tuple[frozenset[str], tuple[str, ...]]:
    """The instances of ``task`` that completed or were given up, as far as hosts know; and the hosts that did not answer."""
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
    """What each host says of the task: empty where it never ran, None where the host does not answer."""
    hosts = [host for host in inventory.hosts.values() if host.probe]

    def ask(host: Host) -> ReplyDocument | None:
        try:
            with transport.connect(host, timeout=timeout) as session:
                answer = call_agent(
                    session, {"op": protocol.OP_STATUS, "host": host.name, "task": task}, timeout=timeout
                )
            return get_objects(answer, "tasks").get(task, {})
        except HostError:
            return None

    answers = dict(fan_out(ask, hosts, workers=_WORKERS))
    return {host.name: answers[position] for position, host in enumerate(hosts)}


def _list_unanswered(answers: Mapping[str, ReplyDocument | None]) -> tuple[str, ...]:
    return tuple(name for name, entry in answers.items() if entry is None)


def _rank_status(entry: ReplyDocument) -> tuple[bool, float]:
    return get_text(entry, "state") not in protocol.ALIVE_STATES, get_optional(
        entry, "age_s", get_number
    ) or 0.0
