# SPDX-License-Identifier: Apache-2.0
"""Hand over the state of a task: save it on the old host, bring it to the new one, load it there.

It passes through this program piece by piece, a few of them at once; no more than these are in memory. The
new host checks the whole by its SHA-256 before anything reads it.
"""

import dataclasses
import queue
import re
import threading
import time
from collections.abc import Iterator

from edgectl.agent.link import protocol
from edgectl.dataclass import dataclass
from edgectl.errors import ConnectError, HostError
from edgectl.executor.action_phases import PlannedPhase, PlannedRequest
from edgectl.executor.host_requests import NO_INSTANCE, Request
from edgectl.executor.state_requests import build_drop_request
from edgectl.executor.step_run import StepRun
from edgectl.model.result import CarriedState, Phase
from edgectl.units import format_bytes, format_duration

# Requests with a piece that are under way at once: one fills the link while another host works.
_IN_FLIGHT = 3
# A link that carries less than this has stopped; that bounds the transfer, and each piece of it.
_SLOWEST_BYTES_PER_S = 64e3
# How often a connection that was lost without a single piece is opened again.
_MAX_LOSSES = 2
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Piece:
    """``size`` bytes of the state at ``offset``, as they travel in ``data``."""

    offset: int
    size: int
    packed: bool
    data: bytes


def perform_state_phase(act: StepRun, planned: PlannedPhase) -> None:
    """Perform a phase `save`, `transfer` or `load`.

    Raises:
        HostError: it failed; the state is still where it was.
    """
    match planned.phase:
        case Phase.SAVE:
            _save_state(act, planned)
        case Phase.TRANSFER:
            _transfer_state(act, planned)
        case Phase.LOAD:
            _load_state(act, planned)


def drop_state(act: StepRun) -> None:
    """Remove what this action has left of the state on hosts, as far as they answer.

    What is left on others is removed by the next apply that reaches them.
    """
    left = []
    for name in act.spooled:
        host = act.run.hosts[name]
        try:
            act.run.ask(host, build_drop_request(act.name, host, _get_last_generation(act)))
        except HostError:
            left.append(name)
    if act.spooled and not left:
        act.run.record("dropped", task=act.name)
    act.spooled[:] = left


def _get_last_generation(act: StepRun) -> int:
    """The generation of a restored instance, which is the highest of the action."""
    return min(protocol.MAX_GENERATION, act.generation + 1)


def _save_state(act: StepRun, planned: PlannedPhase) -> None:
    request, host, began = planned.requests[0], planned.host, time.monotonic()
    act.saved_at = began
    act.spooled.append(host.name)
    with act.phase(Phase.SAVE, host.name) as remarks:
        answer = _ask(act, request, generation=act.generation)
        size, digest = answer.get("size"), answer.get("sha256")
        most = request.body["max_bytes"]
        if not isinstance(size, int) or not isinstance(most, int) or not 0 < size <= most:
            raise HostError(f"the state of {act.name} has no valid size", host=host.name)
        if not isinstance(digest, str) or _SHA256.fullmatch(digest) is None:
            raise HostError(f"the state of {act.name} has no valid hash", host=host.name)
        remarks.append(f"state of {format_bytes(size)}")
    act.carried = CarriedState(size_bytes=size, sha256=digest, save_s=time.monotonic() - began)


def _transfer_state(act: StepRun, planned: PlannedPhase) -> None:
    """Take room for the whole on the new host, then bring it there."""
    write, read = planned.requests
    carried, began, host = _get_carried(act), time.monotonic(), planned.host
    act.spooled.append(host.name)
    seconds = act.run.options.call_s + carried.size_bytes / _SLOWEST_BYTES_PER_S
    with act.phase(Phase.TRANSFER, host.name) as remarks:
        _ask(act, write, generation=act.generation, total=carried.size_bytes)
        sent = _send_pieces(act, write, _read_pieces(act, read, carried.size_bytes, began + seconds))
        remarks.append(f"sent as {format_bytes(sent)}")
    act.carried = dataclasses.replace(carried, sent_bytes=sent, transfer_s=time.monotonic() - began)


