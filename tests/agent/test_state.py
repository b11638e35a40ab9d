# SPDX-License-Identifier: Apache-2.0
"""State of a task on its way to another host: saved, read, written and loaded by real agents."""

import hashlib
import os
import signal
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link import protocol
from edgectl.errors import HostError, RefusedError
from edgectl.transport.agent_client import call_agent, stream_agent_chunks
from tests.agent.conftest import ANSWERS_S, AgentHost, a_spec, eventually, is_running
from tests.pace import patience

# A task that appends to a file what comes in, and prints what it has.
SERVE = "exec sleep 600"
BIG = 3 * protocol.STATE_PIECE_BYTES + 12345


def save(host: AgentHost, command: str, **fields: Any) -> dict[str, Any]:
    request = {
        "task": "slam", "instance": "i1", "generation": 1, "command": command, "topic": None, "prelude": "",
        "ros": None, "env": {}, "workdir": None, "timeout_s": 20.0, "max_bytes": 100_000_000,
    }  # fmt: skip
    return host.ask("save-state", **{**request, **fields})


def load(host: AgentHost, command: str, saved: dict[str, Any], **fields: Any) -> dict[str, Any]:
    request = {
        "task": "slam", "instance": "i1", "generation": 1, "command": command, "topic": None, "prelude": "",
        "ros": None, "env": {}, "workdir": None, "timeout_s": 20.0, "size": saved["size"],
        "sha256": saved["sha256"], "repeat": False,
    }  # fmt: skip
    return host.ask("load-state", **{**request, **fields})


def read(host: AgentHost, offset: int = 0) -> list[bytes]:
    request = {"op": "read-state", "fleet": host.fleet, "host": host.name, "task": "slam", "offset": offset}
    return list(stream_agent_chunks(host.session, request, idle_timeout=ANSWERS_S))


def write(host: AgentHost, data: bytes = b"", **fields: Any) -> dict[str, Any]:
    request = {
        "op": "write-state", "fleet": host.fleet, "host": host.name, "task": "slam", "generation": 1,
        "total": 0, "offset": 0, "size": len(data), "packed": False, "bytes": len(data),
    }  # fmt: skip
    return call_agent(host.session, {**request, **fields}, timeout=ANSWERS_S, data=data)


def spool(host: AgentHost) -> Path:
    return host.folder("slam") / "state"


