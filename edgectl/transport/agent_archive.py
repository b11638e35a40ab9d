# SPDX-License-Identifier: Apache-2.0
"""The agent as one file, reproducible: a zip archive of sorted names, fixed dates and no compression.

Written here rather than by ``zipfile``, whose import and bookkeeping cost each command CPU time (ADR 164).
A test holds every byte against what ``zipfile`` writes.
"""

import hashlib
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

AGENT_DIR = Path(__file__).parent.parent / "agent"
_AGENT_PACKAGE = "edgectl_agent"
_LICENCE_LINE = b"# SPDX-License-Identifier: Apache-2.0\n"
# Fields of the format that are the same for each file (APPNOTE 4.3.7, 4.3.12, 4.3.16): version 2.0, of Unix,
# no flags, stored, at midnight of the first day that the format knows.
_VERSION, _UNIX, _MIDNIGHT, _FIRST_DAY = 20, 3, 0, 1 << 5 | 1
_ATTRIBUTES = 0o100600 << 16
_LOCAL = struct.Struct("<4s5H3L2H")
_CENTRAL = struct.Struct("<4s6H3L5H2L")
_END = struct.Struct("<4s4H2LH")
# Requests to many hosts leave at once, and the first of them builds the archive.
_BUILDING = threading.Lock()


def read_program(path: str | Path) -> bytes:
    """The text of a program for hosts, without the line of its licence: 38 bytes in each of its files."""
    with open(path, "rb") as file:  # noqa: PTH123 - a hundred files per command
        return file.read().removeprefix(_LICENCE_LINE)


@cache
def build_agent_zipapp() -> bytes:
    """The agent as a zipapp."""
    parts: list[bytes] = []
    directory: list[bytes] = []
    place = 0
    for path in sorted(_list_programs("")):
        text, name = read_program(f"{AGENT_DIR}/{path}"), f"{_AGENT_PACKAGE}/{path}".encode()
        same = (_VERSION, 0, 0, _MIDNIGHT, _FIRST_DAY, zlib.crc32(text), len(text), len(text), len(name), 0)
        made_by = _UNIX << 8 | _VERSION
        directory += (_CENTRAL.pack(b"PK\1\2", made_by, *same, 0, 0, 0, _ATTRIBUTES, place), name)
        parts += (_LOCAL.pack(b"PK\3\4", *same), name, text)
        place += _LOCAL.size + len(name) + len(text)
    count, length = len(directory) // 2, sum(map(len, directory))
    return b"".join((*parts, *directory, _END.pack(b"PK\5\6", 0, 0, count, count, length, place, 0)))


def _list_programs(folder: str) -> Iterator[str]:
    """The files of Python below ``folder`` of the agent, relative to the agent."""
    with os.scandir(AGENT_DIR / folder) as entries:
        for entry in entries:
            if entry.is_dir():
                yield from _list_programs(f"{folder}{entry.name}/")
            elif entry.name.endswith(".py"):
                yield folder + entry.name


@cache
def compute_agent_hash() -> str:
    """SHA-256 of the agent: the name of its file on the hosts."""
    with _BUILDING:
        return hashlib.sha256(build_agent_zipapp()).hexdigest()
