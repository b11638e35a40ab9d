# SPDX-License-Identifier: Apache-2.0
"""Reading of files as text: present, readable, bounded, UTF-8."""

import grp
import os
import pwd
import sys
from pathlib import Path
from stat import S_IMODE, S_ISREG, S_IWGRP, S_IWOTH

from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.names import suggest_name

MAX_INPUT_BYTES = 2**20
# Names standard input where a document is read.
STDIN = Path("-")


def read_source(
    path: Path, problems: Problems, *, max_bytes: int = MAX_INPUT_BYTES, maker: str = "edgectl init DIR"
) -> Source | None:
    """The file's text, or None with the cause collected. ``maker``: the command that creates such a file, if
    any.
    """
    nowhere = Mark(Source(file=str(path), text="", lines=()), 0, 0)
    try:
        if not S_ISREG(path.stat().st_mode) and not path.is_dir():
            problems.add(
                nowhere,
                ProblemCode.UNREADABLE,
                "is not a regular file",
                "name a regular file; save the output of a pipe or device in one first",
            )
            return None
        with path.open("rb") as stream:
            _warn_if_exposed(path, os.fstat(stream.fileno()), problems)
            data = stream.read(max_bytes + 1)
    except (OSError, ValueError) as error:
        problems.add(nowhere, ProblemCode.UNREADABLE, *_explain_read_error(path, error, maker))
        return None
    return _decode_bounded(nowhere, data, problems, max_bytes)


def read_stdin(problems: Problems, *, max_bytes: int) -> Source | None:
    """The text on standard input, named ``-``, or None with the cause collected."""
    nowhere = Mark(Source(file=str(STDIN), text="", lines=()), 0, 0)
    return _decode_bounded(nowhere, sys.stdin.buffer.read(max_bytes + 1), problems, max_bytes)


def _decode_bounded(nowhere: Mark, data: bytes, problems: Problems, max_bytes: int) -> Source | None:
    if len(data) > max_bytes:
        message = f"the file is larger than {max_bytes // 2**20} MiB"
        problems.add(nowhere, ProblemCode.SIZE, message, "split it, or check that it is the right file")
        return None
    return decode_source(nowhere.source.file, data, problems)


def _warn_if_exposed(path: Path, status: os.stat_result, problems: Problems) -> None:
    exposure = describe_exposure(path, status)
    if exposure is not None:
        nowhere = Mark(Source(file=str(path), text="", lines=()), 0, 0)
        problems.add(nowhere, ProblemCode.EXPOSED, *exposure, warning=True)


def describe_exposure(path: Path, status: os.stat_result) -> tuple[str, str] | None:
    """The users besides the caller and root who may write the file, and the remedy; None without any (ADR
    50).
    """
    if status.st_uid not in _list_trusted_users():
        message, mend = f"user {status.st_uid} owns it and may change it", f"chown it: {path}"
    elif status.st_mode & S_IWOTH:
        message, mend = f"every user may change it (mode {S_IMODE(status.st_mode):04o})", f"chmod go-w {path}"
    elif status.st_mode & S_IWGRP and not _is_private_group(status.st_gid):
        message, mend = f"group {status.st_gid} may change it", f"chmod g-w {path}"
    else:
        return None
    return message, f"{mend}; or use it nevertheless: --insecure-files"


def _list_trusted_users() -> set[int]:
    """Root, the caller, and whoever became root by sudo."""
    sudo = os.environ.get("SUDO_UID", "") if os.geteuid() == 0 else ""
    return {0, os.geteuid(), *([int(sudo)] if sudo.isdecimal() else [])}


def _is_private_group(group: int) -> bool:
    """Whether this is the group of the caller alone, which has the caller's name."""
    try:
        user, entry = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return user.pw_gid == group and entry.gr_name == user.pw_name and set(entry.gr_mem) <= {user.pw_name}


def _explain_read_error(path: Path, error: Exception, maker: str) -> tuple[str, str]:
    if isinstance(error, FileNotFoundError):
        match = suggest_name(path.name, _list_names(path.parent))
        hint = (
            f"did you mean {path.parent / match}?"
            if match
            else "name an existing file" + f", or create one: {maker}" * bool(maker)
        )
        return "no such file", hint
    if isinstance(error, IsADirectoryError):
        inside = sorted(name for name in _list_names(path) if name.endswith((".yaml", ".yml", ".json")))
        return (
            "is a directory, not a file",
            f"name a file in it: {path / inside[0]}" if inside else "name a file",
        )
    if isinstance(error, PermissionError):
        return "permission denied", f"allow reading it: chmod u+r {path}"
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"cannot be read: {reason}", ""


def _list_names(directory: Path) -> list[str]:
    try:
        return [entry.name for entry in directory.iterdir()]
    except OSError:
        return []


def decode_source(file: str, data: bytes, problems: Problems) -> Source | None:
    """The text of a file's bytes, or None with the first byte that is not UTF-8 reported."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        start = data.rfind(b"\n", 0, error.start) + 1
        shown = data[start:].split(b"\n", 1)[0].decode("utf-8", "replace")
        line = data.count(b"\n", 0, error.start) + 1
        source = Source(file=file, text="", lines=("",) * (line - 1) + (shown,))
        column = len(data[start : error.start].decode("utf-8", "replace")) + 1
        message = f"byte 0x{data[error.start]:02x} is not UTF-8"
        problems.add(Mark(source, line, column), ProblemCode.ENCODING, message, "save the file as UTF-8")
        return None
    return Source(
        file=file, text=text, lines=tuple(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))
    )
