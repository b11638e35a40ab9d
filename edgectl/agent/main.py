"""One request in, one reply out. Each operation imports only what it needs: start-up is most of a probe's cost."""

import os
import sys

from . import lease, light, state
from .errors import RefusalError

# A little below the manager's limit of 1 MiB, which counts noise as well.
_MOST_BYTES = (1 << 20) - 65536


def serve(request: bytes, channel, bases: list) -> None:
    """Carry out ``request`` and reply on ``channel``; every failure becomes an ``error`` document."""
    state.BASES[:] = bases
    try:
        document = light.loads(request.decode("utf-8"))
        lease.renew(document["host"])
        if document["op"] == "follow":
            from .logs import follow

            return follow(document, channel)
        reply = _operation(document["op"])(document)
    except RefusalError as refusal:
        reply = {"error": {"kind": refusal.kind, "message": refusal.message, "hint": refusal.hint}}
    except Exception as error:  # noqa: BLE001 - whatever it was, the manager gets a document, not a traceback
        reply = {
            "error": {
                "kind": "agent-error",
                "message": _described(error),
                "hint": "report this: it is a mistake in edgectl's agent",
            }
        }
    payload = light.dumps(reply).encode("ascii")
    if len(payload) > _MOST_BYTES:
        payload = b'{"error": {"kind": "too-large", "message": "the reply is larger than 1 MiB", "hint": "ask for less"}}'
    return channel.reply(payload)


def _described(error: Exception) -> str:
    where = sys.exc_info()[2]
    while where.tb_next is not None:
        where = where.tb_next
    place = "%s:%d" % (os.path.basename(where.tb_frame.f_code.co_filename), where.tb_lineno)
    return "%s: %s (%s)" % (type(error).__name__, error, place)


def _operation(name: str):  # noqa: C901 - a table of lazy imports
    if name == "probe":
        from .probe import probe as operation
    elif name == "start":
        from .start import start as operation
    elif name == "stop":
        from .stop import stop as operation
    elif name == "status":
        from .status import status as operation
    elif name == "wait":
        from .status import wait as operation
    elif name == "mark":
        from .status import mark as operation
    elif name == "check":
        from .shell import check as operation
    elif name == "logs":
        from .logs import logs as operation
    elif name == "fetch":
        from .fetch import fetch as operation
    elif name == "sink":
        from .bandwidth import sink as operation
    elif name == "supervise":
        from .launch import supervise as operation
    elif name == "profiler-start":
        from .reside import start as operation
    elif name == "profiler-stop":
        from .reside import stop as operation
    elif name == "profiler-status":
        from .reside import status as operation
    elif name == "profiler-run":
        from .resident import resident as operation
    elif name == "send":
        from .bandwidth import send as operation
    elif name == "doctor":
        from .doctor import doctor as operation
    else:
        raise RefusalError(
            "unknown-op", "this agent knows no operation %r" % name, "manager and agent differ in version"
        )
    return operation
