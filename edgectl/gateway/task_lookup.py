"""The host that runs a task, or ran it last, and the instances that have ended."""

from collections.abc import Mapping, Sequence

from edgectl.agent.link import protocol
from edgectl.errors import HostError, ReplyError
from edgectl.gateway.fanout import HostReply, ask_all
from edgectl.gateway.replies import StatusReply, TaskReply, decode_reply
from edgectl.model.inventory import Host, Inventory
from edgectl.model.snapshot import TaskState
from edgectl.model.standby import is_standby_entry
from edgectl.names import natural_key
from edgectl.transport.base import Transport


def find_task_host(
    task: str, inventory: Inventory, transport: Transport, *, timeout: float
) -> tuple[Host | None, bool, tuple[str, ...]]:
    """The host where ``task`` runs, else one that has it in another state; whether it runs there; and the
    hosts that did not answer.

    Of several the youngest instance counts.
    """
    host, entry, silent = find_task_process(task, inventory, transport, timeout=timeout)
    return host, entry is not None and entry.state.alive, silent


def find_task_process(
    task: str, inventory: Inventory, transport: Transport, *, timeout: float
) -> tuple[Host | None, TaskReply | None, tuple[str, ...]]:
    """As ``find_task_host``, with what the host reports of the task."""
    answers = _ask_task_status(task, inventory, transport, timeout)
    known = {name: entry for name, entry in answers.items() if isinstance(entry, TaskReply)}
    best = min(known, key=lambda name: _rank_status(known[name]), default=None)
    host, entry = (inventory.hosts[best], known[best]) if best else (None, None)
    return host, entry, _list_unanswered(answers)


def list_ended_instances(
    task: str, inventory: Inventory, transport: Transport, *, timeout: float
) -> tuple[frozenset[str], tuple[str, ...]]:
    """The instances of ``task`` that completed or were given up; and the hosts that did not answer."""
    answers = _ask_task_status(task, inventory, transport, timeout)
    instances = (
        entry.instance
        for entry in answers.values()
        if isinstance(entry, TaskReply) and (entry.state is TaskState.COMPLETED or entry.given_up)
    )
    return frozenset(instances), _list_unanswered(answers)


def find_doubled_instances(
    hosts: Sequence[Host], transport: Transport, *, timeout: float
) -> dict[str, tuple[str, ...]]:
    """The tasks of which more than one instance is alive, with their hosts; hosts without an answer are left
    out.
    """
    places: dict[str, list[str]] = {}
    for answer in ask_all(hosts, transport, _build_status_request, _decode_living_tasks, timeout=timeout):
        for task in answer.value if not isinstance(answer.value, HostError) else ():
            places.setdefault(task, []).append(answer.host.name)
    return {task: tuple(sorted(names, key=natural_key)) for task, names in places.items() if len(names) > 1}


def _build_status_request(host: Host, _left: float) -> dict[str, object]:
    return {"op": protocol.OP_STATUS, "fleet": host.fleet, "host": host.name, "task": None}


def _decode_living_tasks(reply: HostReply) -> tuple[str, ...]:
    tasks = decode_reply(StatusReply, reply.document).tasks
    return tuple(name for name in tasks if protocol.is_name(name) and _may_live(name, tasks[name]))


def _may_live(task: str, entry: object) -> bool:
    """Whether an entry is of a living task of edgectl; one that cannot be read may be."""
    try:
        found = decode_reply(TaskReply, entry, f"tasks.{task}")
    except ReplyError:
        return True
    return found.managed and found.state.alive and not is_standby_entry(entry)


def _ask_task_status(
    task: str, inventory: Inventory, transport: Transport, timeout: float
) -> dict[str, TaskReply | HostError | None]:
    """The entry of the task on each host: None if it never ran, an error if the host does not answer."""
    hosts = [host for host in inventory.hosts.values() if host.probe]

    def build(host: Host, _left: float) -> dict[str, object]:
        return {"op": protocol.OP_STATUS, "fleet": host.fleet, "host": host.name, "task": task}

    def decode(reply: HostReply) -> TaskReply | None:
        tasks = decode_reply(StatusReply, reply.document).tasks
        return decode_reply(TaskReply, tasks[task], f"tasks.{task}") if task in tasks else None

    answers = {
        answer.host.name: answer.value for answer in ask_all(hosts, transport, build, decode, timeout=timeout)
    }
    return {host.name: answers[host.name] for host in hosts}


def _list_unanswered(answers: Mapping[str, TaskReply | HostError | None]) -> tuple[str, ...]:
    return tuple(name for name, entry in answers.items() if isinstance(entry, HostError))


def _rank_status(entry: TaskReply) -> tuple[bool, bool, float]:
    return not entry.state.alive, entry.role == protocol.ROLE_STANDBY, entry.age_s
