# SPDX-License-Identifier: Apache-2.0
"""Fetch one file that a task wrote on a host."""

import binascii
import time

from edgectl.agent.link import protocol
from edgectl.errors import DeadlineError, RefusedError, ReplyError
from edgectl.gateway.replies import PieceReply, decode_reply
from edgectl.model.inventory import Host
from edgectl.model.task import Task
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Transport

MAX_FILE_BYTES = 32 << 20


def fetch_file(transport: Transport, host: Host, task: Task, file: str, *, timeout: float) -> bytes:
    """The content of a regular file on ``host``, at most ``MAX_FILE_BYTES``, within ``timeout`` s in all.

    ``file`` is absolute, begins with ``~``, or is taken from the working directory of ``task``.

    Raises:
        RefusedError: there is no such file, it cannot be read, is too large, is a link, or changed meanwhile.
        HostError: the host did not give it.
    """
    deadline = time.monotonic() + timeout
    request = {
        "op": protocol.OP_FETCH,
        "fleet": host.fleet,
        "host": host.name,
        "task": task.name,
        "workdir": task.host_workdir,
        "file": file,
        "most": MAX_FILE_BYTES,
    }
    with transport.connect(host, timeout=timeout) as session:
        data, total, mark = bytearray(), -1, ""
        while len(data) != total:
            left = deadline - time.monotonic()
            if left <= 0:
                raise DeadlineError(f"{file} did not arrive within {timeout:.3g} s", hint="allow more time")
            document = call_agent(session, {**request, "offset": len(data)}, timeout=left)
            reply = decode_reply(PieceReply, document)
            if data and reply.mark != mark:
                raise RefusedError(f"{file} changed while it was read", hint="fetch it once it is complete")
            total, mark = reply.size, reply.mark
            data += _decode_piece(reply, len(data), total)
    return bytes(data)


def _decode_piece(reply: PieceReply, offset: int, size: int) -> bytes:
    """The bytes of a piece; at least one while some are missing, so that the loop ends."""
    try:
        piece = binascii.a2b_base64(reply.data)
    except ValueError:
        raise ReplyError("the piece of a file is garbled") from None
    if not 0 <= size <= MAX_FILE_BYTES or offset + len(piece) > size or (not piece and offset < size):
        raise ReplyError(f"the piece of a file does not fit: {len(piece)} bytes at {offset} of {size}")
    return piece
