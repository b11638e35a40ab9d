# SPDX-License-Identifier: Apache-2.0
"""Changes of an experiment on real hosts: commands, requests to a person, and tasks that enter."""

import contextlib
import os
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from edgectl.errors import EdgectlError
from edgectl.experiments.model.mission_event import EventCommand, MissionEvent
from edgectl.gateway.program import run_program_on_host
from edgectl.model.text import clean_text
from edgectl.usecases.fleet import Fleet

# Asks a person to do something: text, seconds, and what ends the wait early; whether it was confirmed.
Ask = Callable[[str, float, threading.Event], bool]
_KEPT_BYTES = 2048


def ask_nobody(_text: str, seconds: float, ended: threading.Event) -> bool:
    """Let the time pass in which a person could act; nobody confirms."""
    ended.wait(seconds)
    return False


@dataclass(frozen=True, slots=True, kw_only=True)
class EventMeans:
    """What a change acts with. ``ended``: no wait goes on."""

    fleet: Fleet
    ask: Ask
    ended: threading.Event


def begin_change(means: EventMeans, event: MissionEvent) -> str:
    """Make the change; why it was not made, "" where it was."""
    return BEGIN_ON_HOSTS[event.change](means, event)


def end_change(means: EventMeans, event: MissionEvent) -> str:
    """Undo the change; why it was not undone, "" where it was."""
    return END_ON_HOSTS[event.change](means, event)


def _leave_to_watch(_means: EventMeans, _event: MissionEvent) -> str:
    """Of tasks that enter with the next plan."""
    return ""


def _begin_command(means: EventMeans, event: MissionEvent) -> str:
    assert event.run is not None  # noqa: S101 - the table is by this field
    return run_event_command(means.fleet, event.run, event.run.argv)


def _end_command(means: EventMeans, event: MissionEvent) -> str:
    assert event.run is not None  # noqa: S101
    return run_event_command(means.fleet, event.run, event.run.undo) if event.run.undo else ""


def _ask_person(means: EventMeans, event: MissionEvent) -> str:
    assert event.ask is not None  # noqa: S101
    if means.ask(event.ask.text, event.ask.deadline, means.ended):
        return ""
    return "" if means.ended.is_set() else f"no one confirmed it within {event.ask.deadline:g} s"


# What a change does when it begins and when it ends.
BEGIN_ON_HOSTS: Mapping[str, Callable[[EventMeans, MissionEvent], str]] = {
    "run": _begin_command,
    "ask": _ask_person,
    "join": _leave_to_watch,
    "add": _leave_to_watch,
}
END_ON_HOSTS: Mapping[str, Callable[[EventMeans, MissionEvent], str]] = {
    "run": _end_command,
    "ask": _leave_to_watch,
    "join": _leave_to_watch,
    "add": _leave_to_watch,
}


def run_event_command(fleet: Fleet, command: EventCommand, argv: Sequence[str]) -> str:
    """Run ``argv``, one of the two of ``command``, where it belongs; why it failed, "" where it did not."""
    if not command.on:
        return _run_on_manager(argv, command.deadline)
    host = fleet.inventory.hosts[command.on]
    try:
        reply = run_program_on_host(fleet.transport, host, argv, timeout=command.deadline)
    except EdgectlError as error:
        return f"{command.on}: {error.message}"
    return _describe_end(argv, reply.exit, reply.output, command.deadline)


def _run_on_manager(argv: Sequence[str], seconds: float) -> str:
    with tempfile.TemporaryFile() as output:
        try:
            process = subprocess.Popen(
                argv, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
            )
        except OSError as error:
            return f"{argv[0]}: {error.strerror}"
        try:
            status: int | None = process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            status = None
        finally:
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        output.seek(max(0, output.tell() - _KEPT_BYTES))
        lines = output.read().decode("utf-8", "replace").strip().splitlines()
    return _describe_end(argv, status, clean_text(lines[-1], 500) if lines else "", seconds)


def _describe_end(argv: Sequence[str], status: int | None, last_line: str, seconds: float) -> str:
    if status == 0:
        return ""
    what = f"did not end within {seconds:g} s" if status is None else f"exited with {status}"
    return f"{argv[0]} {what}" + (f": {last_line}" if last_line else "")
