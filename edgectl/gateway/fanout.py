# SPDX-License-Identifier: Apache-2.0
"""Parallel calls, and one request to many hosts at once."""

import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Generic, TypeVar

from edgectl.dataclass import dataclass
from edgectl.errors import HostError
from edgectl.model.inventory import Host
from edgectl.transport.agent_client import call_agent, prepare_requests
from edgectl.transport.base import Transport

Item = TypeVar("Item")
Value = TypeVar("Value")
Document = dict[str, object]

MAX_PARALLEL_HOSTS = 32
# At least so long a request may take, however long the connection took.
_MIN_REQUEST_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class HostReply:
    """The reply of one host; ``seconds``: from the first packet to the last byte."""

    host: Host
    document: Document
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HostAnswer(Generic[Value]):
    """The decoded reply of one host, or its error; ``ended`` on the monotonic clock, after ``seconds``."""

    host: Host
    value: Value | HostError
    ended: float
    seconds: float


def ask_all(
    hosts: Sequence[Host],
    transport: Transport,
    build_request: Callable[[Host, float], Mapping[str, object]],
    decode: Callable[[HostReply], Value],
    *,
    timeout: float,
    max_logins: int = MAX_PARALLEL_HOSTS,
    max_hosts: int = MAX_PARALLEL_HOSTS,
    spent: Mapping[str, float] | None = None,
) -> Iterator[HostAnswer[Value]]:
    """Ask every host at once, each within ``timeout`` s from first packet to last byte; yield as each ends.

    ``build_request`` takes the seconds that are left after the connection. At most ``max_logins`` connections
    are opened and ``max_hosts`` hosts asked at a time; the time of a host begins when its turn comes.
    ``spent``: seconds by host that it has been waited for already.
    """
    gate = threading.BoundedSemaphore(max_logins)

    def ask(host: Host) -> HostAnswer[Value]:
        began, most = time.monotonic(), timeout - (spent or {}).get(host.name, 0.0)
        value: Value | HostError
        try:
            with ExitStack() as stack:
                with gate:
                    began = time.monotonic()
                    session = stack.enter_context(transport.connect(host, timeout=most))
                left = max(_MIN_REQUEST_S, began + most - time.monotonic())
                document = call_agent(session, build_request(host, left), timeout=left)
            value = decode(HostReply(host=host, document=document, seconds=time.monotonic() - began))
        except HostError as error:
            value = error
        ended = time.monotonic()
        return HostAnswer(host=host, value=value, ended=ended, seconds=ended - began)

    for _, answer in fan_out(ask, hosts, workers=max_hosts, meanwhile=prepare_requests):
        yield answer


def fan_out(
    function: Callable[[Item], Value],
    items: Sequence[Item],
    *,
    workers: int,
    meanwhile: Callable[[], object] | None = None,
) -> Iterator[tuple[int, Value]]:
    """Yield (position, value) as each call ends; at most ``workers`` run at once. When they have begun,
    ``meanwhile`` is called.

    What ``function`` raises is a bug, and raised here. The threads are daemons, so that Ctrl-C does not wait
    for a host that hangs.
    """
    waiting: queue.SimpleQueue[int | None] = queue.SimpleQueue()
    ended: queue.SimpleQueue[tuple[int, Value | None, BaseException | None]] = queue.SimpleQueue()

    def work() -> None:
        while (position := waiting.get()) is not None:
            try:
                ended.put((position, function(items[position]), None))
            except BaseException as error:  # handed to the caller's thread
                ended.put((position, None, error))

    count = min(workers, len(items))
    for position in (*range(len(items)), *[None] * count):
        waiting.put(position)
    for _ in range(count):
        threading.Thread(target=work, daemon=True).start()
    if meanwhile is not None:
        meanwhile()
    for _ in items:
        position, value, error = ended.get()
        if error is not None:
            raise error
        yield position, value  # type: ignore[misc]
