# SPDX-License-Identifier: Apache-2.0
"""A second manager of a fleet: a state directory, task file and view of the hosts of its own."""

import os
import re
import signal
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.compiled_agent import give_key
from tests.faults.command_result import CommandResult
from tests.faults.fleet import FLEET, FaultFleet, format_yaml


@dataclass(frozen=True, kw_only=True)
class Manager:
    """One manager: its task file, its state directory and the hosts that it reaches.

    ``own_fleet``: it has an inventory of its own with the same hosts, and so another fleet. ``lacks``: hosts that are
    missing in its inventory. ``coordination``: its own way to the etcd of the fleet.
    """

    fleet: FaultFleet
    name: str
    own_fleet: bool = False
    lacks: tuple[str, ...] = ()
    coordination: str = ""

    @property
    def tasks(self) -> Path:
        return self.fleet.directory / f"tasks-{self.name}.yaml"

    def want(self, places: dict[str, str]) -> None:
        """Pin each task to a host, in the file of this manager alone."""
        tasks = {task: {**self.fleet.tasks[task], "hosts": {"pin": places[task]}} for task in places}
        self.tasks.write_text(format_yaml({"version": 1, "tasks": tasks}))

    def want_at_random(self) -> None:
        edges = [edge for edge in self.fleet.edges if edge not in self.lacks]
        self.want({task: self.fleet.random.choice(edges) for task in self.fleet.tasks})

    def hide(self, *hosts: str) -> None:
        """From now on these hosts refuse the connections of this manager."""
        text = (self.fleet.directory / "ssh_config").read_text()
        for host in hosts:
            text = re.sub(rf"(Host {host}\n  HostName )\S+\n  Port \d+", r"\g<1>127.0.0.1\n  Port 1", text)
        (self.fleet.directory / f"ssh_config-{self.name}").write_text(text)

    def start(self, *words: str, **more: str) -> "subprocess.Popen[str]":
        fleet, own = self.fleet, self.fleet.directory / f"ssh_config-{self.name}"
        files = {str(fleet.directory / "tasks.yaml"): str(self.tasks)}
        if self.own_fleet or self.lacks or self.coordination:
            files[str(fleet.directory / "inventory.yaml")] = str(self._write_inventory())
        command = [files.get(word, word) for word in fleet.build_command(*words)]
        state = fleet.directory / f"state-{self.name}"
        give_key(state, self.name if self.own_fleet else FLEET)
        env = fleet.build_env(
            EDGECTL_STATE_DIR=str(state),
            LOGNAME=self.name,
            USER=self.name,
            **({"EDGECTL_SSH_CONFIG": str(own)} if own.exists() else {}),
            **more,
        )
        return fleet.start_command(command, env)

    def _write_inventory(self) -> Path:
        fleet, path = self.fleet, self.fleet.directory / f"inventory-{self.name}.yaml"
        edges = {name: host for name, host in fleet.inventory.items() if name not in self.lacks}
        own = {"fleet": self.name} if self.own_fleet else {}
        own |= {"coordination": self.coordination} if self.coordination else {}
        path.write_text(format_yaml({**fleet.inventory_head, **own, "edges": edges}))
        return path

    def run(self, *words: str) -> CommandResult:
        return self.fleet.wait_for_edgectl(self.start(*words), words)


def signal_manager(running: "subprocess.Popen[str]", number: signal.Signals) -> None:
    """Send a signal to an edgectl and its children, if it still runs."""
    with suppress(ProcessLookupError):
        os.killpg(running.pid, number)
