# SPDX-License-Identifier: Apache-2.0
"""Crash loop: a command that keeps failing is given up and reported."""

from edgectl.agent.supervise import lockfile
from tests.agent.conftest import AgentHost, eventually


def test_crash_loop_is_given_up_with_the_end_of_its_log(host: AgentHost) -> None:
    """Five restarts with their real pauses of 1 to 16 s, half a minute in all."""
    host.start(
        "slam", "seq 8; printf 'x%.0s' $(seq 300); echo; printf 'caf\\351\\n'; exit 1", restart="on-failure"
    )
    first = eventually(lambda: e if (e := host.entry("slam")) and e["restarts"] == 1 else None)
    assert first["last_exit"] == 1
    entry = host.until("slam", "crashloop", seconds=60)
    assert (entry["restarts"], entry["exit_code"], entry["last_exit"], entry["pid"]) == (5, 1, 1, 0)
    assert (entry["detail"], entry["given_up"]) == ("exited with 1; 5 restarts in 10 minutes", True)
    assert entry["log_tail"] == ["6", "7", "8", "x" * 200, "caf\ufffd"]
    assert not lockfile.is_lock_held(str(host.folder("slam")))
    assert host.stop("slam")["state"] == "not-running"
    assert host.entry("slam") is None, "a stop clears the failure"