def test_state_arrives_as_it_was_saved(host: AgentHost, tmp_path: Path) -> None:
    """Half of it can be compressed; the pieces are written in any order, one of them twice."""
    source, got = tmp_path / "source", tmp_path / "got"
    source.write_bytes(bytes(BIG // 2) + os.urandom(BIG - BIG // 2))
    host.start("slam", SERVE)
    saved = save(host, f"echo noise >&2; cat {source}")
    assert (saved["size"], saved["sha256"]) == (BIG, hashlib.sha256(source.read_bytes()).hexdigest())
    assert spool(host).stat().st_mode & 0o777 == 0o600
    chunks = read(host)
    assert {chunk[:1] for chunk in chunks} == {b"r", b"z"}
    assert b"".join(zlib.decompress(c[1:]) if c[:1] == b"z" else c[1:] for c in chunks) == source.read_bytes()
    assert read(host, protocol.STATE_PIECE_BYTES) == chunks[1:]
    write(host, total=BIG)
    for number in (3, 0, 2, 1, 0):
        offset = number * protocol.STATE_PIECE_BYTES
        size = min(protocol.STATE_PIECE_BYTES, BIG - offset)
        chunk = chunks[number]
        write(host, chunk[1:], offset=offset, size=size, packed=chunk[:1] == b"z")
    reply = load(host, f'cat > {got}; echo "$EDGECTL_INSTANCE $EDGECTL_PID" > {got}.who', saved)
    assert (reply["state"], reply["tries"]) == ("loaded", 1)
    assert got.read_bytes() == source.read_bytes()
    entry = host.entry("slam")
    assert entry is not None
    assert Path(f"{got}.who").read_text() == f"i1 {entry['pid']}\n"
    assert host.ask("drop-state", task="slam", generation=1) == {"state": "dropped"}
    assert not spool(host).exists()
    assert host.ask("drop-state", task="slam", generation=1) == {"state": "none"}


@pytest.mark.parametrize(
    ("command", "fields", "message"),
    [
        ("echo kept; echo no map yet >&2; exit 3", {}, "save of slam failed: exit code 3: no map yet"),
        ("exec sleep 600", {"timeout_s": 0.3}, "save of slam failed: no end within 0.3 s"),
        ("true", {}, "save of slam printed nothing"),
        ("exec cat /dev/zero", {"max_bytes": 1000}, "the state of slam is larger than 1000 bytes"),
        ("exec yes >&2", {"timeout_s": 2.0}, "save of slam failed: no end within 2 s: y"),
        ("echo 1", {"instance": "i2"}, "instance i2 of slam does not run here"),
        ("echo 1", {"task": "other"}, "instance i1 of other does not run here"),
        ("echo 1", {"generation": 0}, "generation 0 of slam is older than 1"),
    ],
)
def test_save_that_fails_leaves_nothing(
    host: AgentHost, command: str, fields: dict[str, Any], message: str
) -> None:
    host.start("slam", SERVE)
    pid = host.until("slam", "running")["pid"]
    with pytest.raises(RefusedError, match=f"^{message}"):
        save(host, command, **fields)
    assert not spool(host).exists()
    assert is_running(pid)


def test_what_a_save_starts_ends_with_it(host: AgentHost, tmp_path: Path) -> None:
    host.start("slam", SERVE)
    saved = save(host, f"sleep 600 & echo $! | tee {tmp_path}/pid")
    assert saved["size"] == len((tmp_path / "pid").read_bytes())
    eventually(lambda: not is_running(int((tmp_path / "pid").read_text())))


def test_damaged_and_truncated_states_are_never_loaded(host: AgentHost, tmp_path: Path) -> None:
    host.start("slam", SERVE)
    saved = save(host, "echo one two three")
    command = f"touch {tmp_path}/loaded"
    spool(host).write_bytes(b"one two thrEe\n")
    with pytest.raises(RefusedError, match="did not arrive as it was saved"):
        load(host, command, saved)
    os.truncate(spool(host), 5)
    with pytest.raises(RefusedError, match="did not arrive as it was saved"):
        load(host, command, saved)
    host.ask("drop-state", task="slam", generation=1)
    with pytest.raises(RefusedError, match="no state of slam is kept here"):
        load(host, command, saved)
    assert not (tmp_path / "loaded").exists()


@pytest.mark.parametrize(
    ("data", "fields"),
    [
        (b"abc", {"offset": 8}),
        (b"abc", {"offset": -1}),
        (b"abc", {"size": 4}),
        (b"abc", {"packed": True}),
        (zlib.compress(bytes(5000)), {"size": 3, "packed": True}),
        (zlib.compress(bytes(2)), {"size": 3, "packed": True}),
        (b"", {"size": 3}),
        (b"ab", {"size": 3, "bytes": 3}),
        (b"a", {"size": protocol.STATE_PIECE_BYTES + 1}),
    ],
)
def test_pieces_that_do_not_fit_are_refused(host: AgentHost, data: bytes, fields: dict[str, Any]) -> None:
    write(host, total=10)
    with pytest.raises(RefusedError, match="a piece of the state"):
        write(host, data, **fields)
    assert spool(host).read_bytes() == bytes(10)


def test_piece_without_room_for_it_is_refused(host: AgentHost) -> None:
    with pytest.raises(RefusedError, match="no state of slam"):
        write(host, b"abc")


def test_load_is_repeated_until_the_instance_takes_it(host: AgentHost, tmp_path: Path) -> None:
    host.start("slam", SERVE)
    saved = save(host, "echo map")
    command = f"cat >> {tmp_path}/got; test $(wc -l < {tmp_path}/got) -ge 3"
    with pytest.raises(RefusedError, match="load of slam failed: exit code 1"):
        load(host, command, saved)
    assert load(host, command, saved, repeat=True)["tries"] == 2
    assert (tmp_path / "got").read_text() == "map\n" * 3
    with pytest.raises(RefusedError, match="load of slam failed: exit code 7: busy"):
        load(host, "echo busy >&2; exit 7", saved, repeat=True, timeout_s=patience(1.0))
    with pytest.raises(RefusedError, match=r"load of slam failed: no end within 0\.3 s"):
        load(host, "exec sleep 600", saved, repeat=True, timeout_s=0.3)


def test_load_ends_with_the_instance(host: AgentHost) -> None:
    host.start("slam", SERVE)
    saved = save(host, "echo map")
    pid = host.until("slam", "running")["pid"]
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(RefusedError, match="instance i1 of slam does not run here"):
        load(host, "exit 1", saved, repeat=True)


def test_start_and_stop_remove_what_was_left(host: AgentHost) -> None:
    write(host, total=10)
    host.start("slam", SERVE)
    assert not spool(host).exists()
    save(host, "echo map")
    host.stop("slam")
    assert not spool(host).exists()


def test_start_and_stop_of_the_move_keep_it(host: AgentHost) -> None:
    write(host, total=10)
    host.ask(
        "start",
        task="slam",
        instance="i1",
        generation=1,
        keep_state=True,
        spec=a_spec(SERVE, runtime="process"),
    )
    assert spool(host).exists()
    host.stop("slam", keep_state=True)
    assert spool(host).exists()


def test_request_ends_at_its_deadline_with_the_command(host: AgentHost, tmp_path: Path) -> None:
    host.start("slam", SERVE)
    host.until("slam", "running")
    request = f"echo $$ > {tmp_path}/pid; exec sleep 600"
    with pytest.raises(HostError, match="no answer within"):
        host.ask(
            "save-state", timeout=patience(2.0), task="slam", instance=None, generation=1, command=request, topic=None,
            prelude="", ros=None, env={}, workdir=None, timeout_s=60.0, max_bytes=1000,
        )  # fmt: skip
    eventually(lambda: not is_running(int((tmp_path / "pid").read_text())))


def test_memory_of_the_agent_does_not_grow_with_the_state(host: AgentHost, tmp_path: Path) -> None:
    """100 MB are saved and read: the largest agent is measured by what its interpreter reports at its end."""
    report, python = tmp_path / "peaks", tmp_path / "python3"
    python.write_text(
        "#!/bin/sh\n"
        f'{sys.executable} -c "import resource,subprocess,sys\n'
        "code = subprocess.call(sys.argv[1:])\n"
        f"open('{report}', 'a').write('%d\\n' % resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
        f'sys.exit(code)" {sys.executable} "$@"\n'
    )
    python.chmod(0o700)
    host.start("slam", SERVE)
    host.session.python = str(python)
    save(host, "head -c 1000 /dev/zero")
    small = max(int(line) for line in report.read_text().split())
    save(host, "head -c 100000000 /dev/urandom")
    request = {"op": "read-state", "fleet": host.fleet, "host": host.name, "task": "slam", "offset": 0}
    size = sum(len(chunk) - 1 for chunk in stream_agent_chunks(host.session, request, idle_timeout=ANSWERS_S))
    assert size == 100_000_000
    assert max(int(line) for line in report.read_text().split()) < small + 16_000, "KiB"
