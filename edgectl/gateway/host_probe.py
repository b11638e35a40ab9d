# SPDX-License-Identifier: Apache-2.0
"""Probe of all hosts at once, each with its own deadline -> one immutable Snapshot."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import field
from functools import partial
from typing import TYPE_CHECKING

from edgectl.agent.link import protocol
from edgectl.dataclass import dataclass, replace_fields
from edgectl.errors import HostError
from edgectl.gateway.fanout import MAX_PARALLEL_HOSTS, HostAnswer, ask_all, fan_out
from edgectl.gateway.latency import Latencies, decode_latencies, join_latencies
from edgectl.gateway.link_observations import LinkEnds, join_link_ends
from edgectl.gateway.probe_reply import (
    ReplyContext,
    apply_done_tasks,
    build_host_sample,
    decode_probe,
    list_done_tasks,
)
from edgectl.gateway.probe_request import build_probe_request, list_checked_tasks, list_detected_tasks
from edgectl.gateway.replies import ProbeReply
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.link_reading import LinkObservation
from edgectl.model.snapshot import HostSample, HostStatus, Snapshot
from edgectl.model.task import Tasks
from edgectl.model.text import escape_unprintable
from edgectl.names import natural_key
from edgectl.transport.base import Transport
from edgectl.transport.fleet_lease import FleetLease

if TYPE_CHECKING:
    from edgectl.gateway.readings import FleetReadings

# A login costs CPU here, a sample window only time: more hosts may measure than log in at once.
_PROBES_PER_LOGIN = 4
# Of the time of a probe: what may have passed before a host that fell silent is asked.
_SILENT_SHARE = 0.75
HostCallback = Callable[[str, HostSample, float], None]
LinksCallback = Callable[[Mapping[tuple[str, str], LinkObservation]], None]


def ignore_host(_name: str, _sample: HostSample, _seconds: float) -> None:
    """Report nothing."""


def ignore_heartbeat(_host: str) -> None:
    """Note nothing."""


def _ignore_links(_links: Mapping[tuple[str, str], LinkObservation]) -> None:
    """Report nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeOptions:
    """``timeout`` (s): from first packet to last byte, per host. ``window`` (s): how long usage is measured.

    ``workers``: connections being opened at the same time; a host's deadline begins when its turn comes.

    ``measured``: link capacities in bytes/s by (edge, robot), as ``probe --bandwidth`` kept them.
    ``reopened``: instances whose end, completed or given up, no longer counts.
    ``known_tasks``: names of the tasks that this fleet has placed or is about to place; where the first
    release left them on a host without an owner, the fleet adopts them.
    ``former_hosts``: names of hosts that left the inventory, whose generations each host reports too.
    ``manager_id``: the name by which hosts know this manager.
    ``placed``: the instance of each task as far as this manager knows it.
    ``totals``: also read the counters of each host, from which means over a mission are taken (ADR 0132).
    ``probe_idle_links``: also probe the idle links whose turn it is, for at most 0.1 s each (ADR 0077).
    ``readings``: those that hosts send by themselves; only the other hosts are asked. ``note_heartbeat``
    records a heartbeat of one of these, as `HeartbeatTransport` does of those that are asked.
    ``on_host`` is called as each host ends, in the caller's thread, with name, sample and seconds;
    ``on_links`` once, with the links by (edge, robot).
    """

    timeout: float = 15.0
    window: float = 0.5
    workers: int = MAX_PARALLEL_HOSTS
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)
    reopened: frozenset[str] = frozenset()
    known_tasks: Callable[[], frozenset[str]] = frozenset
    former_hosts: frozenset[str] = frozenset()
    manager_id: str = ""
    placed: Mapping[str, str] = field(default_factory=dict)
    totals: bool = False
    probe_idle_links: bool = False
    readings: "FleetReadings[DecodedProbe] | None" = None
    note_heartbeat: Callable[[str], None] = ignore_heartbeat
    on_host: HostCallback = ignore_host
    on_links: LinksCallback = _ignore_links


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedProbe:
    """The sample of a host, its ends of the links, the tasks whose checks passed there, those that have no
    owner there, the former names that it has adopted, its names in the inventories of other managers, and
    what it has counted of the latencies of tasks. ``reply``: of what it was made.
    """

    reply: ProbeReply
    sample: HostSample
    links: LinkEnds
    done: frozenset[str]
    unowned: frozenset[str]
    former: frozenset[str]
    elsewhere: frozenset[str] = frozenset()
    latencies: Latencies = field(default_factory=dict)


