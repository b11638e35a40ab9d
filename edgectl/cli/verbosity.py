# SPDX-License-Identifier: Apache-2.0
"""``-v`` and ``--log-format``: logins and requests on stderr, as text or JSON lines."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from edgectl.cli import console
from edgectl.transport.base import TraceEvent, listen_to_calls
from edgectl.units import format_instant


@contextmanager
def show_trace(level: int, form: str) -> Iterator[None]:
    """Print every login and request within; from ``level`` 2 on also what the SSH client says of itself."""
    with ExitStack() as stack:
        stack.enter_context(listen_to_calls(_print_json if form == "json" else _print_text))
        if level > 1:
            stack.callback(_show_ssh_log(form))
        yield


def _print_text(event: TraceEvent) -> None:
    task = f" {event.task}" if event.task else ""
    result = f"failed: {event.error}" if event.error else "ok"
    console.print_message(f"{event.host}: {event.operation}{task} {event.duration_s:.3f}s {result}")


def _print_json(event: TraceEvent) -> None:
    fields = {
        "at": format_instant(time.time()),
        "host": event.host,
        "operation": event.operation,
        "task": event.task or None,
        "duration_s": round(event.duration_s, 6),
        "error": event.error or None,
    }
    _print_line({key: value for key, value in fields.items() if value is not None})


def _show_ssh_log(form: str) -> Callable[[], None]:
    """Print the log of the SSH client until the returned function is called."""
    import logging

    class SshLog(logging.Handler):
        """Lines of paramiko, which never contain keys or passwords."""

        def emit(self, record: logging.LogRecord) -> None:
            if form == "json":
                _print_line({"at": format_instant(record.created), "ssh": record.getMessage()})
            else:
                console.print_message(f"ssh: {record.getMessage()}")

    logger, handler = logging.getLogger("paramiko"), SshLog()
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)

    def end() -> None:
        logger.removeHandler(handler)
        logger.setLevel(level)

    return end


def _print_line(fields: dict[str, object]) -> None:
    sys.stderr.write(json.dumps(fields, ensure_ascii=False) + "\n")