def _load_state(act: StepRun, planned: PlannedPhase) -> None:
    """Load it into the instance that was started last; ``age_s`` is counted from the begin of the save."""
    request, carried, began = planned.requests[0], _get_carried(act), time.monotonic()
    stated = request.body["instance"]
    with act.phase(Phase.LOAD, planned.host.name) as remarks:
        _ask(
            act,
            request,
            generation=_get_last_generation(act),
            instance=act.started or None if stated == NO_INSTANCE else stated,
            size=carried.size_bytes,
            sha256=carried.sha256,
        )
        ended = time.monotonic()
        remarks.append(f"state {format_duration(ended - act.saved_at)} old")
    act.carried = dataclasses.replace(
        carried, load_s=ended - began, age_s=ended - act.saved_at, host=planned.host.name
    )


def _get_carried(act: StepRun) -> CarriedState:
    if act.carried is None:
        raise HostError(f"the state of {act.name} was not saved")
    return act.carried


def _ask(act: StepRun, request: PlannedRequest, **values: object) -> Request:
    timeout = request.timeout_s + act.run.options.call_s
    return act.run.ask(request.host, {**request.body, **values}, timeout=timeout)


def _read_pieces(act: StepRun, read: PlannedRequest, size: int, deadline: float) -> Iterator[_Piece]:
    """The pieces in order; where the connection is lost, it is opened again and goes on where it was.

    Raises:
        HostError: they do not add up to ``size``, or not until the ``deadline`` (monotonic).
    """
    offset, losses = 0, 0
    while offset < size:
        begun, left = offset, deadline - time.monotonic()
        _check_time(act, left, size, offset)
        try:
            for chunk in act.run.stream(read.host, {**read.body, "offset": offset}, timeout=left):
                length = min(protocol.STATE_PIECE_BYTES, size - offset)
                if not 1 < len(chunk) <= length + 1:
                    raise HostError(f"the state of {act.name} does not fit its size", host=read.host.name)
                packed = chunk[:1] == protocol.STATE_PACKED
                yield _Piece(offset=offset, size=length, packed=packed, data=chunk[1:])
                offset += length
                _check_time(act, deadline - time.monotonic(), size, offset)
        except ConnectError:
            losses = 0 if offset > begun else losses + 1
            if losses > _MAX_LOSSES:
                raise
            continue
        if offset < size:
            raise HostError(
                f"the state of {act.name} ended after {offset} of {size} bytes", host=read.host.name
            )


def _check_time(act: StepRun, left: float, size: int, offset: int) -> None:
    if left <= 0 and offset < size:
        raise HostError(
            f"the state of {act.name} did not arrive in time: {offset} of {size} bytes",
            hint="check the links between this machine and the hosts",
        )


def _send_pieces(act: StepRun, write: PlannedRequest, pieces: Iterator[_Piece]) -> int:
    """Send the pieces, a few at once; the bytes that were sent. The first error ends it."""
    todo: queue.Queue[_Piece | None] = queue.Queue(maxsize=1)
    faults: list[BaseException] = []
    threads = [
        threading.Thread(target=_send_queued, args=(act, write, todo, faults), daemon=True)
        for _ in range(_IN_FLIGHT)
    ]
    for thread in threads:
        thread.start()
    sent = 0
    try:
        for piece in pieces:
            if faults:
                break
            sent += len(piece.data)
            todo.put(piece)
    finally:
        for _ in threads:
            todo.put(None)
        for thread in threads:
            thread.join()
    if faults:
        raise faults[0]
    return sent


def _send_queued(
    act: StepRun, write: PlannedRequest, todo: "queue.Queue[_Piece | None]", faults: list[BaseException]
) -> None:
    """Send what is queued until None comes; after a fault of any thread, only take it."""
    timeout = act.run.options.call_s + (_IN_FLIGHT + 1) * protocol.STATE_PIECE_BYTES / _SLOWEST_BYTES_PER_S
    while (piece := todo.get()) is not None:
        try:
            if not faults:
                _send_piece(act, write, piece, timeout)
        except BaseException as error:
            faults.append(error)


def _send_piece(act: StepRun, write: PlannedRequest, piece: _Piece, timeout: float) -> None:
    values = {"offset": piece.offset, "size": piece.size, "packed": piece.packed, "bytes": len(piece.data)}
    body = {**write.body, "generation": act.generation, **values}
    act.run.ask(write.host, body, timeout=timeout, data=piece.data)