_Answers = dict[str, HostAnswer[DecodedProbe]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _ProbeContext:
    """What every request of one probe shares. ``addresses``: of robots, ``edges``: of edges, by name."""

    inventory: Inventory
    tasks: Tasks
    transport: Transport
    addresses: Mapping[str, str]
    edges: Mapping[str, str]
    options: ProbeOptions
    clock: Callable[[], float]
    lease: FleetLease | None


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
    resolve = partial(resolve_link_addresses, inventory, transport, options.workers)
    addresses, edges = resolve() if options.readings is None else options.readings.keep_addresses(resolve)
    context = _ProbeContext(
        inventory=inventory,
        tasks=tasks,
        transport=transport,
        addresses=addresses,
        edges=edges,
        options=options,
        clock=clock,
        lease=lease,
    )
    answers = _ask_hosts([host for host in inventory.hosts.values() if host.probe], context)
    answers |= _adopt_and_ask_again(answers, context)
    samples = join_latencies(_finalize_samples(answers, inventory), _list_latencies(answers), tasks)
    joined = None if options.readings is None else options.readings.joined
    options.on_links(join_link_ends(_list_link_ends(answers), _list_partial_links(samples), joined))
    return Snapshot(taken_at=clock(), hosts=samples)


def _list_partial_links(samples: Mapping[str, HostSample]) -> frozenset[tuple[str, str]]:
    return frozenset(
        (edge, robot)
        for edge, sample in samples.items()
        for robot, link in sample.links.items()
        if link.partial
    )


def _list_latencies(answers: _Answers) -> dict[str, Latencies]:
    return {
        name: each.value.latencies for name, each in answers.items() if isinstance(each.value, DecodedProbe)
    }


def _list_link_ends(answers: _Answers) -> dict[str, LinkEnds]:
    return {name: each.value.links for name, each in answers.items() if isinstance(each.value, DecodedProbe)}


def _ask_hosts(hosts: Sequence[Host], context: _ProbeContext) -> _Answers:
    """The answers of ``hosts`` in their order; each is reported as it ends."""
    options = context.options
    answers, spent = _take_readings(hosts, context)
    for answer in ask_all(
        [host for host in hosts if host.name not in answers],
        context.transport,
        lambda host, _left: _build_request(host, context),
        lambda reply: _decode_reply(reply.host, context, None, reply.document),
        timeout=options.timeout,
        max_logins=options.workers,
        max_hosts=_PROBES_PER_LOGIN * options.workers,
        spent=spent,
    ):
        answers[answer.host.name] = answer
        options.on_host(answer.host.name, _get_sample(answer), answer.seconds)
    return {host.name: answers[host.name] for host in hosts}


def _take_readings(hosts: Sequence[Host], context: _ProbeContext) -> tuple[_Answers, dict[str, float]]:
    """The answers of the hosts that have sent theirs already; of the others, which are to be asked, the
    seconds that each has been waited for, of which some are left.
    """
    readings, options, answers = context.options.readings, context.options, _Answers()
    spent: dict[str, float] = {}
    if readings is None or context.lease is not None:
        return answers, spent
    readings.begin_cycle(
        (
            *(context.addresses, context.edges),
            *(options.timeout, options.window, options.totals, options.manager_id),
            *(options.measured, options.reopened, options.former_hosts, options.placed),
        ),
        options.note_heartbeat,
    )
    for host in hosts:
        request, said_at = _build_request(host, context), time.monotonic()
        value: DecodedProbe | HostError
        try:
            reading = readings.find(host.name, request)
            if reading is None:
                spent[host.name] = min(_SILENT_SHARE * options.timeout, readings.ask_anew(host.name, request))
                continue
            said_at = reading.said_at
            came_at = context.clock() - (time.monotonic() - reading.came_at)
            decode = partial(_decode_reply, host, context, came_at)
            value = readings.decode(host.name, reading.document, decode)
        except HostError as error:
            readings.drop(host.name)
            value = error
        answer = HostAnswer(host=host, value=value, ended=said_at, seconds=0.0)
        answers[host.name] = answer
        options.on_host(host.name, _get_sample(answer), 0.0)
    return answers, spent


def _build_request(host: Host, context: _ProbeContext) -> dict[str, object]:
    readings = context.options.readings
    if readings is not None and context.lease is None:
        return readings.build_request(host.name, lambda: _build_single_request(host, context))
    return _build_single_request(host, context)


def _build_single_request(host: Host, context: _ProbeContext) -> dict[str, object]:
    request = build_probe_request(
        host,
        context.inventory,
        context.tasks,
        context.addresses,
        window_s=context.options.window,
        timeout_s=context.options.timeout,
        former=context.options.former_hosts,
        edges=context.edges,
        manager_id=context.options.manager_id,
        placed=context.options.placed,
        totals=context.options.totals,
    )
    return request if context.lease is None else {**request, "lease": context.lease.build_claim(host.name)}


def _decode_reply(
    host: Host,
    context: _ProbeContext,
    came_at: float | None,
    document: dict[str, object],
    known: tuple[Mapping[str, object], DecodedProbe] | None = None,
) -> DecodedProbe:
    """``came_at``: s since 1970; None: now. ``known``: a document of this host before, and what it said."""
    if context.lease is not None:
        context.lease.take_reply(host.name, document.get("lease"))
    probe = decode_probe(document, host, None if known is None else (known[0], known[1].reply))
    found = _find_reply_context(host, context, context.clock() if came_at is None else came_at)
    known_sample = None if known is None else (known[0], known[1].reply, known[1].sample)
    return DecodedProbe(
        reply=probe,
        sample=build_host_sample(probe, document, found, known_sample),
        links=LinkEnds(links=probe.links, peers=probe.peers),
        done=list_done_tasks(probe) & list_checked_tasks(context.tasks, host, elsewhere=True),
        unowned=frozenset(probe.unowned),
        former=frozenset(probe.former),
        elsewhere=frozenset(probe.grants.names),
        latencies=decode_latencies(document),
    )


def _adopt_and_ask_again(answers: _Answers, context: _ProbeContext) -> _Answers:
    """Adopt what hosts run without an owner, and measure these hosts again; a host that refuses has its
    error as its answer, since it is not known what runs there.
    """
    seen = {name: each.value for name, each in answers.items() if isinstance(each.value, DecodedProbe)}
    adopted = _adopt(seen, context.inventory, context.transport, context.options)
    refused = {
        name: dataclasses.replace(answers[name], value=error)
        for name, error in adopted.items()
        if error is not None
    }
    if context.options.readings is not None:
        for name in adopted:
            context.options.readings.drop(name)
    return refused | _ask_hosts([answers[name].host for name in adopted if name not in refused], context)


def _adopt(
    seen: Mapping[str, DecodedProbe], inventory: Inventory, transport: Transport, options: ProbeOptions
) -> dict[str, HostError | None]:
    """Let the hosts adopt known tasks without an owner, and the former names of their machines.

    Returns the hosts to measure again; with an error those of which it is not known what runs there.
    """
    tasks, former = _select_unowned_tasks(seen, options), select_former_names(seen, inventory)
    hosts = [inventory.hosts[name] for name in seen if tasks[name] or former[name] != seen[name].former]

    def build(host: Host, _left: float) -> dict[str, object]:
        return {
            "op": protocol.OP_ADOPT,
            "fleet": host.fleet,
            "host": host.name,
            "tasks": sorted(tasks[host.name]),
            "former": sorted(former[host.name], key=natural_key),
        }

    answers = ask_all(hosts, transport, build, lambda _reply: None, timeout=options.timeout)
    return {answer.host.name: answer.value for answer in answers}


def _select_unowned_tasks(
    seen: Mapping[str, DecodedProbe], options: ProbeOptions
) -> dict[str, frozenset[str]]:
    """The known tasks of each host that the first release left there without an owner."""
    known = options.known_tasks() if any(each.unowned for each in seen.values()) else frozenset()
    return {name: each.unowned & known for name, each in seen.items()}


def select_former_names(seen: Mapping[str, DecodedProbe], inventory: Inventory) -> dict[str, frozenset[str]]:
    """The former names that each host should adopt: those it has, and those under which its machine runs
    tasks of this fleet, without names of the inventory (ADR 0058).

    Two hosts of one machine list the same tasks; the first of them adopts their name.
    """
    claimed = {"", *(task.instance for each in seen.values() for task in each.sample.instances.values())}
    found = {}
    for name, each in seen.items():
        others = [other for other in each.sample.other_tasks if other.instance not in claimed]
        claimed |= {other.instance for other in others}
        names = each.former | {other.host for other in others}
        found[name] = frozenset(names - inventory.hosts.keys())
    return found


def _get_sample(answer: HostAnswer[DecodedProbe]) -> HostSample:
    if isinstance(answer.value, HostError):
        return _build_unreachable_sample(answer.host, answer.value)
    return answer.value.sample


def _finalize_samples(
    answers: Mapping[str, HostAnswer[DecodedProbe]], inventory: Inventory
) -> dict[str, HostSample]:
    """The samples with their ages, completed by the checks that robots answered for tasks elsewhere.

    Of the hosts of other managers those stay that the inventory lacks, by whatever name.
    """
    now = time.monotonic()
    done = frozenset[str]().union(
        *(
            answer.value.done
            for answer in answers.values()
            if answer.host.role is Role.ROBOT and not isinstance(answer.value, HostError)
        )
    )
    samples = {name: _finalize_sample(answer, done, now) for name, answer in answers.items()}
    reported = frozenset(
        task.instance for each in samples.values() for task in each.instances.values() if task.instance
    )
    known = set(inventory.hosts).union(
        *(
            answer.value.former | answer.value.elsewhere
            for answer in answers.values()
            if not isinstance(answer.value, HostError)
        )
    )
    return {
        name: drop_known_hosts(_drop_reported_tasks(sample, reported), known)
        for name, sample in samples.items()
    }


def drop_known_hosts(sample: HostSample, known: Set[str]) -> HostSample:
    """``sample`` with those hosts of other managers that are not in ``known`` (ADR 0068)."""
    left = tuple(name for name in sample.foreign_hosts if name not in known)
    return dataclasses.replace(sample, foreign_hosts=left) if left != sample.foreign_hosts else sample


def _drop_reported_tasks(sample: HostSample, reported: frozenset[str]) -> HostSample:
    """``sample`` without other tasks whose instances a host reports itself: two names of one machine."""
    left = tuple(each for each in sample.other_tasks if each.instance not in reported)
    return dataclasses.replace(sample, other_tasks=left) if left != sample.other_tasks else sample


def _finalize_sample(answer: HostAnswer[DecodedProbe], done: frozenset[str], now: float) -> HostSample:
    sample = _get_sample(answer)
    if not sample.ok:
        return sample
    age = round(sample.sample_age_s + now - answer.ended, 3)
    return apply_done_tasks(replace_fields(sample, sample_age_s=age), done)


def _find_reply_context(host: Host, context: _ProbeContext, answered_at: float) -> ReplyContext:
    """What the manager knows of a host then; nearly all of it is the same in each cycle of a watch."""
    readings = context.options.readings
    if readings is None:
        return _build_reply_context(host, context, answered_at)
    kept = readings.keep_context(host.name, partial(_build_reply_context, host, context, answered_at))
    return replace_fields(kept, answered_at=answered_at)


def _build_reply_context(host: Host, context: _ProbeContext, answered_at: float) -> ReplyContext:
    inventory, options = context.inventory, context.options
    return ReplyContext(
        host=host,
        answered_at=answered_at,
        manager_id=options.manager_id,
        declared={robot: value for (edge, robot), value in inventory.links.items() if edge == host.name},
        measured={robot: value for (edge, robot), value in options.measured.items() if edge == host.name},
        robots=tuple(robot.name for robot in inventory.robots),
        reopened=options.reopened,
        blind=frozenset(robot.name for robot in inventory.robots if not robot.probe),
        checked=list_checked_tasks(context.tasks, host),
        detected=list_detected_tasks(context.tasks),
        robots_of={task.name: task.robots for task in context.tasks.tasks.values() if task.robots},
    )


def resolve_link_addresses(
    inventory: Inventory, transport: Transport, workers: int
) -> tuple[dict[str, str], dict[str, str]]:
    """The network addresses of the robots, and of the edges where a robot can be asked for them.

    ssh_config costs a process for each host, so all are resolved at once.
    """
    edges = inventory.edges if any(robot.probe for robot in inventory.robots) else ()
    found = resolve_addresses((*inventory.robots, *edges), transport, workers)
    return (
        {robot.name: found[robot.name] for robot in inventory.robots},
        {edge.name: found[edge.name] for edge in edges},
    )


def resolve_addresses(hosts: Sequence[Host], transport: Transport, workers: int) -> dict[str, str]:
    """The network address of each of ``hosts``."""
    found = dict(fan_out(lambda host: _resolve_address(host, transport), hosts, workers=workers))
    return {host.name: found[position] for position, host in enumerate(hosts)}


def _resolve_address(host: Host, transport: Transport) -> str:
    try:
        return transport.address(host)
    except HostError:
        return host.host


def _build_unreachable_sample(host: Host, error: HostError) -> HostSample:
    return HostSample(
        role=host.role,
        status=HostStatus.UNREACHABLE,
        error=escape_unprintable(error.message),
        error_kind=error.kind,
        hint=escape_unprintable(error.hint),
        address=host.address,
    )
