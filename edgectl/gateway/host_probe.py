"""Probe of all hosts at once, each with its own deadline -> one immutable Snapshot."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.gateway.fanout import MAX_PARALLEL_HOSTS, HostAnswer, HostReply, ask_all, fan_out
from edgectl.gateway.probe_reply import (
    ReplyContext,
    apply_done_tasks,
    decode_done_tasks,
    decode_host_sample,
    decode_unowned_tasks,
)
from edgectl.gateway.probe_request import build_probe_request, list_checked_tasks, list_detected_tasks
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.snapshot import HostSample, HostStatus, OtherTask, Snapshot, TaskSample
from edgectl.model.task import Tasks
from edgectl.model.text import escape_unprintable
from edgectl.transport.base import Transport
from edgectl.transport.fleet_lease import FleetLease

# A login costs CPU here, a sample window only time: more hosts may measure than log in at once.
_PROBES_PER_LOGIN = 4
HostCallback = Callable[[str, HostSample, float], None]


def _ignore_host(_name: str, _sample: HostSample, _seconds: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeOptions:
    """``timeout`` (s): from first packet to last byte, per host. ``window`` (s): how long usage is measured.

    ``workers``: connections being opened at the same time; a host's deadline begins when its turn comes.

    ``measured``: link capacities in bytes/s by (edge, robot), as ``probe --bandwidth`` kept them.
    ``reopened``: instances whose end, completed or given up, no longer counts.
    ``known_tasks``: names of the tasks that this fleet has placed or is about to place; where the first
    release left them on a host without an owner, the fleet adopts them.
    ``former_hosts``: names of hosts that left the inventory, and that hosts are asked to recall.
    ``on_host`` is called as each host ends, in the caller's thread, with name, sample and seconds.
    """

    timeout: float = 15.0
    window: float = 0.5
    workers: int = MAX_PARALLEL_HOSTS
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)
    reopened: frozenset[str] = frozenset()
    known_tasks: Callable[[], frozenset[str]] = frozenset
    former_hosts: frozenset[str] = frozenset()
    on_host: HostCallback = _ignore_host


@dataclass(frozen=True, slots=True, kw_only=True)
class _Decoded:
    """The sample of a host, the tasks whose checks passed there, and those that have no owner there."""

    sample: HostSample
    done: frozenset[str]
    unowned: frozenset[str]


_Answers = dict[str, HostAnswer[_Decoded]]


def probe_hosts(
    inventory: Inventory,
    tasks: Tasks,
    transport: Transport,
    *,
    options: ProbeOptions | None = None,
    clock: Callable[[], float] = time.time,
    lease: FleetLease | None = None,
) -> Snapshot:
    """Measure every host. One that fails is ``unreachable`` with its cause, and delays no other host.

    With a ``lease``, each host is asked for the fleet before it measures.

    Hosts are in the order of the inventory; robots with ``probe: false`` are neither contacted nor included.
    """
    options = options or ProbeOptions()
    hosts = [host for host in inventory.hosts.values() if host.probe]
    addresses = resolve_robot_addresses(inventory, transport, options.workers)

    def build(host: Host, _left: float) -> dict[str, object]:
        request = build_probe_request(
            host,
            inventory,
            tasks,
            addresses,
            window_s=options.window,
            timeout_s=options.timeout,
            former=options.former_hosts,
        )
        return request if lease is None else {**request, "lease": lease.build_claim(host.name)}

    def decode(reply: HostReply) -> _Decoded:
        if lease is not None:
            lease.take_reply(reply.host.name, reply.document.get("lease"))
        context = _build_reply_context(reply.host, inventory, tasks, options, clock())
        return _Decoded(
            sample=decode_host_sample(reply.document, context),
            done=decode_done_tasks(reply.document, list_checked_tasks(tasks, reply.host, elsewhere=True)),
            unowned=decode_unowned_tasks(reply.document),
        )

    def ask(asked: Sequence[Host]) -> _Answers:
        answers: _Answers = {}
        for answer in ask_all(
            asked,
            transport,
            build,
            decode,
            timeout=options.timeout,
            max_logins=options.workers,
            max_hosts=_PROBES_PER_LOGIN * options.workers,
        ):
            answers[answer.host.name] = answer
            options.on_host(answer.host.name, _get_sample(answer), answer.seconds)
        return answers

    answers = ask(hosts)
    answers |= ask(_adopt_unowned_tasks(answers, transport, options))
    taken_at = clock()
    in_order = {host.name: answers[host.name] for host in hosts}
    return Snapshot(taken_at=taken_at, hosts=_finalize_samples(in_order, taken_at))


def _adopt_unowned_tasks(answers: _Answers, transport: Transport, options: ProbeOptions) -> list[Host]:
    """Adopt the known tasks without an owner; the hosts that have such tasks."""
    unowned = {
        name: answer.value.unowned
        for name, answer in answers.items()
        if not isinstance(answer.value, HostError) and answer.value.unowned
    }
    known = options.known_tasks() if unowned else frozenset()
    adopted = {name: sorted(tasks & known) for name, tasks in unowned.items() if tasks & known}
    hosts = [answers[name].host for name in adopted]

    def build(host: Host, _left: float) -> dict[str, object]:
        return {
            "op": protocol.OP_ADOPT,
            "fleet": host.fleet,
            "host": host.name,
            "tasks": adopted[host.name],
        }

    for _ in ask_all(hosts, transport, build, lambda _reply: None, timeout=options.timeout):
        pass  # a host that fails here is asked again by the next probe
    return hosts


def _get_sample(answer: HostAnswer[_Decoded]) -> HostSample:
    if isinstance(answer.value, HostError):
        return _build_unreachable_sample(answer.host, answer.value)
    return answer.value.sample


def _finalize_samples(answers: Mapping[str, HostAnswer[_Decoded]], taken_at: float) -> dict[str, HostSample]:
    """The samples with their ages, completed by the checks that robots answered for tasks elsewhere."""
    now = time.monotonic()
    done = frozenset[str]().union(
        *(
            answer.value.done
            for answer in answers.values()
            if answer.host.role is Role.ROBOT and not isinstance(answer.value, HostError)
        )
    )
    samples = {name: _finalize_sample(answer, done, now) for name, answer in answers.items()}
    left = {name: _drop_reported_tasks(sample, samples) for name, sample in samples.items()}
    return claim_former_tasks(left, taken_at)


def claim_former_tasks(samples: Mapping[str, HostSample], taken_at: float) -> dict[str, HostSample]:
    """``samples`` in which each living task of this fleet that a machine keeps under a host name of the past
    runs on the first host of that machine (ADR 0040).
    """
    claimed: set[str] = {""}
    found = {}
    for name, sample in samples.items():
        former = [
            each
            for each in sample.other_tasks
            if each.host not in samples and each.task not in sample.tasks and each.instance not in claimed
        ]
        claimed |= {each.instance for each in sample.other_tasks}
        seen = {each.task: _build_former_sample(each, taken_at) for each in former}
        others = tuple(each for each in sample.other_tasks if each not in former)
        found[name] = dataclasses.replace(sample, tasks={**sample.tasks, **seen}, other_tasks=others)
    return found


def _build_former_sample(other: OtherTask, taken_at: float) -> TaskSample:
    return TaskSample(
        state=other.state,
        started_at=taken_at - other.age_s,
        instance=other.instance,
        spec_hash=other.spec_hash,
        generation=other.generation,
        filed_as=other.host,
    )


def _drop_reported_tasks(sample: HostSample, samples: Mapping[str, HostSample]) -> HostSample:
    """``sample`` without other tasks that the host of their name reports itself: two names of one machine."""
    left = tuple(each for each in sample.other_tasks if not _is_reported(each, samples.get(each.host)))
    return sample if len(left) == len(sample.other_tasks) else dataclasses.replace(sample, other_tasks=left)


def _is_reported(other: OtherTask, sample: HostSample | None) -> bool:
    known = sample.tasks.get(other.task) if sample is not None else None
    return known is not None and known.instance == other.instance


def _finalize_sample(answer: HostAnswer[_Decoded], done: frozenset[str], now: float) -> HostSample:
    sample = _get_sample(answer)
    if not sample.ok:
        return sample
    age = round(sample.sample_age_s + now - answer.ended, 3)
    return apply_done_tasks(dataclasses.replace(sample, sample_age_s=age), done)


def _build_reply_context(
    host: Host, inventory: Inventory, tasks: Tasks, options: ProbeOptions, answered_at: float
) -> ReplyContext:
    return ReplyContext(
        host=host,
        answered_at=answered_at,
        declared={robot: value for (edge, robot), value in inventory.links.items() if edge == host.name},
        measured={robot: value for (edge, robot), value in options.measured.items() if edge == host.name},
        robots=tuple(robot.name for robot in inventory.robots),
        reopened=options.reopened,
        blind=frozenset(robot.name for robot in inventory.robots if not robot.probe),
        checked=list_checked_tasks(tasks, host),
        detected=list_detected_tasks(tasks),
    )


def resolve_robot_addresses(inventory: Inventory, transport: Transport, workers: int) -> dict[str, str]:
    """The network address of each robot; ssh_config costs a process for each, so all are resolved at once."""
    robots = inventory.robots
    found = dict(fan_out(lambda robot: _resolve_address(robot, transport), robots, workers=workers))
    return {robot.name: found[position] for position, robot in enumerate(robots)}


def _resolve_address(robot: Host, transport: Transport) -> str:
    try:
        return transport.address(robot)
    except HostError:
        return robot.host


def _build_unreachable_sample(host: Host, error: HostError) -> HostSample:
    return HostSample(
        role=host.role,
        status=HostStatus.UNREACHABLE,
        error=escape_unprintable(error.message),
        error_kind=error.kind,
        hint=escape_unprintable(error.hint),
        address=host.address,
    )
