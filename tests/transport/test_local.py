# SPDX-License-Identifier: Apache-2.0
"""Commands on this machine: deadlines, bounded output, no leftovers."""

import os
import time
from pathlib import Path

import pytest

from edgectl.errors import DeadlineError, ReplyError
from edgectl.model.inventory import Host, Role
from edgectl.transport.local import LocalSession, LocalTransport
from tests.pace import patience

HOST = Host(name="edge1", role=Role.EDGE, host="127.0.1.11")


def test_runs_a_command_with_the_manager_s_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGECTL_STATE_DIR", "/somewhere")
    with LocalTransport().connect(HOST, timeout=1.0) as session:
        reply = session.run(
            'cat; echo "$EDGECTL_STATE_DIR"; echo oops >&2; exit 7', b"in\0put\n", timeout=patience(20)
        )
    assert (reply.stdout, reply.stderr, reply.status) == (b"in\0put\n/somewhere\n", b"oops\n", 7)
    assert LocalTransport().address(HOST) == "127.0.1.11"


def test_deadline_ends_the_whole_group(tmp_path: Path) -> None:
    with pytest.raises(DeadlineError, match=r"no answer within 5 s"):
        LocalSession("edge1").run(f"sleep 600 & echo $! > {tmp_path}/pid; sleep 600", b"", timeout=5)
    state = Path(f"/proc/{(tmp_path / 'pid').read_text().strip()}/stat")
    deadline = time.monotonic() + patience(30)
    while state.exists() and ") Z" not in state.read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_large_input_and_output_pass_at_once() -> None:
    data = os.urandom(900_000)
    assert LocalSession("edge1").run("cat", data, timeout=patience(10)).stdout == data


def test_command_that_does_not_read_is_no_error() -> None:
    assert LocalSession("edge1").run("exec true", bytes(1 << 20), timeout=patience(20)).status == 0


def test_too_much_output_is_refused() -> None:
    with pytest.raises(ReplyError, match="more than 1000 bytes"):
        LocalSession("edge1").run("yes", b"", timeout=patience(20), limit=1000)


def test_stream_yields_as_it_comes_and_ends_with_the_command() -> None:
    assert (
        b"".join(
            LocalSession("edge1").stream("cat; sleep 0.1; echo more", b"first\n", idle_timeout=patience(20))
        )
        == b"first\nmore\n"
    )


def test_silent_stream_meets_its_deadline() -> None:
    with pytest.raises(DeadlineError, match=r"no output for 0.2 s"):
        list(LocalSession("edge1").stream("sleep 600", b"", idle_timeout=0.2))


def test_closed_stream_ends_its_command(tmp_path: Path) -> None:
    running = LocalSession("edge1").stream(
        f"echo $$ > {tmp_path}/pid; echo up; exec sleep 600", b"", idle_timeout=patience(20)
    )
    assert next(running) == b"up\n"
    running.close()  # type: ignore[attr-defined]
    assert not Path(f"/proc/{(tmp_path / 'pid').read_text().strip()}").exists()


def test_nothing_is_left_open() -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        LocalSession("edge1").run("true", b"", timeout=patience(20))
    assert len(list(Path("/proc/self/fd").iterdir())) == before
