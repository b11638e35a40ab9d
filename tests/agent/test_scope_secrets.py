# SPDX-License-Identifier: Apache-2.0
"""Secrets in ``runtime: systemd``: a canary in a task's environment appears in no unit, no output of systemd and no command line."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from edgectl.agent.measure import system_files
from tests.agent.conftest import AgentHost
from tests.agent.user_systemd import UserSystemd
from tests.e2e.test_secrets import CANARIES, find_forms

LIMITS = {"cpu": 0.5, "memory": 64_000_000}
SAID = (
    ("show", "edgectl-*"),
    ("status", "edgectl-*"),
    ("cat", "edgectl-*"),
    ("show-environment",),
    ("list-units", "--all"),
)


def places(host: AgentHost, systemd: UserSystemd) -> Iterator[tuple[str, bytes]]:
    """Everything readable without being the task."""
    for folder in Path("/proc").glob("[0-9]*"):
        yield f"{folder}/cmdline", system_files.read_file(f"{folder}/cmdline")
    for path in (
        *host.state.rglob("*"),
        *systemd.folder.rglob("*"),
        *(systemd.run.rglob("*") if systemd.real else ()),
    ):
        with suppress(OSError):
            if path.is_file() and not path.is_symlink():
                yield str(path), path.read_bytes()
    for words in SAID if systemd.real else ():
        yield " ".join(words), systemd.systemctl(*words).encode()


def test_a_secret_stands_in_no_unit(host: AgentHost, systemd: UserSystemd) -> None:
    host.runtime, host.session.python = "systemd", str(systemd.python)
    if systemd.real:
        systemd.systemctl("log-level", "debug")
    host.start("slam", "exec sleep 600", env={"TOKEN": CANARIES["task"]}, limits=LIMITS)
    entry = host.until("slam", "running")
    environment = b"\0" + system_files.read_file(f"/proc/{entry['pid']}/environ")
    assert f"\0TOKEN={CANARIES['task']}\0".encode() in environment, "the task itself has it"
    while_running = dict(places(host, systemd))
    assert host.stop("slam")["state"] == "stopped"
    afterwards = dict(places(host, systemd))
    everything = [*while_running.items(), *afterwards.items()]
    assert {where: hit for where, data in everything if (hit := find_forms(data))} == {}
    if systemd.real:
        systemd.systemctl("log-level", "info")
        unit = b"edgectl-edge1-slam-"
        assert unit in while_running["show edgectl-*"], "the right places were looked at"
        assert any("/transient/" in where and unit.decode() in where for where in while_running)
        assert unit in afterwards[str(systemd.folder / "journal")]
