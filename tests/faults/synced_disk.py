# SPDX-License-Identifier: Apache-2.0
"""Emulation of a power loss: a disk that keeps only synced data, loaded as ``sitecustomize``.

File contents are copied to ``$SYNCED_DISK_SHADOW`` when they are synced, and a directory's names when the
directory is. After a power cut of the manager, the shadow is the content of its disk: `restore_synced_files`
builds it. A file with a synced name and unsynced content is empty.
"""

import json
import os
import time
from pathlib import Path

SHADOW = os.environ.get("SYNCED_DISK_SHADOW", "")
WATCHED = os.environ.get("SYNCED_DISK_ROOT", "")
original_fsync = os.fsync


def record_fsync(descriptor: int) -> None:
    """Sync, and record in the shadow what is durable by now."""
    original_fsync(descriptor)
    path = str(Path(f"/proc/self/fd/{descriptor}").readlink())
    if path.startswith(WATCHED):
        _record_synced(Path(path), os.fstat(descriptor).st_ino, Path(SHADOW))


def record_all(shadow: Path, root: Path) -> None:
    """Record that what is below ``root`` now has been on the disk for long."""
    for path in (root, *root.rglob("*")):
        if path.is_dir() or path.is_file():
            _record_synced(path, path.stat().st_ino, shadow)


def _record_synced(path: Path, inode: int, shadow: Path) -> None:
    now = time.monotonic_ns()
    if path.is_dir():
        names = {each.name: each.stat().st_ino for each in path.iterdir() if each.is_file()}
        _replace_file(shadow / f"{inode}.dir", json.dumps([now, str(path), names]).encode())
    else:
        _replace_file(shadow / f"{inode}.file", path.read_bytes())
        _replace_file(shadow / f"{inode}.name", json.dumps([now, str(path)]).encode())


def _replace_file(path: Path, data: bytes) -> None:
    temporary = path.with_name(f"{path.name}.{os.getpid()}.new")
    temporary.write_bytes(data)
    temporary.replace(path)


def restore_synced_files(shadow: Path, root: Path) -> None:
    """Reduce the files below ``root`` to what survives a power cut."""
    synced = {
        Path(path): (at, names)
        for at, path, names in (json.loads(note.read_text()) for note in shadow.glob("*.dir"))
    }
    alone = [(*json.loads(note.read_text()), int(note.stem)) for note in shadow.glob("*.name")]
    for directory in [path for path in root.rglob("*") if path.is_dir()]:
        at, names = synced.get(directory, (0, {}))
        # As on ext4: syncing a new file makes its name durable, too.
        names |= {
            Path(path).name: inode
            for when, path, inode in alone
            if Path(path).parent == directory and when > at
        }
        for path in directory.iterdir():
            if path.is_file():
                path.unlink()
        for name, inode in names.items():
            content = shadow / f"{inode}.file"
            (directory / name).write_bytes(content.read_bytes() if content.exists() else b"")
            (directory / name).chmod(0o600)


if SHADOW:
    os.fsync = record_fsync  # type: ignore[assignment]
