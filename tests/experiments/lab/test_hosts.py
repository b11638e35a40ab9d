# SPDX-License-Identifier: Apache-2.0
"""The hosts of ``make experiment``, as good as this machine has them, are what the shipped experiment needs."""

import json
import subprocess
import sys
from pathlib import Path

from tests.experiments.lab.hosts import CORES, lab, spent
from tests.experiments.lab.mission import ROOT
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
        cores = {
            name: host["cpu"]["capacity_cores"]
            for name, host in plan["snapshot"]["hosts"].items()
            if host["status"] == "ok"
        }
        assert cores == CORES
        assert plan["summary"]["start"] == 9
        for host in made.hosts.values():
            assert (host.home / "experiment" / "tasks" / "mission" / "robot.py").exists()
            if isinstance(host, NamespaceHost):
                assert spent(host) > 0
    assert not any(isinstance(host, NamespaceHost) and host.pid for host in made.hosts.values())
