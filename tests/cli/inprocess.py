# SPDX-License-Identifier: Apache-2.0
"""The edgectl command line inside the test process: it saves the start of Python for each command."""

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from edgectl.cli.main import main


class Said(NamedTuple):
    """How one command ended."""

    code: int
    out: str
    err: str


@contextlib.contextmanager
def _environment(env: Mapping[str, str]) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.clear()
    os.environ.update(env)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def edgectl(words: Sequence[str], directory: Path, env: Mapping[str, str]) -> Said:
    """Run ``edgectl WORDS`` in a directory and an environment, with output to files and empty standard input."""
    with (
        tempfile.TemporaryFile("w+") as out,
        tempfile.TemporaryFile("w+") as err,
        Path(os.devnull).open() as nothing,
    ):
        before = sys.stdin, sys.stdout, sys.stderr
        sys.stdin, sys.stdout, sys.stderr = nothing, out, err
        try:
            with contextlib.chdir(directory), _environment(env):
                code = main(words)
        finally:
            sys.stdin, sys.stdout, sys.stderr = before
        for stream in (out, err):
            stream.seek(0)
        return Said(int(code), out.read(), err.read())
