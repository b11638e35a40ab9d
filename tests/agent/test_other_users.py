# SPDX-License-Identifier: Apache-2.0
"""Other users of a host: what they do is neither believed nor hit, and does not stop anything."""

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.agent.link import boot
from edgectl.transport import agent_client
from edgectl.transport.agent_archive import build_agent_zipapp
from tests.agent.conftest import AgentHost, eventually, is_running
from tests.pace import patience

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user")
EVE = 1002
_AS_EVE = [sys.executable, "-I", "-S", "-c", f"import os; os.setgid({EVE}); os.setuid({EVE}); os.execv('/bin/sleep', ['sleep', '600'])"]  # fmt: skip


@pytest.fixture
def eve(host: AgentHost) -> Iterator["subprocess.Popen[bytes]"]:
    """A process of another user that claims to be of task slam."""
    cookie = {"EDGECTL_TASK_DIR": str(host.folder("slam"))}
    with subprocess.Popen(_AS_EVE, env={**os.environ, **cookie}) as process:
        eventually(lambda: b"sleep" in Path(f"/proc/{process.pid}/cmdline").read_bytes())
        yield process
        process.kill()


def test_a_cookie_of_another_user_is_not_a_task(host: AgentHost, eve: "subprocess.Popen[bytes]") -> None:
    """Neither with nor without the supervisor: the stop is proven, and the stranger lives."""
    host.start("slam", "exec sleep 600")
    assert eve.pid not in host.members("slam")
    assert host.stop("slam")["state"] == "stopped"
    host.start("slam", "exec sleep 600", instance="i2", generation=2)
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    expected = {"state": "stopped", "left": [], "seconds": 0, "graph": {}}
    assert host.stop("slam") | {"seconds": 0} == expected
    assert host.entry("slam") is None
    assert is_running(eve.pid)


@pytest.mark.parametrize("orphaned", [False, True])
def test_a_task_that_changes_its_user_is_stopped(host: AgentHost, orphaned: bool) -> None:
    """Descent proves it, or the lock that it inherited."""
    pid = host.start("slam", "exec " + shlex.join(_AS_EVE))["pid"]
    eventually(lambda: Path(f"/proc/{pid}").stat().st_uid == EVE)
    if orphaned:
        os.kill(host.supervisor("slam"), signal.SIGKILL)
        eventually(lambda: (entry := host.entry("slam")) and "orphaned" in entry["detail"])
    assert host.stop("slam")["state"] == "stopped"
    assert not is_running(pid)


def ask_with_bases(host: AgentHost, bases: list[str], op: str, **fields: object) -> bytes:
    """A request to the agent, whose second base is not in the shared memory of this machine."""
    program = (
        f"import sys; sys.path.insert(0, {str(Path(boot.__file__).parent)!r})\n"
        "import boot\nwords = sys.stdin.buffer.readline().split()\n"
        f"boot.boot_agent(sys.stdin.buffer, words, {[base.encode() for base in bases]!r}, b'')\n"
    )
    request = {"op": op, "fleet": host.fleet, "host": host.name, **fields}
    packet = agent_client.build_packet(request, "m" * 32, 30.0, build_agent_zipapp())
    packet = packet.removeprefix(agent_client._read_boot_programs())
    words = [sys.executable, "-I", "-c", program]
    return subprocess.run(words, input=packet, capture_output=True, check=True, timeout=patience(60)).stdout


def test_a_base_that_another_user_made_is_skipped(host: AgentHost, tmp_path: Path) -> None:
    """Before edgectl ever needed it, in shared memory, with tasks of guessed names: all goes on without it."""
    base = tmp_path / "shm"
    for task in ("slam", "anything"):
        (base / "agent-state" / host.fleet / "hosts" / host.name / "tasks" / task).mkdir(parents=True)
    (base / "hosts" / host.name / "tasks" / "slam").mkdir(parents=True)
    subprocess.run(["chown", "-R", str(EVE), str(base)], check=True)
    host.start("slam", "exec sleep 600")
    bases = [str(host.state), str(base)]
    assert b'"state": "running"' in ask_with_bases(host, bases, "status", task=None)
    assert b'"slam": {' in ask_with_bases(host, bases, "probe", window_s=0.05)
    assert b'"state": "stopped"' in ask_with_bases(
        host, bases, "stop", task="slam", instance=None, generation=None, stop=None
    )
