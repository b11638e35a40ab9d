# SPDX-License-Identifier: Apache-2.0
"""Host names of an ssh_config: the aliases that its Host lines define, with the files that it includes."""

import re
import shlex
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase

MAX_DEPTH = 16
_LINE = re.compile(r"\s*([A-Za-z]+)(?:\s*=\s*|\s+)(.*?)\s*$")


def list_host_aliases(path: str, read: Callable[[str], str], expand: Callable[[str], list[str]]) -> list[str]:
    """The aliases without wildcards, in the order of the file.

    ``read`` gives the text of a file, empty if there is none; ``expand`` the files that an Include names.
    """
    return list(dict.fromkeys(_walk_file(path, read, expand, MAX_DEPTH)))


def _walk_file(
    path: str, read: Callable[[str], str], expand: Callable[[str], list[str]], depth: int
) -> Iterator[str]:
    for line in read(path).splitlines():
        found = _LINE.match(line)
        if found is None:
            continue
        keyword, words = found[1].lower(), _split_words(found[2])
        if keyword == "include" and depth > 0:
            for pattern in words:
                for inner in expand(pattern):
                    yield from _walk_file(inner, read, expand, depth - 1)
        elif keyword == "host":
            yield from (word for word in words if not set(word) & set("*?!"))


def _split_words(text: str) -> list[str]:
    try:
        return shlex.split(text, comments=True)
    except ValueError:
        return text.split()


def select_aliases(aliases: list[str], patterns: list[str]) -> list[str]:
    """The aliases that one of the patterns matches."""
    return [alias for alias in aliases if any(fnmatchcase(alias, pattern) for pattern in patterns)]
