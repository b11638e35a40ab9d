# SPDX-License-Identifier: Apache-2.0
"""One run of an ``on_event`` program: its input, its deadline, and what it says when it fails."""

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Sequence

from edgectl.formats.document import Document
from edgectl.formats.event_document import encode_event
from edgectl.model.event import Event, EventHook
from edgectl.model.secret import MASK

# Of one run; what is older is counted only.
MAX_EVENTS = 100
_MAX_MESSAGE, _MAX_OUTPUT_BYTES = 1000, 4096
_GRACE_S, _POLL_S = 2.0, 0.05


def build_hook_document(
    hook: EventHook, fleet: str, events: Sequence[Event], secrets: Sequence[str], *, test: bool = False
) -> Document:
    """What the program reads on its standard input: the newest ``MAX_EVENTS`` of ``events``, oldest first."""
    items = [encode_event(event) for event in events[-MAX_EVENTS:]]
    for item in items:
        item["message"] = mask_secrets(str(item["message"]), secrets)[:_MAX_MESSAGE]
    document: Document = {
        "format_version": 1,
        "kind": "event",
        "fleet": fleet,
        "test": test,
        "omitted": max(0, len(events) - MAX_EVENTS),
        "items": items,
    }
    return {**document, "options": dict(hook.options)} if hook.notifier else document


def mask_secrets(text: str, secrets: Sequence[str]) -> str:
    """``text`` without the secrets; the longest first, for one may be a part of another."""
    for secret in sorted(secrets, key=len, reverse=True):
        text = text.replace(secret, MASK) if secret else text
    return text


def list_hook_command(hook: EventHook) -> list[str]:
    """The argument vector: the command, or edgectl's own program that calls the notifier."""
    return list(hook.command) or [sys.executable, "-P", "-m", "edgectl.usecases.run_notifier", hook.notifier]


def run_hook(hook: EventHook, document: Document, secrets: Sequence[str] = ()) -> str:
    """Run the program of ``hook``; why it failed, empty if it did not, without ``secrets``.

    It has a session of its own, so that Ctrl-C does not reach it and all that it starts ends with it.
    """
    data = os.memfd_create("on_event", os.MFD_CLOEXEC)
    try:
        with open(data, "wb", closefd=False) as file:
            file.write(json.dumps(document, ensure_ascii=False).encode())
        os.lseek(data, 0, os.SEEK_SET)
        child = subprocess.Popen(
            list_hook_command(hook),
            stdin=data,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        return f"cannot be started: {error.strerror}"
    finally:
        os.close(data)
    try:
        last = _read_until_end(child, hook.timeout)
        if last is None:
            return f"did not end within {hook.timeout:g} s"
        said = _mask_output(last, secrets).strip().splitlines()
        return "" if child.returncode == 0 else ": ".join(_list_causes(child.returncode, said[-1:]))
    finally:
        _end_group(child)


def _mask_output(output: bytes, secrets: Sequence[str]) -> str:
    """The text of ``output`` without the secrets: before it is cut into lines, for a part is not found."""
    text = mask_secrets(output.decode(errors="replace"), secrets)
    # A full tail may begin within a secret.
    return text[max(map(len, secrets), default=0) :] if len(output) >= _MAX_OUTPUT_BYTES else text


def _list_causes(status: int, said: Sequence[str]) -> list[str]:
    ended = f"was ended by signal {-status}" if status < 0 else f"failed with exit code {status}"
    return [ended, *(line[:200] for line in said)]


def _read_until_end(child: "subprocess.Popen[bytes]", timeout: float) -> bytes | None:
    """The last part of what the program prints, once it has ended; None if it does not in time.

    All is read, so that a program that prints much does not wait, and only the end is kept. What it leaves
    running may keep the pipe open; that is not waited for.
    """
    assert child.stdout is not None  # noqa: S101 - for mypy: it is a pipe
    deadline, tail = time.monotonic() + timeout, b""
    with selectors.DefaultSelector() as selector:
        selector.register(child.stdout, selectors.EVENT_READ)
        while (left := deadline - time.monotonic()) > 0:
            ended = child.poll() is not None
            if selector.get_map() and selector.select(0 if ended else min(left, _POLL_S)):
                piece = os.read(child.stdout.fileno(), 1 << 16)
                if not piece:
                    selector.unregister(child.stdout)
                tail = (tail + piece)[-_MAX_OUTPUT_BYTES:]
            elif ended:
                return tail
            elif not selector.get_map():
                time.sleep(min(left, _POLL_S))
    return None


def _end_group(child: "subprocess.Popen[bytes]") -> None:
    """End the program and what it has started in its session; never waits long."""
    try:
        if child.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(_GRACE_S)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
    finally:
        if child.stdout is not None:
            child.stdout.close()
