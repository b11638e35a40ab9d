"""Start, stop and ask after the profilers that stay on the hosts: all hosts at once, each at its own risk."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

from edgectl.errors import HostError, ReplyError
from edgectl.gateway.collect import addresses_of
from edgectl.gateway.fanout import fan_out
from edgectl.gateway.fields import Document, flag, number, optional, printable, text, whole
from edgectl.gateway.request import wishes
from edgectl.model.inventory import Host, Inventory
from edgectl.model.profiler import Profiler, ProfilerState
from edgectl.model.task import Tasks
from edgectl.transport.base import Transport
from edgectl.transport.call import call

_AT_ONCE = 32
_STATES = {state.value: state for state in ProfilerState if state is not ProfilerState.UNREACHABLE}
Request = dict[str, object]


def start(
    hosts: Sequence[Host], inventory: Inventory, tasks: Tasks, transport: Transport, *, every: float, ttl: float, timeout: float
) -> tuple[Profiler, ...]:
    """One profiler on each of ``hosts``: it takes a sample ``every`` so many seconds and ends ``ttl`` seconds after the last request."""
    wanted = _wishes(inventory, tasks, transport)
    requests = {host.name: {"op": "profiler-start", "every_s": every, "ttl_s": ttl, **wanted(host)} for host in hosts}
    return _asked(hosts, requests, transport, timeout)


def stop(hosts: Sequence[Host], transport: Transport, *, timeout: float) -> tuple[Profiler, ...]:
    """No profiler on any of ``hosts``."""
    return _asked(hosts, {host.name: {"op": "profiler-stop"} for host in hosts}, transport, timeout)


def status(hosts: Sequence[Host], inventory: Inventory, tasks: Tasks, transport: Transport, *, timeout: float) -> tuple[Profiler, ...]:
    """What profilers there are."""
    wanted = _wishes(inventory, tasks, transport)
    return _asked(hosts, {host.name: {"op": "profiler-status", **wanted(host)} for host in hosts}, transport, timeout)


def _wishes(inventory: Inventory, tasks: Tasks, transport: Transport) -> Callable[[Host], Request]:
    addresses = addresses_of(inventory, transport, _AT_ONCE)
    return lambda host: wishes(host, tasks, addresses)


def _asked(hosts: Sequence[Host], requests: Mapping[str, Request], transport: Transport, timeout: float) -> tuple[Profiler, ...]:
    """The answers in the order of ``hosts``."""

    def ask(host: Host) -> Profiler:
        try:
            with transport.connect(host, timeout=timeout) as session:
                return decode(host.name, call(session, {**requests[host.name], "host": host.name}, timeout=timeout))
        except HostError as error:
            said = Profiler(host=host.name, state=ProfilerState.UNREACHABLE)
            return dataclasses.replace(said, error=printable(error.message), hint=printable(error.hint))

    answers = dict(fan_out(ask, hosts, workers=_AT_ONCE))
    return tuple(answers[position] for position in range(len(hosts)))


def decode(host: str, document: Document) -> Profiler:
    """What a host says of its profiler.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range.
    """
    state = _STATES.get(text(document, "state"))
    if state is None:
        raise ReplyError(f"not a state of a profiler: {text(document, 'state')[:80]}")
    known = Profiler(host=host, state=state, pid=optional(document, "pid", whole) or 0, detail=text(document, "detail"))
    if not state.alive:
        return known
    return dataclasses.replace(
        known,
        age=number(document, "age_s"),
        every=number(document, "every_s"),
        period=number(document, "period_s"),
        samples=whole(document, "samples"),
        sample_age=optional(document, "sample_age_s", number),
        used_cores=number(document, "used_cores"),
        used_bytes=number(document, "used_bytes"),
        ttl=number(document, "ttl_s"),
        ttl_left=max(0.0, number(document, "ttl_left_s", low=-(2.0**31))),
        current=flag(document, "current", default=True),
    )
