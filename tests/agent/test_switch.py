# SPDX-License-Identifier: Apache-2.0
"""Standby copies on one real host: start, activate, deactivate, held requests, and what is refused."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.supervise import records
from edgectl.agent.supervise.switch_lock import end_switch, open_switch_lock, take_switch_lock
from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost, eventually, is_running
from tests.agent.switching import ACTIVATE, Ticker, a_check
from tests.agent.test_lease import claim, signature
from tests.pace import patience


@pytest.fixture
def ticker(host: AgentHost, tmp_path: Path) -> Iterator[Ticker]:
    """A standby that can be activated."""
    found = Ticker(host, tmp_path)
    assert found.start()["role"] == "standby"
    entry = host.until("slam", "ready")
    assert (entry["role"], entry["switching"], found.changes()) == ("standby", False, [])
    yield found
    host.stop("slam")


def test_a_standby_becomes_active_and_inactive_again(ticker: Ticker) -> None:
    host = ticker.host
    reply = ticker.switch("activate", generation=2)
    assert (reply["state"], reply["role"], reply["switching"]) == ("active", "active", False)
    assert host.until("slam", "running")["role"] == "active"
    again = ticker.switch("activate", generation=3)
    assert (again["state"], again["seconds"]) == ("active", 0.0)
    entry = host.entry("slam")
    assert entry is not None
    assert entry["generation"] == 3
    assert ticker.switch("deactivate", generation=4)["state"] == "standby"
    assert ticker.switch("deactivate", generation=4)["state"] == "standby"
    eventually(lambda: ticker.changes() == ["active", "standby"])
    assert host.until("slam", "ready")["role"] == "standby"


def test_the_process_that_was_active_last_is_told(ticker: Ticker) -> None:
    """By the generation that made it inactive; the next process has no memory of that."""
    host = ticker.host

    def told() -> int:
        return int((host.entry("slam") or {})["deactivated"])

    assert told() == 0
    ticker.switch("deactivate", generation=2)
    assert told() == 0
    ticker.switch("activate", generation=3)
    assert told() == 0
    ticker.switch("deactivate", generation=4)
    assert told() == 4
    ticker.switch("deactivate", generation=5)
    assert told() == 4
    os.kill(int(host.until("slam", "ready")["pid"]), signal.SIGKILL)
    eventually(lambda: told() == 0)


def test_an_active_instance_is_activated_by_its_supervisor_at_each_start(
    host: AgentHost, tmp_path: Path
) -> None:
    ticker = Ticker(host, tmp_path)
    assert ticker.start("active", restart="always", ready=a_check(f"test -e {tmp_path}/ticks"))["role"] == (
        "active"
    )
    first = host.until("slam", "ready")
    assert ticker.changes() == ["active"]
    assert ticker.start("standby")["role"] == "active"
    (tmp_path / "ticks").unlink()
    os.kill(first["pid"], signal.SIGKILL)
    second = eventually(lambda: e if (e := host.until("slam", "ready"))["restarts"] == 1 else None)
    assert (second["role"], ticker.changes()) == ("active", ["active", "active"])
    host.stop("slam")


def test_a_standby_that_crashes_is_inactive_again(host: AgentHost, tmp_path: Path) -> None:
    ticker = Ticker(host, tmp_path)
    ticker.start(restart="always")
    ticker.host.until("slam", "ready")
    ticker.switch("activate")
    ticker.switch("deactivate")
    pid = int(host.until("slam", "ready")["pid"])
    (tmp_path / "up").unlink()
    os.kill(pid, signal.SIGKILL)
    eventually(lambda: (e := host.until("slam", "ready"))["restarts"] == 1 and e["pid"] != pid)
    assert (ticker.role(), ticker.changes()) == (("standby", False), ["active", "standby"])
    host.stop("slam")


def test_readiness_of_a_standby_does_not_count_for_the_active_instance(ticker: Ticker) -> None:
    host, ready = ticker.host, a_check(f"test -e {ticker.folder}/serving")
    host.stop("slam")
    ticker.start(ready=ready)
    host.until("slam", "ready")
    ticker.switch("activate")
    waited = host.ask("wait", task="slam", instance="i1", timeout_s=0.0)
    assert (waited["settled"], waited["state"]) == (False, "starting")
    (ticker.folder / "serving").touch()
    assert host.until("slam", "ready")["role"] == "active"


def test_nothing_happens_before_go(ticker: Ticker) -> None:
    with ticker.hold("activate") as held:
        assert (ticker.role(), ticker.changes()) == (("standby", False), [])
        held.go()
        held.go()
        assert held.wait()["state"] == "active"
    assert ticker.changes() == ["active"]
    # The instance is as asked, so there is nothing to wait for.
    with ticker.hold("activate") as held:
        held.go()
        assert held.wait()["state"] == "active"


@pytest.mark.parametrize("word", [b"", b"no\n", b"gone\n", b"x" * 100_000])
def test_without_the_word_nothing_was_done(ticker: Ticker, word: bytes) -> None:
    with ticker.hold("activate") as held:
        held._exchange.finish(word, timeout=patience(20.0))
        assert held.wait()["state"] == "not-asked"
    assert (ticker.role(), ticker.changes()) == (("standby", False), [])


def test_go_that_does_not_come_in_time(ticker: Ticker) -> None:
    with ticker.hold("activate", await_go_s=0.2) as held:
        held._read_until(None)
        assert held.wait()["state"] == "not-asked"
    assert ticker.changes() == []


@pytest.mark.parametrize("op", ["activate", "deactivate"])
def test_requests_that_name_something_else(ticker: Ticker, op: str) -> None:
    with pytest.raises(RefusedError, match="instance i1 of slam runs here, not i2"):
        ticker.switch(op, instance="i2")
    with pytest.raises(RefusedError, match="other is not running here"):
        ticker.switch(op, task="other")
    ticker.switch("activate", generation=5)
    with pytest.raises(RefusedError, match="generation 4 of slam is older than 5"):
        ticker.switch(op, generation=4)
    spec = ticker.spec(activation=None)
    with pytest.raises(RefusedError, match="started without standby"):
        ticker.switch(op, generation=5, spec=spec)
    assert ticker.changes() == ["active"]


def test_a_task_without_activation_has_no_role(host: AgentHost, tmp_path: Path) -> None:
    host.start("slam", "exec sleep 600")
    entry = host.until("slam", "running")
    assert (entry["role"], entry["switching"]) == ("", False)
    with pytest.raises(RefusedError, match="started without standby"):
        Ticker(host, tmp_path).switch("activate")
    host.stop("slam")


def test_an_instance_that_cannot_be_activated_yet(host: AgentHost, tmp_path: Path) -> None:
    ticker = Ticker(host, tmp_path, ready=a_check("false"))
    ticker.start()
    with pytest.raises(RefusedError, match="cannot be activated yet"):
        ticker.switch("activate")
    # It has never been told to be active, so there is nothing to undo.
    assert ticker.switch("deactivate")["state"] == "standby"
    host.stop("slam")


def test_an_instance_that_changes_between_check_and_go(ticker: Ticker) -> None:
    ticker.host.stop("slam")
    ticker.start(restart="always")
    pid = int(ticker.host.until("slam", "ready")["pid"])
    with ticker.hold("activate") as held:
        (ticker.folder / "up").unlink()
        os.kill(pid, signal.SIGKILL)
        eventually(lambda: (e := ticker.host.until("slam", "ready"))["restarts"] == 1 and e["pid"] != pid)
        held.go()
        with pytest.raises(RefusedError, match="restarted meanwhile"):
            held.wait()
    with ticker.hold("activate") as held:
        ticker.host.stop("slam")
        ticker.start(instance="i2")
        held.go()
        with pytest.raises(RefusedError, match="instance i2 of slam runs here, not i1"):
            held.wait()
    assert ticker.changes() == []


def test_a_generation_that_is_overtaken_between_check_and_go(ticker: Ticker) -> None:
    with ticker.hold("activate", generation=2) as held:
        assert ticker.switch("deactivate", generation=3)["state"] == "standby"
        held.go()
        with pytest.raises(RefusedError, match="generation 2 of slam is older than 3"):
            held.wait()
    assert (ticker.role(), ticker.changes()) == (("standby", False), [])


def test_a_lease_that_is_lost_between_check_and_go(ticker: Ticker) -> None:
    claim(ticker.host)
    with ticker.hold("activate", lease=signature(1)) as held:
        ticker.host.ask("lease", action="release", lease=signature(1), end_watch=False)
        assert claim(ticker.host, "ben", "s2")["epoch"] == 2
        held.go()
        with pytest.raises(RefusedError, match="ben@lab has taken the fleet"):
            held.wait()
    with pytest.raises(RefusedError, match="ben@lab holds the fleet"):
        ticker.switch("activate")
    assert (ticker.role(), ticker.changes()) == (("standby", False), [])
    ticker.host.stop("slam", lease=signature(2, "ben", "s2"))
    ticker.host.ask("lease", action="release", lease=signature(2, "ben", "s2"), end_watch=False)


def with_rule(ticker: Ticker, **rule: Any) -> Ticker:
    ticker.rule = {**ticker.rule, **rule}
    return ticker


@pytest.mark.parametrize("command", ["exit 3", f"{ACTIVATE}; exit 3", f"{ACTIVATE}; sleep 600"])
def test_an_activation_that_fails_or_hangs_is_undone(ticker: Ticker, command: str) -> None:
    with with_rule(ticker, activate=a_check(command, 1.0)).hold("activate") as held:
        held.go()
        reply = held.wait()
    assert (reply["state"], reply["role"], reply["switching"]) == ("activate-failed", "standby", False)
    assert str(reply["detail"]).startswith(
        ("activate: it ended with 3", "activate: it did not end within 1 s")
    )
    eventually(lambda: ticker.changes()[-1:] == ["standby"])
    assert ticker.role() == ("standby", False)


def test_an_activation_that_can_neither_be_done_nor_undone_counts_as_active(ticker: Ticker) -> None:
    broken = with_rule(ticker, activate=a_check("exit 3"), deactivate=a_check("exit 4"))
    reply = broken.switch("activate")
    assert (reply["state"], reply["role"], reply["switching"]) == ("activate-failed", "active", True)
    assert reply["detail"] == "activate: it ended with 3; deactivate: it ended with 4"


def test_a_failed_deactivation_leaves_the_instance_active(ticker: Ticker) -> None:
    ticker.switch("activate")
    reply = with_rule(ticker, deactivate=a_check("echo busy; exit 3")).switch("deactivate")
    assert (reply["state"], reply["role"], reply["switching"]) == ("deactivate-failed", "active", False)
    assert (reply["active_again"], reply["detail"]) == (True, "deactivate: it ended with 3: busy")
    eventually(lambda: ticker.changes() == ["active", "active"])
    reply = with_rule(ticker, activate=a_check("exit 5")).switch("deactivate")
    assert (reply["active_again"], reply["role"], reply["switching"]) == (False, "active", True)
    # Its supervisor, whose own commands work, proves it to be active again.
    eventually(lambda: ticker.role() == ("active", False))


def test_a_command_that_prints_much_or_nothing_readable(ticker: Ticker) -> None:
    loud = a_check(f"head -c 3000000 /dev/urandom; {ACTIVATE}; yes | head -c 3000000; exit 7")
    reply = with_rule(ticker, activate=loud).switch("activate")
    assert (reply["state"], len(reply["detail"]) <= 300) == ("activate-failed", True)


def test_a_prelude_that_fails_is_seen_before_anything_is_done(ticker: Ticker) -> None:
    ticker.switch("activate")
    with pytest.raises(RefusedError, match="the command cannot be prepared: its shell has ended: no ROS"):
        ticker.switch("deactivate", spec=ticker.spec(prelude="echo no ROS; exit 1"))
    assert (ticker.role(), ticker.changes()) == (("active", False), ["active"])


def test_commands_have_the_environment_of_the_task(ticker: Ticker) -> None:
    told = a_check(f'echo "$EDGECTL_INSTANCE $COLOUR $(pwd)" >{ticker.folder}/told; {ACTIVATE}')
    spec = with_rule(ticker, activate=told).spec(env={"COLOUR": "red"}, workdir="/usr")
    ticker.switch("activate", spec=spec)
    assert (ticker.folder / "told").read_text() == "i1 red /usr\n"


def test_the_process_is_that_of_the_command_and_not_its_shell(host: AgentHost, tmp_path: Path) -> None:
    ticker = Ticker(host, tmp_path)
    ticker.command = ticker.command.replace("exec ", "") + "; true"
    ticker.start()
    host.until("slam", "ready")
    assert ticker.switch("activate")["state"] == "active"
    eventually(lambda: ticker.changes() == ["active"])
    host.stop("slam")


def test_a_process_that_dies_of_its_activation(host: AgentHost, tmp_path: Path) -> None:
    ticker = Ticker(host, tmp_path, activate=a_check("kill -KILL $EDGECTL_PID; sleep 0.3"))
    ticker.start(restart="never")
    host.until("slam", "ready")
    reply = ticker.switch("activate")
    assert (reply["state"], reply["role"]) == ("activate-failed", "active")
    host.until("slam", "failed")


def test_a_supervisor_that_cannot_activate_restarts_by_policy(host: AgentHost, tmp_path: Path) -> None:
    ticker = Ticker(host, tmp_path, activate=a_check("exit 9"))
    ticker.start("active", restart="never")
    entry = host.until("slam", "failed")
    assert (entry["detail"], entry["given_up"]) == ("activate: its check ended with 9", True)
    ticker.start("active", instance="i2", restart="always")
    eventually(lambda: (e := host.entry("slam")) and e["restarts"] >= 1)
    assert "edgectl: activate: its check ended with 9; restarting" in str(
        host.ask("logs", task="slam", tail=99)["text"]
    )
    host.stop("slam")


def test_a_standby_is_not_fenced_until_it_is_active(host: AgentHost, tmp_path: Path) -> None:
    ticker = Ticker(host, tmp_path)
    ticker.start(self_fence_s=1.0)
    pid = int(host.until("slam", "ready")["pid"])
    status = str(host.folder("slam") / "status")
    # Beyond the fence and the next look at it.
    time.sleep(3.0)
    assert (is_running(pid), records.read_record(status)["state"]) == (True, "ready")
    assert ticker.switch("activate")["state"] == "active"
    fenced = eventually(
        lambda: s if "fenced" in (s := records.read_record(status)).get("detail", "") else None
    )
    assert (fenced["state"], is_running(pid)) == ("failed", False)


def test_a_stop_ends_an_activation_that_hangs(ticker: Ticker) -> None:
    late = a_check(f"sleep 600; {ACTIVATE}", 300.0)
    with with_rule(ticker, activate=late).hold("activate") as held:
        held.go()
        eventually(lambda: ticker.role() == ("active", True))
        assert ticker.host.stop("slam")["state"] == "stopped"
    assert (ticker.host.entry("slam"), ticker.changes()) == (None, [])


def test_what_waits_for_another_part_of_an_activation_ends_before_it(tmp_path: Path) -> None:
    """In any order that a set of numbers may have: many pairs, one after the other."""
    for number in range(24):
        folder = tmp_path / str(number)
        folder.mkdir()
        lock = open_switch_lock(str(folder))
        assert take_switch_lock(lock, 1.0)
        command = "sleep 600 & echo $!; wait; : >went_on"
        with subprocess.Popen(
            ["sh", "-c", command], cwd=folder, pass_fds=[lock], stdout=subprocess.PIPE, text=True
        ) as waiting:
            os.close(lock)
            assert waiting.stdout is not None
            child = int(waiting.stdout.readline())
            end_switch(str(folder))
        assert not is_running(child)
        assert not (folder / "went_on").exists()
