# SPDX-License-Identifier: Apache-2.0
"""Operations ``logs`` and ``follow``: the log of a task as text or as a stream."""

import select
import time

from ..link import protocol
from ..link.fast_json import Document
from . import logfile, state_dir, status

TYPE_CHECKING = False
if TYPE_CHECKING:
    from ..link.boot import Channel

_KEEPALIVE_S = 3.0
_POLL_S = 0.2
_DEFAULT_LINES = 100


def _find_log_folder(request: Document) -> str:

    record, _ = status.find_current(request["host"], request["task"])
    return record.folder if record is not None else ""


def _read_asked_text(folder: str, request: Document) -> "tuple[bytes, str]":
    """Read what the request asks for, and a note on what is not known of it."""
    since_s, previous, tail = request.get("since_s"), bool(request.get("previous")), request.get("tail")
    if folder and (since_s is not None or previous):
        from .log_select import read_selected

        return read_selected(folder, since_s, previous=previous, lines=tail)
    return logfile.read_log_tail(folder, _DEFAULT_LINES if tail is None else int(tail)), ""


def read_logs(request: Document) -> Document:
    """Operation ``logs``: the end of the log, or of a part of it, as text."""
    data, note = _read_asked_text(_find_log_folder(request), request)
    text = data.decode("utf-8", "replace")
    # An escaped character takes up to six bytes; the reply must stay below protocol.MAX_REPLY_BYTES.
    while (
        len(text) > logfile.MAX_TEXT_BYTES // 4
        and sum(6 if ord(letter) > 126 or ord(letter) < 32 else 1 for letter in text) > 900000
    ):
        text = text[len(text) // 2 :]
    return {
        "v": protocol.VERSION,
        "op": protocol.OP_LOGS,
        "host": request["host"],
        "task": request["task"],
        "text": text,
        "note": note,
    }


def follow_log(request: Document, channel: "Channel") -> None:
    """Operation ``follow``: a frame, then chunks ``length newline bytes``, ``0`` as a keep-alive, ``end``
    after the end of the task.
    """
    state_dir.check_name(request["task"])
    folder = _find_log_folder(request)
    start, _ = _read_asked_text(folder, request)
    channel.reply(b'{"stream": true}')
    reader = logfile.LogReader(folder)
    if start:
        channel.write(b"%d\n%s" % (len(start), start))
    gone = select.poll()
    gone.register(channel.fd, 0)
    last, ended = time.monotonic(), False
    while not gone.poll(0):
        data = reader.read()
        now = time.monotonic()
        if data or now - last >= _KEEPALIVE_S:
            channel.write(b"%d\n%s" % (len(data), data))
            last = now
        elif ended:
            return channel.write(b"end\n")
        if not data:
            ended = not status.find_current(request["host"], request["task"])[1]
            time.sleep(_POLL_S)
    return None
