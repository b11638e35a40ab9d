# SPDX-License-Identifier: Apache-2.0
"""Small JSON files: written whole or not at all, the previous one kept, a broken one set aside."""

import contextlib
import fcntl
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, TypeVar

from edgectl.errors import StateError
from edgectl.formats.document import FormatErrors
from edgectl.state.failpoints import hit_failpoint
from edgectl.state.paths import open_private_file, sync_dir

STATE_FORMAT_VERSION = 1
Warn = Callable[[str], None]
Value = TypeVar("Value")
# Inode, size and time of the last change (ns): another where a file was replaced.
FileStamp = tuple[int, int, int]


def ignore_warning(_text: str) -> None:
    """Drop a warning."""


def read_stamp(path: Path) -> FileStamp | None:
    """What differs once the file was replaced; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def write_json(path: Path, document: object, *, keep: bool = True) -> None:
    """Replace ``path`` by ``document``: temporary file, fsync, rename, fsync of the directory.

    ``keep`` the old one as ``.previous``.

    Raises:
        StateError: the disk does not take it; the old file still stands.
    """
    data = json.dumps(document, ensure_ascii=False, allow_nan=False, indent=1).encode() + b"\n"
    temporary = path.with_name(f"{path.name}.tmp")
    try:
        with os.fdopen(_open_locked_temporary(temporary), "wb") as file:
            _write_synced(file, data, temporary)
            hit_failpoint("state temp written")
            if keep:
                _keep_previous(path)
            temporary.replace(path)
        hit_failpoint("state renamed")
        sync_dir(path.parent)
        hit_failpoint("directory fsynced")
    except OSError as error:
        raise StateError(
            f"cannot write {path}: {error.strerror}",
            hint="free some space; what runs on the hosts is not affected",
        ) from error


def _open_locked_temporary(temporary: Path) -> int:
    """A descriptor of the temporary file, locked for us alone.

    One that a killed edgectl left behind is used again.
    """
    while True:
        descriptor = open_private_file(temporary, os.O_RDWR)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), temporary.lstat()):
                return descriptor
        # Whoever had it has renamed it since.
        os.close(descriptor)


def _write_synced(file: BinaryIO, data: bytes, path: Path) -> None:
    try:
        file.truncate()
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    except OSError:
        path.unlink(missing_ok=True)
        raise


def _keep_previous(path: Path) -> None:
    previous = path.with_name(path.name + ".previous")
    with contextlib.suppress(FileNotFoundError):
        previous.unlink()
    with contextlib.suppress(FileNotFoundError):
        os.link(path, previous, follow_symlinks=False)


def set_aside(path: Path) -> Path:
    """Rename a broken file to the first free ``.broken-N`` and return its new path."""
    number = 1
    while (target := path.with_name(f"{path.name}.broken-{number}")).exists():
        number += 1
    path.rename(target)
    sync_dir(path.parent)
    return target


def read_json(path: Path) -> dict[str, object] | None:
    """The object in ``path``, or None where there is no file.

    Raises:
        ValueError: it is not a JSON object, or not readable as a file; the message says where.
        StateError: a newer edgectl wrote it.
    """
    try:
        document = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ValueError(error.strerror) from error
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(document, dict):
        raise ValueError("not a JSON object")
    version = document.get("format_version")
    if isinstance(version, int) and version > STATE_FORMAT_VERSION:
        raise StateError(
            f"{path} was written by a newer edgectl (format {version})",
            hint="use that edgectl, or move the file away",
        )
    return document


def load_or_set_aside(
    path: Path, decode: Callable[[dict[str, object]], Value], default: Value, warn: Warn
) -> Value:
    """The decoded content of ``path``.

    A broken file is set aside, reported through ``warn``, and the previous one used.
    """
    for candidate in (path, path.with_name(path.name + ".previous")):
        try:
            document = read_json(candidate)
            if document is not None:
                return decode(document)
        except (ValueError, FormatErrors) as error:
            warn(f"{candidate} is broken ({error}); set aside as {set_aside(candidate).name}")
        else:
            if candidate == path:
                return default
    return default
