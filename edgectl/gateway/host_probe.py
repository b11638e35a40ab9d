"""The gateway: every host at once, each with its own deadline -> one immutable Snapshot."""

import contextlib
import dataclasses
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from edgectl.errors import HostError
from edgectl.gateway.fanout import fan_out
from edgectl.gateway.probe_reply import ReplyContext, apply_done_tasks, decode_done_tasks, decode_host_sample
from edgectl.gateway.probe_request import build_probe_request
from edgectl.gateway.reply_fields import escape_unprintable
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.snapshot import HostSample, HostStatus, Snapshot
from edgectl.model.task import Tasks
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Transport

_MAX_LOGINS = 32
# Logging in costs CPU here, a sample window costs only time: more hosts may measure than log in at once.
_PROBES_PER_LOGIN = 4
HostCallback = Callable[[str, HostSample, float], None]


def _ignore_host(_name: str, _sample: HostSample, _seconds: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeOptions:
    """``timeout`` (s): from the first packet to the last byte, per host. ``window`` (s): how long use is measured.
    ``workers``: connections being opened at the same time; a host's deadline begins when its turn comes.

    ``measured``: link capacities in bytes/s by (edge, robot), as ``probe --bandwidth`` kept them.
    ``reopened``: instances whose end, completed or given up, no longer counts.
    ``on_host`` hears each host as it ends, in the caller's thread: name, sample, seconds it took.
    """

    timeout: float = 15.0
    window: float = 0.5
    workers: int = _MAX_LOGINS
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)
    reopened: frozenset[str] = frozenset()
    on_host: HostCallback = _ignore_host


@dataclass(frozen=True, slots=True, kw_only=True)
class _ProbeAnswer:
    """What one host gave: a sample, the tasks whose checks said done there, when it answered (monotonic) and how long it took."""

    sample: HostSample
    done: frozenset[str] = frozenset()
    at: float
    seconds: float


def probe_hosts(
    inventory: Inventory,
    tasks: Tasks,
    transport: Transport,
    *,
    options: ProbeOptions | None = None,
    clock: Callable[[], float] = time.time,
) -> Snapshot:
    """Measure every host. One that is dead, hung, refuses or talks garbage is ``unreachable`` with its cause, and costs no other host.

    Hosts stand in the order of the inventory; robots with ``probe: false`` are not contacted and not in the snapshot.
    """
    options = options or ProbeOptions()
    hosts = [host for host in inventory.hosts.values() if host.probe]
    addresses = resolve_robot_addresses(inventory, transport, options.workers)
    gate = threading.BoundedSemaphore(options.workers)

    def ask(host: Host) -> _ProbeAnswer:
        request = build_probe_request(
            host, inventory, tasks, addresses, window_s=options.window, timeout_s=options.timeout
        )
        return _probe_host(
            host,
            request,
            transport,
            gate,
            options.timeout,
            lambda: _build_reply_context(host, inventory, options, clock()),
        )

    answers: dict[str, _ProbeAnswer] = {}
    for position, answer in fan_out(ask, hosts, workers=_PROBES_PER_LOGIN * options.workers):
        answers[hosts[position].name] = answer
        options.on_host(hosts[position].name, answer.sample, answer.seconds)
    return Snapshot(
        taken_at=clock(), hosts=_finalize_samples({host.name: answers[host.name] for host in hosts})
    )


def _probe_host(
    host: Host,
    request: dict[str, object],
    transport: Transport,
    gate: threading.BoundedSemaphore,
    timeout: float,
    context: Callable[[], ReplyContext],
) -> _ProbeAnswer:
    """Connect and call within one deadline."""
    began = time.monotonic()
    try:
        with contextlib.ExitStack() as stack:
            with gate:
                began = time.monotonic()
                session = stack.enter_context(transport.connect(host, timeout=timeout))
            document = call_agent(session, request, timeout=max(0.1, began + timeout - time.monotonic()))
        sample, done = decode_host_sample(document, context()), decode_done_tasks(document)
    except HostError as error:
        sample, done = _build_unreachable_sample(host, error), frozenset()
    ended = time.monotonic()
    return _ProbeAnswer(sample=sample, done=done, at=ended, seconds=ended - began)


def _finalize_samples(answers: Mapping[str, _ProbeAnswer]) -> dict[str, HostSample]:
    """The samples with their ages, after what robots said of tasks that run elsewhere."""
    now = time.monotonic()
    done = frozenset[str]().union(
        *(answer.done for answer in answers.values() if answer.sample.role is Role.ROBOT)
    )
    return {
        name: apply_done_tasks(
            dataclasses.replace(
                answer.sample, sample_age_s=round(answer.sample.sample_age_s + now - answer.at, 3)
            ),
            done,
        )
        if answer.sample.ok
        else answer.sample
        for name, answer in answers.items()
    }


def _build_reply_context(
    host: Host, inventory: Inventory, options: ProbeOptions, answered_at: float
) -> ReplyContext:
    return ReplyContext(
        host=host,
        answered_at=answered_at,
        declared={robot: value for (edge, robot), value in inventory.links.items() if edge == host.name},
        measured={robot: value for (edge, robot), value in options.measured.items() if edge == host.name},
        robots=tuple(robot.name for robot in inventory.robots),
        reopened=options.reopened,
        blind=frozenset(robot.name for robot in inventory.robots if not robot.probe),
    )


def resolve_robot_addresses(inventory: Inventory, transport: Transport, workers: int) -> dict[str, str]:
    """Where each robot is found; asking ssh_config about one costs a process, so all are asked at once."""
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
    )
