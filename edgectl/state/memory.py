"""The manager's memory of a fleet on disk: a cache and a history. Losing it costs history, never a running task."""

import dataclasses
from pathlib import Path

from edgectl.formats import memory as form
from edgectl.formats.base import FormatErrors
from edgectl.model.memory import Memory
from edgectl.state.files import Warn, load_or_set_aside, silent, write_json

NAME = "memory.json"


def load_memory(fleet_dir: Path, warn: Warn = silent) -> Memory:
    """What is remembered of the fleet; empty where nothing is. A broken file is set aside and said through ``warn``.

    Raises:
        StateError: a newer edgectl wrote it.
    """
    return load_or_set_aside(fleet_dir / NAME, _decode, Memory(), warn)


def _decode(document: dict[str, object]) -> Memory:
    try:
        return form.decode(document)
    except FormatErrors as error:
        raise ValueError(error.message) from error


def kept(memory: Memory) -> Memory:
    """What this file keeps: contacts and fences stand in a file of their own (``state.contacts``), measured demands in the history."""
    return dataclasses.replace(memory, contact={}, fenced=frozenset(), measured={})


def save_memory(fleet_dir: Path, memory: Memory) -> None:
    """Replace what is remembered, whole or not at all.

    Raises:
        StateError: the disk does not take it.
    """
    write_json(fleet_dir / NAME, form.encode(kept(memory)))
