"""A disk that keeps only what was synced, for one manager: put before its path as ``sitecustomize``.

Copies of files go to ``$POWERLESS_SHADOW`` when they are synced, and a directory's names when the directory is. After the manager's power
is cut, the shadow is what its disk holds: `survivors` builds it. A file whose name was synced but whose content never was is empty.
"""

import json
import os
import time
from pathlib import Path

SHADOW = os.environ.get("POWERLESS_SHADOW", "")
WATCHED = os.environ.get("POWERLESS_ROOT", "")
real_fsync = os.fsync


def recording_fsync(descriptor: int) -> None:
    """Sync, and note in the shadow what is durable by it."""
    real_fsync(descriptor)
    path = str(Path(f"/proc/self/fd/{descriptor}").readlink())
    if path.startswith(WATCHED):
        _note(Path(path), os.fstat(descriptor).st_ino)


def _note(path: Path, inode: int) -> None:
    now = time.monotonic_ns()
    if path.is_dir():
        names = {each.name: each.stat().st_ino for each in path.iterdir() if each.is_file()}
        _put(Path(SHADOW) / f"{inode}.dir", json.dumps([now, str(path), names]).encode())
    else:
        _put(Path(SHADOW) / f"{inode}.file", path.read_bytes())
        _put(Path(SHADOW) / f"{inode}.name", json.dumps([now, str(path)]).encode())


def _put(path: Path, data: bytes) -> None:
    temporary = path.with_name(f"{path.name}.{os.getpid()}.new")
    temporary.write_bytes(data)
    temporary.replace(path)


def survivors(shadow: Path, root: Path) -> None:
    """Make the files below ``root`` what a power cut would leave of them."""
    synced = {
        Path(path): (at, names)
        for at, path, names in (json.loads(note.read_text()) for note in shadow.glob("*.dir"))
    }
    alone = [(*json.loads(note.read_text()), int(note.stem)) for note in shadow.glob("*.name")]
    for directory in [path for path in root.rglob("*") if path.is_dir()]:
        at, names = synced.get(directory, (0, {}))
        # As on ext4: a new file that was synced itself has its name on the disk, too.
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
    os.fsync = recording_fsync  # type: ignore[assignment]
