# SPDX-License-Identifier: Apache-2.0
"""The framed call: noise never changes a value, and every failure has an error of its own."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

import pytest

from edgectl.errors import DeadlineError, NoPythonError, RefusedError, ReplyError
from edgectl.transport.agent_client import build_agent_command, call_agent, stream_agent_log
from edgectl.transport.base import Exchange, Reply
from edgectl.transport.local import LocalSession
from tests.pace import patience

REQUEST = {"op": "status", "fleet": "lab", "host": "edge1", "task": None}


class ScriptedSession:
    """Session whose reply is computed from the marker by ``answer``."""

    python = "python3"

    def __init__(self, answer: Callable[[str], Reply | bytes]) -> None:
        self._answer = answer

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        for _ in range(2):  # programs
            length, _, rest = stdin.partition(b"\n")
            stdin = rest[int(length) :]
        marker = stdin.split(b" ", 1)[0].decode()
        answer = self._answer(marker)
        return answer if isinstance(answer, Reply) else Reply(stdout=answer, stderr=b"", status=0)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        yield from [bytes([each]) for each in self.run(command, stdin, timeout=1.0).stdout]

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> Exchange:
        raise NotImplementedError

    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None: ...


def frame_reply(
    marker: str, payload: bytes, *, length: int | None = None, digest: str | None = None
) -> bytes:
    digest = digest or hashlib.sha256(payload).hexdigest()
    return (
        f"\nedgectl-frame {marker} {len(payload) if length is None else length} {digest}\n".encode()
        + payload
        + b"\n"
    )


GOOD = b'{"v": 1}'
OTHER = "0" * 32


def call_scripted(answer: Callable[[str], Reply | bytes]) -> dict[str, object]:
    return call_agent(ScriptedSession(answer), REQUEST, timeout=patience(30))


@pytest.mark.parametrize(
    "noise",
    [
        b"",
        b"Welcome to Ubuntu 18.04\nLast login: yesterday\n",
        b"\x1b]0;title\x07\x1b[31mred\x1b[0m \xff\xfe\x00 not utf-8",
        b'{"v": 2}\n',
        frame_reply(OTHER, b'{"v": 3}'),
        b"\nedgectl-frame ",
        b"\nedgectl-frame " + b"f" * 5000,
        b"x" * 900_000,
    ],
)
def test_noise_around_the_frame_changes_nothing(noise: bytes) -> None:
    assert call_scripted(lambda marker: noise + frame_reply(marker, GOOD) + noise) == {"v": 1}


def test_the_same_frame_twice_is_one_answer() -> None:
    assert call_scripted(lambda marker: frame_reply(marker, GOOD) * 2) == {"v": 1}


@pytest.mark.parametrize(
    "broken",
    [
        lambda marker: b"",
        lambda marker: b"Welcome\n",
        lambda marker: frame_reply(marker, GOOD)[:-4],
        lambda marker: frame_reply(marker, GOOD, length=7),
        lambda marker: frame_reply(marker, GOOD, length=10**9),
        lambda marker: frame_reply(marker, GOOD, digest="0" * 64),
        lambda marker: frame_reply(marker, GOOD).replace(b'"v"', b'"w"'),
        lambda marker: frame_reply(marker, GOOD) + frame_reply(marker, b'{"v": 2}'),
        lambda marker: frame_reply(marker[:-1] + "x", GOOD),
        lambda marker: frame_reply(marker, b"[1]"),
        lambda marker: frame_reply(marker, b""),
        lambda marker: frame_reply(marker, b'{"v": NaN}'),
        lambda marker: frame_reply(marker, b'{"v": -Infinity}'),
        lambda marker: frame_reply(marker, b'{"v": 1e999}'),
        lambda marker: frame_reply(marker, b'{"v": 1, "v": 2}'),
        lambda marker: frame_reply(marker, b'{"v": "\xff"}'),
        lambda marker: frame_reply(marker, b'{"v": ' + b"9" * 5000 + b"}"),
        lambda marker: frame_reply(marker, b"[" * 100_000),
        lambda marker: frame_reply(marker, b'{"error": "no"}'),
        lambda marker: frame_reply(marker, b'{"missing": true}'),
    ],
)
def test_anything_else_is_a_bad_reply(broken: Callable[[str], bytes]) -> None:
    with pytest.raises(ReplyError) as caught:
        call_scripted(broken)
    assert "\n" not in caught.value.message
    assert len(caught.value.message) < 300


def test_excerpt_of_noise_is_harmless() -> None:
    with pytest.raises(ReplyError) as caught:
        call_scripted(lambda marker: b"\x1b[2J evil\xe2\x80\xae \x07 " + b"y" * 1000)
    assert caught.value.message.isprintable()


def test_error_document_is_a_refusal_with_its_hint() -> None:
    document = {"error": {"kind": "stale-generation", "message": "too \x1b old", "hint": "plan again"}}
    with pytest.raises(RefusedError) as caught:
        call_scripted(lambda marker: frame_reply(marker, json.dumps(document).encode()))
    assert (caught.value.message, caught.value.hint) == ("too \\x1b old", "plan again")


@pytest.mark.parametrize(
    ("stderr", "status"),
    [
        (b"sh: 1: exec: python3: not found", 127),
        (b"bash: line 1: exec: python3: not found", 127),
        (b"fish: Unknown command: python3", 127),
        (b"python3: Command not found.", 1),
        (b"sh: 1: exec: python3: Permission denied", 126),
        (b"Unknown option: -I\nusage: python3 [option]", 2),
    ],
)
def test_missing_python_has_its_own_error(stderr: bytes, status: int) -> None:
    with pytest.raises(NoPythonError):
        call_scripted(lambda marker: Reply(stdout=b"Welcome\n", stderr=stderr, status=status))


def test_old_python_says_its_version() -> None:
    with pytest.raises(NoPythonError, match=r"3\.5\.2, 3\.6 or later"):
        call_scripted(lambda marker: frame_reply(marker, b'{"python": "3.5.2", "too_old": true}'))


def test_stream_takes_chunks_apart_whatever_their_borders() -> None:
    def answer(marker: str) -> bytes:
        return (
            b"motd\n"
            + frame_reply(marker, b'{"stream": true}')
            + b"3\na\nb0\n2\n\xff\n"
            + b"end\n"
            + b"logout\n"
        )

    assert list(
        stream_agent_log(ScriptedSession(answer), {**REQUEST, "op": "follow"}, idle_timeout=patience(20))
    ) == [
        b"a\nb",
        b"\xff\n",
    ]


def test_garbled_stream_is_a_bad_reply() -> None:
    with pytest.raises(ReplyError):
        list(
            stream_agent_log(
                ScriptedSession(lambda marker: frame_reply(marker, b'{"stream": true}') + b"what\n"),
                {**REQUEST, "op": "follow"},
                idle_timeout=patience(20),
            )
        )


def test_command_line_is_constant_and_survives_every_shell(tmp_path: Path) -> None:
    line = build_agent_command("python3")
    assert re.fullmatch(r"exec python3 -I -S -c '[^'\\!\n]+'", line)
    for shell in filter(
        None, map(shutil.which, ("sh", "bash", "dash", "zsh", "fish", "tcsh", "ksh", "busybox"))
    ):
        argv = [shell, "sh", "-c"] if shell.endswith("busybox") else [shell, "-c"]
        done = subprocess.run(
            [*argv, build_agent_command(sys.executable)],
            input=b"10\nprint('x')",
            capture_output=True,
            check=False,
            timeout=patience(20),
        )
        assert done.stdout == b"x\n", shell


def test_page_about_hosts_shows_the_command_line() -> None:
    page = Path(__file__).parents[2] / "docs" / "concepts" / "host.md"
    assert f"    {build_agent_command('python3')}\n" in page.read_text()


@pytest.fixture
def wrapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """Run a real session whose interpreter is a shell script, as on a noisy or minimal host."""
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))

    def session(script: str) -> LocalSession:
        path = tmp_path / "python3"
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o700)
        made = LocalSession("edge1")
        made.python = str(path)
        return made

    return session


def test_noisy_login_on_a_real_agent(wrapped: Callable[[str], Any]) -> None:
    session = wrapped(
        f"""echo Welcome; printf '\\377\\nedgectl-frame x 1 2\\n'; echo warning >&2; {sys.executable} "$@"; echo bye; exit 3"""
    )
    assert call_agent(session, REQUEST, timeout=patience(20))["op"] == "status"


def test_background_noise_cannot_get_into_the_frame(wrapped: Callable[[str], Any]) -> None:
    noise = "(for i in 1 2 3 4 5 6 7 8; do echo noise; sleep 0.02; done) & "
    session = wrapped(f'{noise} {sys.executable} "$@"; wait')
    for _ in range(3):
        assert call_agent(session, REQUEST, timeout=patience(20))["op"] == "status"


def test_a_host_that_gave_up_at_the_deadline_met_the_deadline() -> None:
    """The host's deadline starts a little later than ours, but a busy manager may notice later still."""

    def gave_up(_marker: str) -> Reply:
        time.sleep(0.1)
        return Reply(stdout=b"", stderr=b"", status=124)

    with pytest.raises(DeadlineError, match=r"no answer within 0\.1 s"):
        call_agent(ScriptedSession(gave_up), REQUEST, timeout=0.1)


def test_real_missing_python(wrapped: Callable[[str], Any]) -> None:
    with pytest.raises(NoPythonError):
        call_agent(wrapped("exec no-such-python"), REQUEST, timeout=patience(20))


def test_hung_agent_ends_on_both_sides(wrapped: Callable[[str], Any]) -> None:
    session = wrapped(f'exec {sys.executable} "$@"')
    call_agent(session, REQUEST, timeout=patience(20))
    began, mark = time.monotonic(), f"4321.{os.getpid()}"
    request = {
        "op": "check",
        "fleet": "lab",
        "host": "edge1",
        "command": f"sleep {mark}",
        "prelude": "",
        "env": {},
        "timeout_s": 60,
    }
    with pytest.raises(DeadlineError):
        call_agent(session, request, timeout=1.0)
    assert time.monotonic() - began < patience(20)
    while any(
        mark.encode() in (path / "cmdline").read_bytes()
        for path in Path("/proc").glob("[0-9]*")
        if _is_readable(path)
    ):
        assert time.monotonic() - began < patience(30), "the check runs on"
        time.sleep(0.1)


def _is_readable(path: Path) -> bool:
    try:
        (path / "cmdline").read_bytes()
    except OSError:
        return False
    return True
