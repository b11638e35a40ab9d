# SPDX-License-Identifier: Apache-2.0
"""``-v`` and ``--log-format``: logins and requests on stderr, as text or JSON lines."""

import json
import sys
import time

from edgectl.cli import console
from edgectl.transport.base import TraceEvent, add_trace_listener
from edgectl.units import format_instant


def show_trace(level: int, form: str) -> None:
    """Print every login and request; from ``level`` 2 on also what the SSH client says of itself."""
    add_trace_listener(_print_json if form == "json" else _print_text)
    if level > 1:
        _show_ssh_log(form)


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


def _show_ssh_log(form: str) -> None:
    import logging

    class SshLog(logging.Handler):
        """Lines of paramiko, which never contain keys or passwords."""

        def emit(self, record: logging.LogRecord) -> None:
            if form == "json":
                _print_line({"at": format_instant(record.created), "ssh": record.getMessage()})
            else:
                console.print_message(f"ssh: {record.getMessage()}")

    logger = logging.getLogger("paramiko")
    logger.setLevel(logging.INFO)
    logger.addHandler(SshLog())


def _print_line(fields: dict[str, object]) -> None:
    sys.stderr.write(json.dumps(fields, ensure_ascii=False) + "\n")
