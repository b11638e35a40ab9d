# SPDX-License-Identifier: Apache-2.0
"""The watcher of a robot: the longest silence between successes of a command, against the switch's own record."""

import time
from pathlib import Path
from typing import Any

import pytest

from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost, eventually
from tests.pace import patience


def ask(host: AgentHost, action: str, **fields: Any) -> dict[str, Any]:
    body: dict[str, Any] = {
        "task": "cmd",
        "watch": "w1",
        "topic": "",
        "command": "",
        "prelude": "",
        "ros": None,
        "env": {},
    }
    return host.ask("hear", **{**body, "action": action, "after_s": 0.0, "timeout_s": 10.0, **fields})


def test_the_silence_of_a_command_is_from_its_last_success_to_its_first(
    host: AgentHost, tmp_path: Path
) -> None:
    flag = tmp_path / "alive"
    flag.touch()
    begun = ask(host, "begin", command=f"test -e {flag}")
    assert (begun["heard"], begun["detail"]) == (True, "")
    gone = time.monotonic()
    flag.unlink()
    stopped = time.monotonic()
    time.sleep(0.3)
    back = time.monotonic()
    flag.touch()
    found = ask(host, "end", command=f"test -e {flag}", after_s=time.monotonic() - stopped)
    assert found["heard"]
    assert back - gone <= found["silence_s"] + 0.001
    with pytest.raises(RefusedError, match="gone"):
        ask(host, "end")


def test_what_is_never_heard_again_is_no_gap(host: AgentHost, tmp_path: Path) -> None:
    flag = tmp_path / "alive"
    flag.touch()
    assert ask(host, "begin", command=f"test -e {flag} || {{ echo no pulse; false; }}")["heard"]
    flag.unlink()
    found = ask(host, "end", after_s=0.0, timeout_s=patience(0.5))
    assert (found["heard"], found["detail"]) == (False, "the command failed: no pulse")


def test_a_success_from_before_the_old_instance_ended_is_not_the_new_one(host: AgentHost) -> None:
    assert ask(host, "begin", command="true")["heard"]
    count = ask(host, "begin", command="true")["count"]
    assert eventually(lambda: ask(host, "begin", command="true")["count"] > count)
    found = ask(host, "end", after_s=0.0)
    assert found["heard"]
    assert found["count"] > count
    assert found["silence_s"] < 10.0


def test_a_command_that_never_succeeded_was_not_heard_before_the_move(host: AgentHost) -> None:
    begun = ask(host, "begin", command="echo deaf; false", timeout_s=patience(0.3))
    assert (begun["heard"], begun["detail"]) == (False, "the command failed: deaf")
    ask(host, "end", timeout_s=0.0)
