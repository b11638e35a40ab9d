# SPDX-License-Identifier: Apache-2.0
"""Whatever is killed during an activation or a deactivation, and when: a record that says ``standby`` is true.

Each kill is made at another moment after ``go``: before the record, between record and effect, between effect and
record, after the reply. What the process was last made is compared with what its record says, and with what the
supervisor makes of it.
"""

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from edgectl.agent.measure import proc, system_files
from edgectl.agent.supervise import liveness, lockfile, records
from edgectl.errors import HostError, RefusedError
from edgectl.transport.held_call import HeldCall
from edgectl.transport.local import LocalExchange
from tests.agent.conftest import AgentHost, eventually
from tests.agent.switching import ACTIVATE, DEACTIVATE, Ticker, a_check

# Seconds after go. The command of the test takes 10 ms, and so does each side of it on a slow machine.
MOMENTS = [0.0, 0.002, 0.004, 0.006, 0.008, 0.011, 0.015, 0.025, 0.05, 0.25]
SLOWLY = "sleep 0.005; {}; sleep 0.005"


def find_agent(held: HeldCall) -> int:
    """The process of the agent: the shell of a local session becomes it."""
    exchange = held._exchange
    assert isinstance(exchange, LocalExchange)
    return exchange._process.pid


def read_role(host: AgentHost) -> str:
    return str(records.read_record(str(host.folder("slam") / "role"))["role"])


def is_settled(host: AgentHost) -> bool:
    """Whether no command is under way."""
    return not lockfile.is_lock_held(str(host.folder("slam")), "switch")


def assert_safe(ticker: Ticker) -> None:
    """A standby was made active by nobody since it was made inactive."""
    eventually(lambda: is_settled(ticker.host))
    if read_role(ticker.host) == "standby":
        # The signal may still be on its way to the process.
        eventually(lambda: ticker.changes()[-1:] != ["active"])


@pytest.fixture
def slow(host: AgentHost, tmp_path: Path) -> Ticker:
    """A standby whose commands take some milliseconds before and after their effect."""
    up, down = (a_check(SLOWLY.format(each)) for each in (ACTIVATE, DEACTIVATE))
    ticker = Ticker(host, tmp_path, activate=up, deactivate=down)
    ticker.start(restart="always")
    host.until("slam", "ready")
    return ticker


def await_change(ticker: Ticker, wanted: str) -> None:
    eventually(lambda: ticker.changes()[-1:] in ([wanted], []))


def kill_during(ticker: Ticker, op: str, moment_s: float, find: Callable[[HeldCall], list[int]]) -> None:
    with ticker.hold(op) as held:
        pids = find(held)
        held.go()
        time.sleep(moment_s)
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        try:
            held.wait()
        except HostError:
            return


@pytest.mark.parametrize("command", ["command lives", "command too"])
@pytest.mark.parametrize("op", ["activate", "deactivate"])
def test_an_agent_that_is_killed_at_any_moment(slow: Ticker, op: str, command: str) -> None:
    """The supervisor goes on where the record says active; a repeated request finds everything as it asks."""
    outcomes = set()

    def find(held: HeldCall) -> list[int]:
        return [find_agent(held), *(list_shells(slow.host) if command == "command too" else [])]

    for moment_s in MOMENTS[:: 1 if command == "command too" else 3]:
        slow.switch("deactivate" if op == "activate" else "activate")
        kill_during(slow, op, moment_s, find)
        outcomes.add(slow.role())
        assert_safe(slow)
        wanted = eventually(lambda: r[0] if not (r := slow.role())[1] and is_settled(slow.host) else None)
        await_change(slow, wanted)
        assert slow.switch(op)["role"] == {"activate": "active", "deactivate": "standby"}[op]
        await_change(slow, {"activate": "active", "deactivate": "standby"}[op])
    assert len(outcomes) >= 2, "the moments cover the change"
    slow.host.stop("slam")


