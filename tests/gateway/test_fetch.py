# SPDX-License-Identifier: Apache-2.0
"""Fetching a file in pieces: from the real agent, and from hosts with invalid replies."""

import base64
import os
import random
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from edgectl.errors import ConnectError, DeadlineError, HostError, RefusedError, ReplyError
from edgectl.gateway.fetch import MAX_FILE_BYTES, fetch_file
from edgectl.transport.fake import FakeTransport
from edgectl.transport.local import LocalTransport
from tests.builders import a_task, an_edge

HOST = an_edge("edge1")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory of the task, on a host that is this machine."""
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    (tmp_path / "work").mkdir()
    return tmp_path / "work"


def fetch_from_agent(file: str, folder: Path | None) -> bytes:
    return fetch_file(LocalTransport(), HOST, a_task(workdir=folder and str(folder)), file, timeout=60.0)


@pytest.mark.parametrize("size", [0, 1, 640 << 10, (640 << 10) + 1, 3_000_000])
def test_a_file_comes_as_it_is(folder: Path, size: int) -> None:
    (folder / "out").mkdir()
    data = random.Random(size).randbytes(size)
    (folder / "out" / "map é.pgm").write_bytes(data)
    assert fetch_from_agent("out/map é.pgm", folder) == data


def test_a_path_begins_at_the_workdir_the_home_or_the_root(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(folder))
    (folder / "map").write_bytes(b"free")
    found = {
        fetch_from_agent("map", folder),
        fetch_from_agent("map", None),
        fetch_from_agent("~/map", Path("/")),
        fetch_from_agent(str(folder / "map"), Path("/")),
    }
    assert found == {b"free"}


def make_link(path: Path) -> None:
    path.with_name("secret").write_bytes(b"x")
    path.symlink_to("secret")


def make_large_file(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "no such file"),
        (Path.mkdir, "is not a regular file"),
        (os.mkfifo, "is not a regular file"),
        (make_link, "is a symbolic link"),
        (make_large_file, "has 33554433 bytes, the limit is 33554432"),
    ],
)
def test_what_cannot_be_had_is_refused_with_the_path(
    folder: Path, make: Callable[[Path], object], words: str
) -> None:
    make(folder / "map")
    with pytest.raises(RefusedError, match=words) as caught:
        fetch_from_agent("map", folder)
    assert str(folder / "map") in caught.value.message
    assert caught.value.hint


def test_no_path_is_refused(folder: Path) -> None:
    with pytest.raises(RefusedError, match="not a path"):
        fetch_from_agent("a\0b", folder)


def a_piece(content: bytes, **fields: object) -> dict[str, object]:
    return {"size": 6, "mark": "1", "data": base64.b64encode(content).decode(), **fields}


def fetch_from_replies(*replies: Mapping[str, object] | HostError) -> bytes:
    waiting = list(replies)

    def answer(_request: object) -> dict[str, object]:
        reply = waiting.pop(0)
        if isinstance(reply, HostError):
            raise reply
        return dict(reply)

    return fetch_file(FakeTransport({"edge1": answer}), HOST, a_task(), "map", timeout=60.0)


def test_pieces_are_put_together() -> None:
    assert fetch_from_replies(a_piece(b"abc"), a_piece(b"de"), a_piece(b"f")) == b"abcdef"


@pytest.mark.parametrize(
    ("replies", "error"),
    [
        ([a_piece(b"abc"), a_piece(b"def", mark="2")], RefusedError),
        ([a_piece(b"abc"), a_piece(b"")], ReplyError),
        ([a_piece(b"abc"), a_piece(b"defg")], ReplyError),
        ([a_piece(b"abcdef", size=5)], ReplyError),
        ([a_piece(b"a", size=MAX_FILE_BYTES + 1)], ReplyError),
        ([a_piece(b"a", size=-1)], ReplyError),
        ([a_piece(b"a", size="6")], ReplyError),
        ([a_piece(b"a", data="YQ=")], ReplyError),
        ([a_piece(b"a", data=None)], ReplyError),
        ([a_piece(b"a", data="é")], ReplyError),
        ([{}], ReplyError),
        ([ConnectError("switched off")], ConnectError),
        ([a_piece(b"abc"), DeadlineError("no answer")], DeadlineError),
    ],
)
def test_a_host_that_talks_nonsense_gives_nothing(
    replies: list[Mapping[str, object] | HostError], error: type[HostError]
) -> None:
    with pytest.raises(error):
        fetch_from_replies(*replies)


def test_a_deadline_holds_for_all_pieces_together() -> None:
    endless = FakeTransport({"edge1": lambda _request: a_piece(b"a", size=MAX_FILE_BYTES)})
    with pytest.raises(DeadlineError, match=r"map did not arrive within 0\.2 s"):
        fetch_file(endless, HOST, a_task(), "map", timeout=0.2)
