"""Which host runs a task, or ran it last, and which runs are over."""

from collections.abc import Mapping

from edgectl.errors import HostError
from edgectl.gateway.fanout import fan_out
from edgectl.gateway.fields import Document, entries, flag, number, optional, text
from edgectl.model.inventory import Host, Inventory
from edgectl.transport.base import Transport
from edgectl.transport.call import call

_WORKERS = 32
_ALIVE = ("starting", "running", "ready")


def find(task: str, inventory: Inventory, transport: Transport, *, timeout: float) -> tuple[Host | None, tuple[str, ...]]:
    """The host where ``task`` runs, else one that has it in another state; and the hosts that did not answer.

    Between equals the youngest instance counts.
    """
    answers = _asked(task, inventory, transport, timeout)
    known = [name for name, entry in answers.items() if entry]
    best = min(known, key=lambda name: _order(answers[name] or {}), default=None)
    return inventory.hosts[best] if best else None, _silent(answers)


def ended(task: str, inventory: Inventory, transport: Transport, *, timeout: float) -> tuple[frozenset[str], tuple[str, ...]]:
    """The instances of ``task`` that completed or were given up, as far as hosts know; and the hosts that did not answer."""
    answers = _asked(task, inventory, transport, timeout)
    over = (
        entry for entry in answers.values() if entry and (text(entry, "state") == "completed" or flag(entry, "given_up", default=False))
    )
    instances = (text(entry, "instance") for entry in over)
    return frozenset(instances), _silent(answers)


def _asked(task: str, inventory: Inventory, transport: Transport, timeout: float) -> dict[str, Document | None]:
    """What each host says of the task: empty where it never ran, None where the host does not answer."""
    hosts = [host for host in inventory.hosts.values() if host.probe]

    def ask(host: Host) -> Document | None:
        try:
            with transport.connect(host, timeout=timeout) as session:
                answer = call(session, {"op": "status", "host": host.name, "task": task}, timeout=timeout)
            return entries(answer, "tasks").get(task, {})
        except HostError:
            return None

    answers = dict(fan_out(ask, hosts, workers=_WORKERS))
    return {host.name: answers[position] for position, host in enumerate(hosts)}


def _silent(answers: Mapping[str, Document | None]) -> tuple[str, ...]:
    return tuple(name for name, entry in answers.items() if entry is None)


def _order(entry: Document) -> tuple[bool, float]:
    return text(entry, "state") not in _ALIVE, optional(entry, "age_s", number) or 0.0