@pytest.mark.parametrize("op", ["activate", "deactivate"])
@pytest.mark.parametrize("victims", ["supervisor", "both", "main"])
def test_a_supervisor_or_process_that_is_killed_at_any_moment(slow: Ticker, op: str, victims: str) -> None:
    """What is left of the task is stopped, and its next instance is inactive."""
    host = slow.host
    for number, moment_s in enumerate(MOMENTS[1::4]):
        if op == "deactivate":
            slow.switch("activate")
        entry = host.entry("slam")
        assert entry is not None
        above, main = host.supervisor("slam"), int(entry["pid"])

        def find(held: HeldCall, above: int = above, main: int = main) -> list[int]:
            agent = find_agent(held)
            return {"supervisor": [above], "both": [above, agent], "main": [main]}[victims]

        kill_during(slow, op, moment_s, find)
        if victims != "main":
            assert_safe(slow)
        eventually(lambda: is_settled(host))
        host.stop("slam")
        assert [pid for pid in host.members("slam") if pid] == []
        (slow.folder / "changes").unlink(missing_ok=True)
        slow.start(instance=f"i{number + 1}", restart="always")
        host.until("slam", "ready")
        assert (slow.role(), slow.changes()) == (("standby", False), [])
    host.stop("slam")


def test_a_command_whose_agent_was_killed_is_waited_for(host: AgentHost, tmp_path: Path) -> None:
    """It may still make the instance active, so nothing else is proven before its end."""
    late = a_check(f"while ! test -e {tmp_path}/gate; do sleep 0.02; done; {ACTIVATE}", 60.0)
    ticker = Ticker(host, tmp_path, activate=late)
    ticker.start()
    host.until("slam", "ready")
    with ticker.hold("activate") as held:
        held.go()
        eventually(lambda: ticker.role() == ("active", True))
        os.kill(find_agent(held), signal.SIGKILL)
    with pytest.raises(RefusedError, match="another activation is under way"):
        ticker.switch("deactivate")
    assert (ticker.role(), ticker.changes()) == (("active", True), [])
    (tmp_path / "gate").touch()
    eventually(lambda: ticker.role() == ("active", False))
    assert ticker.switch("deactivate")["state"] == "standby"
    eventually(lambda: ticker.changes()[-1] == "standby")
    host.stop("slam")


def test_a_prepared_agent_that_is_killed_has_done_nothing(slow: Ticker) -> None:
    with slow.hold("activate") as held:
        assert len(list_shells(slow.host)) == 1
        os.kill(find_agent(held), signal.SIGKILL)
        held.go()
        with pytest.raises(HostError):
            held.wait()
    assert (slow.role(), slow.changes()) == (("standby", False), [])
    eventually(lambda: not list_shells(slow.host))
    slow.host.stop("slam")


def list_shells(host: AgentHost) -> list[int]:
    """The shells of prepared commands of this host, which have no mark of its task."""
    home = str(host.home).encode()
    environments = {pid: system_files.read_file(f"/proc/{pid}/environ") for pid in proc.read_process_table()}
    return [pid for pid, text in environments.items() if b"EDGECTL_PID=" in text and home in text]


def test_power(slow: Ticker) -> None:
    """All processes end at once; nothing is left that the record could be wrong about."""
    slow.switch("activate")
    host = slow.host
    entry = host.entry("slam")
    assert entry is not None
    for pid in (host.supervisor("slam"), int(entry["pid"])):
        os.kill(pid, signal.SIGKILL)
    dead = host.until("slam", "failed")
    assert dead["pid"] == 0
    for op in ("activate", "deactivate"):
        with pytest.raises(RefusedError, match="is not running here"):
            slow.switch(op)


@pytest.mark.parametrize("role", ["standby", "active"])
def test_a_takeover_leaves_the_role_as_it_is(host: AgentHost, tmp_path: Path, role: str) -> None:
    ticker = Ticker(host, tmp_path)
    ticker.start(role, restart="always")
    settled = {"standby": "ready", "active": "running"}[role]
    pid = int(host.until("slam", settled)["pid"])
    before = ticker.changes()
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    eventually(lambda: (e := host.entry("slam")) and e.get("orphaned"))
    if role == "standby":
        with pytest.raises(RefusedError, match="has lost its supervisor"):
            ticker.switch("activate")
    taken = host.ask(
        "takeover",
        task="slam",
        instance="i1",
        generation=2,
        role="active",
        spec=ticker.spec(restart="always"),
    )
    assert taken["state"] == "taken-over"
    entry = host.until("slam", settled)
    assert (entry["role"], entry["pid"], ticker.changes()) == (role, pid, before)
    assert ticker.switch("activate", generation=2)["state"] == "active"
    assert ticker.switch("deactivate", generation=2)["state"] == "standby"
    eventually(lambda: ticker.changes() == ["active", "standby"])
    assert not liveness.read_instance(str(host.folder("slam"))).status.get("left")
    host.stop("slam")
