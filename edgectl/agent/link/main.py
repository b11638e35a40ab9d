# SPDX-License-Identifier: Apache-2.0
"""Dispatch of one request to its operation, and the reply.

Each operation is imported on demand: start-up is most of the cost of a request.
"""

import os
import sys

from ..supervise import state_dir
from . import fast_json, heartbeat, protocol
from .errors import RefusalError
from .fast_json import Document

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable

    from .boot import Channel

# Room for the noise of a login shell, which counts against the same limit.
_MAX_PAYLOAD_BYTES = protocol.MAX_REPLY_BYTES - 65536

_BUG_HINT = "this is a bug in edgectl's agent: please report it"
_PROCESSES_HINT = "stop something there, or raise the limit of processes (ulimit -u, TasksMax)"
# By the name of its errno: what the host lacks, and what helps.
_LACKING = {
    "EAGAIN": ("processes", _PROCESSES_HINT),
    "ENOMEM": ("memory", "stop something there"),
    "EMFILE": ("open files", "raise its limit of open files (ulimit -n)"),
    "ENFILE": ("open files", "stop something there"),
    "ENOSPC": ("disk space", "free some space there"),
    "EDQUOT": ("disk space", "free some space there"),
}


def serve_request(
    request: bytes,
    channel: "Channel",
    bases: "list[str]",
    repeats: bool = False,  # noqa: FBT001, FBT002
) -> None:
    """Carry out ``request`` and reply on ``channel``; every failure becomes an ``error`` document.

    ``repeats``: the manager listens for more than one reply (`converse`).
    """
    try:
        document = fast_json.loads(request.decode("utf-8"))
        if document["op"] == protocol.OP_CONVERSE:
            from .converse import converse

            converse(channel, bases, serve_request)
        state_dir.use_fleet(bases, document.get("fleet"))
        heartbeat.record_heartbeat(document["host"])
        stream = _find_stream(document["op"], repeats)
        if stream is not None:
            return stream(document, channel)
        operation = _find_operation(document["op"])
        if document["op"] in protocol.HELD_OPS:
            from .hold import Hold

            document["hold"] = Hold(channel, float(document["await_go_s"]))
        if _needs_lease(document):
            from ..supervise.lease import perform_within_lease

            reply = perform_within_lease(document, operation)
        else:
            reply = operation(document)
    except RefusalError as refusal:
        reply = _build_error(refusal.kind, refusal.message, refusal.hint)
    except OSError as error:
        reply = _build_os_error(error)
    except Exception as error:  # noqa: BLE001 - the manager needs a document, not a traceback
        reply = _build_error("agent-error", _describe_exception(error), _BUG_HINT)
    payload = fast_json.dumps(reply).encode("ascii")
    if len(payload) > _MAX_PAYLOAD_BYTES:
        payload = fast_json.dumps(
            _build_error("too-large", "the reply is larger than 1 MiB", "request less")
        ).encode("ascii")
    return channel.reply(payload)


def _find_stream(name: str, repeats: bool) -> "Callable[[Document, Channel], None] | None":  # noqa: FBT001
    """Find an operation that replies by itself, and more than once."""
    if name == protocol.OP_FOLLOW:
        from ..supervise.logs import follow_log as stream
    elif name == protocol.OP_READ_STATE:
        from ..supervise.state_spool import stream_state as stream
    elif repeats and name == protocol.OP_READINGS:
        from ..measure.readings import send_readings as stream
    else:
        return None
    return stream


def _build_os_error(error: OSError) -> Document:
    """What the host lacks, where the error says it; any other is a bug."""
    from errno import errorcode

    lacks = _LACKING.get(errorcode.get(error.errno or 0, ""))
    if lacks is None:
        return _build_error("agent-error", _describe_exception(error), _BUG_HINT)
    return _build_error("out-of-resources", "the host is out of " + lacks[0], lacks[1])


def _needs_lease(document: Document) -> bool:
    """Whether the request changes something; a check does where the manager says so by its signature."""
    return document["op"] in protocol.CHANGING_OPS and (
        document["op"] != protocol.OP_CHECK or "lease" in document
    )


