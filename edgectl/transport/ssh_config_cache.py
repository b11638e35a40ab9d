# SPDX-License-Identifier: Apache-2.0
"""Replies of ``ssh -G`` of earlier runs, kept while everything that they depend on is the same (ADR 198)."""

import contextlib
import glob
import hashlib
import json
import os
import re
import socket
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path

Values = Mapping[str, list[str]]
# An OpenSSH client elsewhere may have been built to read another file than /etc/ssh/ssh_config.
_USUAL_FOLDER = Path("/usr/bin")
# A comment, or a keyword with its arguments; a $ stands for the environment.
_LINE = re.compile(r"[ \t]*(?:#.*|([A-Za-z0-9]+)(?:[ \t]+|[ \t]*=[ \t]*)([^$]*))?")
# Beginnings of keywords whose effect depends on more than the files and the arguments.
_VARIABLE_KEYWORDS = ("match", "canonical")
_PLAIN_PATTERNS = re.compile(r"(?:(?:~/)?[A-Za-z0-9_./*?+,:@-]+[ \t]*)+")
_MAX_FILES, _MAX_REPLIES = 100, 4096


def compute_config_digest(
    ssh: str, files: Mapping[Path, Path], home: Path, keywords: Collection[str]
) -> str | None:
    """Digest of all that the replies of ``ssh -G`` depend on besides its arguments.

    ``ssh`` is the program, and ``files`` are what it reads, each with the folder of relative names that it
    includes; ``keywords``: those that are kept. None where no digest can say it: of a program that may read
    other files, and of Match, environment variables, names canonicalized by DNS, and lines that are not
    surely understood.
    """
    if Path(ssh).resolve().parent != _USUAL_FOLDER:
        return None
    try:
        program = Path(ssh).stat()
        parts = [program.st_ino, program.st_size, program.st_mtime_ns, os.getuid(), socket.gethostname()]
        parts += sorted(keywords)
        for path, folder in files.items():
            parts += _read_with_includes(path, folder, home)
    except (OSError, ValueError):
        return None
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _read_with_includes(file: Path, folder: Path, home: Path) -> list[str | int]:
    """Path, owner, mode and text of a file and of all that it includes.

    Raises:
        ValueError: a line depends on more than the files, or is not surely understood.
        OSError: a file that exists cannot be read.
    """
    parts: list[str | int] = []
    waiting = [file]
    for path in waiting:
        parts.append(str(path))
        with contextlib.suppress(FileNotFoundError):
            status, text = path.stat(), path.read_text()
            parts += [status.st_uid, status.st_mode, text]
            for pattern in _list_included_patterns(text):
                absolute = home / pattern[2:] if pattern.startswith("~/") else folder / pattern
                waiting += map(Path, sorted(glob.glob(str(absolute))))  # noqa: PTH207
        if len(waiting) > _MAX_FILES:
            raise ValueError("too many files")
    return parts


def _list_included_patterns(text: str) -> list[str]:
    """Patterns of all Include lines, whatever block they are in.

    Raises:
        ValueError: as ``_read_with_includes``.
    """
    patterns: list[str] = []
    for line in text.split("\n"):
        found = _LINE.fullmatch(line.rstrip())
        if found is None:
            raise ValueError("a line that is not surely understood")
        keyword = (found[1] or "").lower()
        if keyword.startswith(_VARIABLE_KEYWORDS):
            raise ValueError(f"{keyword} depends on more than the files")
        if keyword == "include":
            if not _PLAIN_PATTERNS.fullmatch(found[2]):
                raise ValueError("patterns that are not plain")
            patterns += found[2].split()
    return patterns


def _check_values(values: dict[str, list[str]]) -> dict[str, list[str]]:
    """``values`` of a file.

    Raises:
        ValueError: they are not lists of texts.
    """
    if not all(
        isinstance(texts, list) and all(isinstance(text, str) for text in texts) for texts in values.values()
    ):
        raise ValueError("no values of ssh_config")
    return values


class SshConfigCache:
    """Values by the arguments of ``ssh -G``, in one file. Safe to use from several threads.

    A file that cannot be read or written is as good as none.
    """

    def __init__(self, path: Path, compute_digest: Callable[[], str | None]) -> None:
        """``compute_digest`` says which replies are good; where it returns None nothing is kept."""
        self._path, self._compute_digest = path, compute_digest
        self._lock = threading.Lock()
        self._asking, self._added = 0, False
        self._digest = compute_digest()
        self._values = self._load() if self._digest else {}

    def _load(self) -> dict[str, dict[str, list[str]]]:
        try:
            document = json.loads(self._path.read_bytes())
            replies = document["replies"] if document["digest"] == self._digest else {}
            return {key: _check_values(values) for key, values in replies.items()}
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return {}

    def get(self, arguments: Sequence[str], ask: Callable[[], dict[str, list[str]]]) -> Values:
        """The kept values of a reply, or those that ``ask`` returns.

        The last of the threads that ask at once writes the file.
        """
        key = json.dumps(arguments)
        if key in self._values:
            return self._values[key]
        with self._asking_one():
            values = ask()
            if self._digest:
                self._values[key] = values
                self._added = True
        return values

    @contextlib.contextmanager
    def _asking_one(self) -> Iterator[None]:
        with self._lock:
            self._asking += 1
        try:
            yield
        finally:
            with self._lock:
                self._asking -= 1
                if self._added and not self._asking:
                    self._added = False
                    self._save()

    def _save(self) -> None:
        """Replace the file, unless what the replies depend on has changed while they were asked for."""
        if self._compute_digest() != self._digest:
            return
        kept = dict(list(self._values.items())[-_MAX_REPLIES:])
        temporary = self._path.with_name(f"{self._path.name}.{os.getpid()}")
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
        with contextlib.suppress(OSError):
            try:
                with os.fdopen(os.open(temporary, flags, 0o600), "w") as file:
                    json.dump({"digest": self._digest, "replies": kept}, file)
                temporary.replace(self._path)
            except OSError:
                temporary.unlink(missing_ok=True)
