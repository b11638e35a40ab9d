# SPDX-License-Identifier: Apache-2.0
"""The hosts of ``make experiment``, as good as this machine has them, are what the shipped experiment needs."""

import json
import subprocess
import sys
from pathlib import Path

from tests.experiments.lab.hosts import CORES, MEMORY, Lab, lab, spent
from tests.experiments.lab.patrol import PATROL, ROOT, radio
from tests.faults.namespace_host import NamespaceHost
from tests.pace import patience


def test_hosts_with_the_programs_on_them(tmp_path: Path) -> None:
    with lab(tmp_path) as made:
        files = ["-i", str(made.site / "fleet.yaml"), "-t", str(made.site / "tasks.yaml")]
        command = [*made.prefix, sys.executable, "-m", "edgectl", "plan", *files, "-o", "json"]
        done = subprocess.run(
            command,
            env=made.environment,
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=patience(90),
            check=False,
        )
        assert done.returncode == 0, done.stderr
        plan = json.loads(done.stdout)
        found = {name: host for name, host in plan["snapshot"]["hosts"].items() if host["status"] == "ok"}
        assert {name: host["cpu"]["capacity_cores"] for name, host in found.items()} == CORES
        assert {name: host["memory"]["capacity_bytes"] for name, host in found.items()} == MEMORY
        assert plan["summary"]["start"] == 12, "all but the merging, which waits for the robots to come back"
        check_radio(made)
        for host in made.hosts.values():
            assert (host.home / "experiment" / "tasks" / "patrol" / "robot.py").exists()
            if isinstance(host, NamespaceHost):
                assert spent(host) > 0
    assert not any(isinstance(host, NamespaceHost) and host.pid for host in made.hosts.values())


def check_radio(made: Lab) -> None:
    """A robot that comes near an edge has a fast link to it, and slow ones to the others, in both directions."""
    if "EDGECTL_PATROL_RADIO" not in made.environment:
        assert made.wanting, "what could not be shaped is said"
        return
    command = [*made.prefix, sys.executable, str(PATROL / "radio.py"), "robot2=edge3"]
    subprocess.run(command, env=made.environment, check=True, timeout=patience(30))
    classes = json.loads(Path(made.environment["EDGECTL_PATROL_RADIO"]).read_text())
    for edge, rate in (("edge3", radio.NEAR), ("edge1", radio.FAR), ("edge2", radio.FAR)):
        for device, name in classes["robot2"][edge]:
            show = [*made.prefix, "tc", "class", "show", "dev", device, "classid", name]
            shown = subprocess.run(show, env=made.environment, capture_output=True, text=True, check=True)
            shown_rate = {radio.NEAR: "rate 16Mbit ", radio.FAR: "rate 1600Kbit "}[rate]
            assert shown_rate in shown.stdout, shown.stdout
    assert {device for places in classes["robot2"].values() for device, _ in places} == {
        f"v-{name}" for name in ("robot2", "edge1", "edge2", "edge3")
    }
