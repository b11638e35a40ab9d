# SPDX-License-Identifier: Apache-2.0
"""trust, over real sshd: one table, one question, and no key that has changed is replaced."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.sshd import Lab, make_key


@pytest.fixture
def fleet(lab: Lab, tmp_path: Path) -> Iterator[Path]:
    """An inventory of the lab's hosts and one that is this machine, in the working directory."""
    hosts = "".join(f"  {name}: {{host: {name}}}\n" for name in ("edge1", "edge2"))
    (tmp_path / "inventories").mkdir()
    (tmp_path / "inventories" / "lab.yaml").write_text(
        f"version: 1\nfleet: lab\nedges:\n{hosts}  here: {{connection: local}}\n"
    )
    yield tmp_path
    lab.write_files()


def trust(lab: Lab, fleet: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "edgectl", "trust", *words]
    env = {**lab.environment, "EDGECTL_STATE_DIR": str(fleet / "state")}
    return subprocess.run(
        command, cwd=fleet, env=env, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )


def test_all_hosts_are_recorded_after_one_question(lab: Lab, fleet: Path) -> None:
    lab.known_hosts.write_text("")
    asked = trust(lab, fleet, "--all")
    assert asked.returncode == 64
    assert [line.split()[0] for line in asked.stdout.splitlines()] == ["HOST", "edge1", "edge2"]
    assert "on each of edge1, edge2: ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub" in asked.stderr
    assert lab.known_hosts.read_text() == ""
    assert trust(lab, fleet, "--all", "--yes").returncode == 0
    recorded = set(lab.known_hosts.read_text().splitlines())
    assert recorded == {lab[name].known_hosts_line.strip() for name in ("edge1", "edge2")}
    again = trust(lab, fleet, "--all", "-o", "json")
    assert [item["state"] for item in json.loads(again.stdout)["items"]] == ["known", "known"]
    assert again.returncode == 0


def test_a_key_that_has_changed_is_named_and_the_others_are_recorded(lab: Lab, fleet: Path) -> None:
    server, other = lab["edge1"], make_key(fleet / "other")
    before = f"[{server.address}]:{server.port} {other}\n"
    lab.known_hosts.write_text(before)
    said = trust(lab, fleet, "--all", "--yes", "-o", "json")
    assert said.returncode == 4
    items = {item["host"]: item for item in json.loads(said.stdout)["items"]}
    assert (items["edge1"]["state"], items["edge2"]["state"]) == ("changed", "unknown")
    assert "ssh-keygen -R" in items["edge1"]["hint"]
    assert lab.known_hosts.read_text() == before + lab["edge2"].known_hosts_line
