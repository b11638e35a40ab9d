# SPDX-License-Identifier: Apache-2.0
"""A plain task for the tests of standby copies: it ticks into a file while it is active."""

import sys
from pathlib import Path
from typing import Any

from edgectl.executor.host_requests import SWITCH_MARGIN_S
from edgectl.transport.held_call import HeldCall, hold_agent_call
from tests.agent.conftest import AgentHost, a_spec
from tests.pace import patience

# USR1 makes it active, USR2 inactive; each is acknowledged in a file, so that a command can wait for it.
TICKER = """
import os, signal, sys, time
folder = sys.argv[1]
active = False
def switch(wanted):
    global active
    active = wanted
    with open(folder + "/changes", "a") as file:
        file.write("%d %s\\n" % (os.getpid(), "active" if wanted else "standby"))
signal.signal(signal.SIGUSR1, lambda *_: switch(True))
signal.signal(signal.SIGUSR2, lambda *_: switch(False))
open(folder + "/up", "w").close()
while True:
    if active:
        with open(folder + "/ticks", "a") as file:
            file.write("%d\\n" % os.getpid())
    time.sleep(0.02)
"""
ACTIVATE, DEACTIVATE = "kill -USR1 $EDGECTL_PID", "kill -USR2 $EDGECTL_PID"


def a_check(command: str, timeout_s: float = 20.0) -> dict[str, Any]:
    return {"command": command, "graph": None, "timeout_s": timeout_s}


class Ticker:
    """The task ``slam`` on one host. ``rule``: keys of its activation in place of the usual ones."""

    def __init__(self, host: AgentHost, folder: Path, **rule: Any) -> None:
        self.host, self.folder, self.instance = host, folder, "i1"
        (folder / "ticker.py").write_text(TICKER)
        self.command = f"exec {sys.executable} -S {folder}/ticker.py {folder}"
        ready = a_check(f"test -e {folder}/up", patience(5.0))
        self.rule = {
            "activate": a_check(ACTIVATE), "deactivate": a_check(DEACTIVATE),
            "lifecycle": None, "ready": ready, "up_s": 0.0, **rule,
        }  # fmt: skip

    def spec(self, **spec: Any) -> dict[str, Any]:
        return a_spec(self.command, **{"runtime": "process", "activation": self.rule, **spec})

    def start(self, role: str = "standby", *, instance: str = "i1", **spec: Any) -> dict[str, Any]:
        (self.folder / "up").unlink(missing_ok=True)
        self.instance = instance
        return self.host.ask(
            "start", task="slam", instance=instance, generation=1, role=role, spec=self.spec(**spec)
        )

    def request(self, op: str, **fields: Any) -> dict[str, Any]:
        wanted = {
            "task": "slam",
            "instance": self.instance,
            "generation": 1,
            "manager": "ana",
            "await_go_s": 0.0,
        }
        return {**wanted, "spec": self.spec(), **fields}

    def switch(self, op: str, **fields: Any) -> dict[str, Any]:
        return self.host.ask(op, **self.request(op, **fields))

    def hold(self, op: str, *, await_go_s: float = 60.0, **fields: Any) -> HeldCall:
        request = self.request(op, await_go_s=await_go_s, **fields)
        document = {"op": op, "fleet": self.host.fleet, "host": self.host.name, **request}
        return hold_agent_call(self.host.session, document, timeout=patience(SWITCH_MARGIN_S))

    def changes(self) -> list[str]:
        """What it was made, in order."""
        path = self.folder / "changes"
        return [line.split()[1] for line in path.read_text().splitlines()] if path.exists() else []

    def role(self) -> tuple[str, bool]:
        entry = self.host.entry("slam")
        return (entry["role"], entry["switching"]) if entry else ("", False)
