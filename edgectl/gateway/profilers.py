# SPDX-License-Identifier: Apache-2.0
"""Start, stop and list the resident profilers on all hosts at once; a host that fails delays no other."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

from edgectl.agent.link import protocol
from edgectl.errors import HostError, ReplyError
from edgectl.gateway.fanout import MAX_PARALLEL_HOSTS, HostReply, ask_all
from edgectl.gateway.host_probe import resolve_link_addresses
from edgectl.gateway.probe_request import build_probe_spec
from edgectl.gateway.replies import (
    PROFILER_USAGE,
    LiveProfilerReply,
    ProfilerReply,
    ReplyDocument,
    decode_reply,
)
from edgectl.model.inventory import Host, Inventory
from edgectl.model.profiler import Profiler, ProfilerState
from edgectl.model.resource import MEASURED_HOST_RESOURCES, Usage
from edgectl.model.task import Tasks
from edgectl.model.text import escape_unprintable
from edgectl.transport.base import Transport

ProfilerRequest = dict[str, object]


def start_profilers(
    hosts: Sequence[Host],
    inventory: Inventory,
    tasks: Tasks,
    transport: Transport,
    *,
    every: float,
    ttl: float,
    timeout: float,
) -> tuple[Profiler, ...]:
    """Start a profiler on each of ``hosts``; ``every``: period in s, ``ttl``: s after the last request."""
    wanted = _make_probe_spec_builder(inventory, tasks, transport)
    requests = {
        host.name: {"op": protocol.OP_PROFILER_START, "every_s": every, "ttl_s": ttl, **wanted(host)}
        for host in hosts
    }
    return _ask_profilers(hosts, requests, transport, timeout)


def stop_profilers(hosts: Sequence[Host], transport: Transport, *, timeout: float) -> tuple[Profiler, ...]:
    """Stop the profilers on ``hosts``."""
    return _ask_profilers(
        hosts, {host.name: {"op": protocol.OP_PROFILER_STOP} for host in hosts}, transport, timeout
    )


def list_profilers(
    hosts: Sequence[Host], inventory: Inventory, tasks: Tasks, transport: Transport, *, timeout: float
) -> tuple[Profiler, ...]:
    """The state of the profiler on each of ``hosts``."""
    wanted = _make_probe_spec_builder(inventory, tasks, transport)
    return _ask_profilers(
        hosts,
        {host.name: {"op": protocol.OP_PROFILER_STATUS, **wanted(host)} for host in hosts},
        transport,
        timeout,
    )


def _make_probe_spec_builder(
    inventory: Inventory, tasks: Tasks, transport: Transport
) -> Callable[[Host], ProfilerRequest]:
    robots, edges = resolve_link_addresses(inventory, transport, MAX_PARALLEL_HOSTS)
    return lambda host: build_probe_spec(host, tasks, robots, edges)


def _ask_profilers(
    hosts: Sequence[Host], requests: Mapping[str, ProfilerRequest], transport: Transport, timeout: float
) -> tuple[Profiler, ...]:
    """The answers in the order of ``hosts``."""

    def build(host: Host, _left: float) -> ProfilerRequest:
        return {**requests[host.name], "fleet": host.fleet, "host": host.name}

    def decode(reply: HostReply) -> Profiler:
        return decode_profiler(reply.host.name, reply.document)

    answers = {
        answer.host.name: _describe_error(answer.host, answer.value)
        if isinstance(answer.value, HostError)
        else answer.value
        for answer in ask_all(hosts, transport, build, decode, timeout=timeout)
    }
    return tuple(answers[host.name] for host in hosts)


def _describe_error(host: Host, error: HostError) -> Profiler:
    return Profiler(
        host=host.name,
        state=ProfilerState.UNREACHABLE,
        error=escape_unprintable(error.message),
        hint=escape_unprintable(error.hint),
    )


def decode_profiler(host: str, document: ReplyDocument) -> Profiler:
    """The profiler of a host from its reply.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range.
    """
    reply = decode_reply(ProfilerReply, document)
    if reply.state is ProfilerState.UNREACHABLE:
        raise ReplyError(f"unknown profiler state: {reply.state}")
    known = Profiler(host=host, state=reply.state, pid=reply.pid, detail=reply.detail)
    if not reply.state.alive:
        return known
    live = decode_reply(LiveProfilerReply, document)
    own = decode_reply(PROFILER_USAGE, document)
    used = Usage({each.name: getattr(own, each.used_key) for each in MEASURED_HOST_RESOURCES})
    figures = {each.name: getattr(live, each.name) for each in dataclasses.fields(live)}
    return dataclasses.replace(known, used=used, **figures | {"ttl_left": max(0.0, live.ttl_left)})
