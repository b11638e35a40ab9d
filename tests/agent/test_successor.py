# SPDX-License-Identifier: Apache-2.0
"""An instance whose successor starts elsewhere: how its supervisor takes what happens to it meanwhile."""

import os
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.agent.conftest import AgentHost, eventually
from tests.pace import patience


def leave(host: AgentHost, seconds: float, instance: str = "i1") -> dict[str, Any]:
    return host.ask("mark", task="slam", instance=instance, ready=False, leaving_s=seconds)


def kill(host: AgentHost) -> None:
    entry = host.entry("slam")
    assert entry is not None
    os.kill(entry["pid"], signal.SIGKILL)


@pytest.mark.parametrize("restart", ["always", "on-failure", "never"])
def test_its_end_is_neither_a_failure_nor_restarted(host: AgentHost, restart: str) -> None:
    host.start("slam", "exec sleep 600", restart=restart)
    assert leave(host, 60.0)["state"] == "running"
    supervisor = host.supervisor("slam")
    kill(host)
    eventually(lambda: not Path(f"/proc/{supervisor}").exists())
    assert host.entry("slam") is None, "a stopped task is no longer listed"
    assert host.stop("slam")["state"] == "not-running"


def test_a_mark_of_another_instance_or_that_has_run_out_counts_for_nothing(host: AgentHost) -> None:
    host.start("slam", "exec sleep 600", restart="always")
    assert leave(host, 60.0, instance="i0") == {}
    leave(host, 60.0)
    leave(host, 0.0)
    kill(host)
    assert eventually(lambda: host.entry("slam")["restarts"] == 1)  # type: ignore[index]


def test_it_is_not_unhealthy_until_the_mark_has_run_out(host: AgentHost, tmp_path: Path) -> None:
    asked, fine = tmp_path / "asked", tmp_path / "fine"
    fine.touch()
    alive = {
        "command": f"echo >> {asked}; test -e {fine}",
        "timeout_s": patience(5.0),
        "after_s": 0.1,
        "restart": True,
    }
    host.start("slam", "exec sleep 600", restart="always", alive=alive)
    leave(host, 600.0)
    fine.unlink()
    before = len(asked.read_text()) if asked.exists() else 0
    # The third one is begun after the second has been judged, and that has found no file.
    eventually(lambda: asked.exists() and len(asked.read_text()) >= before + 3)
    entry = host.entry("slam")
    assert entry is not None
    assert (entry["state"], entry["restarts"]) == ("running", 0)
    leave(host, 0.0)
    assert eventually(lambda: host.entry("slam")["restarts"] == 1)  # type: ignore[index]