def _build_error(kind: str, message: str, hint: str) -> Document:
    return {"error": {"kind": kind, "message": message, "hint": hint}}


def _describe_exception(error: Exception) -> str:
    """``Type: message (file:line)`` of the innermost frame."""
    place, where = "", sys.exc_info()[2]
    while where is not None:
        place = "%s:%d" % (os.path.basename(where.tb_frame.f_code.co_filename), where.tb_lineno)
        where = where.tb_next
    return "%s: %s (%s)" % (type(error).__name__, error, place)


def _find_operation(name: str) -> "Callable[[Document], Document]":  # noqa: C901 - a table of lazy imports
    if name == protocol.OP_PROBE:
        from ..measure.probe import probe_host as operation
    elif name == protocol.OP_READINGS:
        from ..measure.readings import measure_once as operation
    elif name == protocol.OP_ADOPT:
        from ..supervise.adoption import adopt_tasks as operation
    elif name == protocol.OP_START:
        from ..supervise.start import start_task as operation
    elif name == protocol.OP_TAKE_OVER:
        from ..supervise.takeover import take_over_task as operation
    elif name == protocol.OP_STOP:
        from ..supervise.stop import stop_task as operation
    elif name == protocol.OP_FORGET:
        from ..supervise.stop import forget_task_nodes as operation
    elif name == protocol.OP_ACTIVATE:
        from ..supervise.switch import activate_task as operation
    elif name == protocol.OP_DEACTIVATE:
        from ..supervise.switch import deactivate_task as operation
    elif name == protocol.OP_STATUS:
        from ..supervise.status import report_status as operation
    elif name == protocol.OP_WAIT:
        from ..supervise.status import wait_for_task as operation
    elif name == protocol.OP_MARK:
        from ..supervise.status import mark_task as operation
    elif name == protocol.OP_CHECK:
        from ..ros.question import run_check as operation
    elif name == protocol.OP_PULL:
        from ..containers.pull import pull_image as operation
    elif name == protocol.OP_RUN:
        from ..supervise.shell import run_program as operation
    elif name == protocol.OP_GRAPH:
        from ..ros.live import describe_graph as operation
    elif name == protocol.OP_HEAR:
        from ..ros.heard import hear as operation
    elif name == protocol.OP_LEASE:
        from ..supervise.lease import serve_lease as operation
    elif name == protocol.OP_LOGS:
        from ..supervise.logs import read_logs as operation
    elif name == protocol.OP_SAVE_STATE:
        from ..supervise.state_commands import save_state as operation
    elif name == protocol.OP_WRITE_STATE:
        from ..supervise.state_spool import write_state as operation
    elif name == protocol.OP_LOAD_STATE:
        from ..supervise.state_commands import load_state as operation
    elif name == protocol.OP_DROP_STATE:
        from ..supervise.state_spool import drop_state as operation
    elif name == protocol.OP_FETCH:
        from .fetch import read_file_piece as operation
    elif name == protocol.OP_SINK:
        from ..measure.bandwidth import start_sink as operation
    elif name == protocol.OP_SEND:
        from ..measure.bandwidth import send_to_sink as operation
    elif name == protocol.OP_SAMPLE_LINK:
        from ..measure.link_sample import sample_link as operation
    elif name == protocol.OP_SUPERVISE:
        from ..supervise.launch import run_supervisor as operation
    elif name == protocol.OP_PROFILER_START:
        from ..daemon.control import start_profiler as operation
    elif name == protocol.OP_PROFILER_STOP:
        from ..daemon.control import stop_profiler as operation
    elif name == protocol.OP_PROFILER_STATUS:
        from ..daemon.control import report_profiler as operation
    elif name == protocol.OP_PROFILER_RUN:
        from ..daemon.daemon import run_profiler as operation
    elif name == protocol.OP_COUNTERS:
        from ..measure.counters_setup import serve_counters as operation
    elif name == protocol.OP_DOCTOR:
        from ..measure.doctor import collect_facts as operation
    else:
        raise RefusalError(
            "unknown-op", "this agent has no operation %r" % name, "manager and agent differ in version"
        )
    return operation
