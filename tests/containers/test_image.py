# SPDX-License-Identifier: Apache-2.0
"""The image of .ci/Containerfile: built by make image on a base of Debian's packages, and used as its first lines show.

``make containers`` runs it: it takes some minutes, and the indexes of packages of Debian and Python.
"""

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl import __version__
from edgectl.scaffold.write import write_scaffold
from tests.containers.docker_engine import PROGRAMS, DockerEngine, docker_engine, find_missing_for_containers
from tests.pace import patience
from tests.sshd import Lab, running_lab
from tests.views.fixtures import ROOT, SNAPSHOT

# Of the user in the image.
UID = 1000
HOSTS = ("uxa", "mid", "ace")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[DockerEngine, str]]:
    """An engine with the image ``edgectl``, and what the build has printed."""
    assert not (lacking := find_missing_for_containers()), lacking
    folder = tmp_path_factory.mktemp("image")
    with docker_engine(folder / "engine", builds=True) as engine:
        env = {**os.environ, **engine.environment, "DOCKER_BUILDKIT": "0"}
        found = re.search(
            r"^ARG PYTHON=docker\.io/library/(\S+)$", (ROOT / ".ci/Containerfile").read_text(), re.M
        )
        assert found is not None
        with (folder / "base.tar").open("wb") as base:
            subprocess.run(
                [ROOT / ".ci/base-image"], env=env, stdout=base, check=True, timeout=patience(600.0)
            )
        docker = [str(PROGRAMS / "docker")]
        subprocess.run(
            [*docker, "import", folder / "base.tar", found[1]], env=env, check=True, timeout=patience(300.0)
        )
        (folder / "base.tar").unlink()
        # The engine has no bridge: a build has the network of this machine.
        builder = folder / "builder"
        builder.write_text('#!/bin/sh\nverb=$1\nshift\nexec docker "$verb" --network=host "$@"\n')
        builder.chmod(0o755)
        done = subprocess.run(
            ["make", "image", f"BUILDER={builder}"],
            cwd=ROOT,
            env=env,
            capture_output=True,
            text=True,
            check=False,
            timeout=patience(900.0),
        )
        assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
        yield engine, done.stdout


def test_the_context_is_what_is_copied_and_no_environment(built: tuple[DockerEngine, str]) -> None:
    found = re.search(r"Sending build context to Docker daemon\s+([\d.]+)([kM]?B)\s*$", built[1], re.M)
    assert found is not None, built[1][:400]
    assert float(found[1]) * {"B": 1e-6, "kB": 1e-3, "MB": 1.0}[found[2]] < 20.0


def test_it_is_this_version_runs_as_a_user_and_brings_ssh(built: tuple[DockerEngine, str]) -> None:
    engine, _ = built
    said = engine.call("run", "--rm", "--network=none", "edgectl", "version")
    assert re.match(rf"edgectl +{re.escape(__version__)}\b", said.replace("\n", " ").strip()), said
    assert engine.call("run", "--rm", "--network=none", "--entrypoint=id", "edgectl", "-u") == str(UID)
    assert (
        engine.call("run", "--rm", "--network=none", "--entrypoint=sh", "edgectl", "-c", "command -v ssh")
        == "/usr/bin/ssh"
    )


def test_a_fleet_that_is_mounted_is_validated_and_planned(
    built: tuple[DockerEngine, str], tmp_path: Path
) -> None:
    engine, _ = built
    fleet = tmp_path / "fleet"
    write_scaffold(fleet)
    shutil.copy(SNAPSHOT, fleet / "snap.json")
    mounted = ("run", "--rm", "--network=none", "--volume", f"{fleet}:/fleet:ro", "edgectl")
    assert engine.call(*mounted, "validate") == "ok: 3 edges, 3 robots, 10 tasks"
    planned = json.loads(
        engine.call(*mounted, "plan", "--snapshot", "snap.json", "--allow-unreachable", "-o", "json")
    )
    assert planned["decisions"]


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with running_lab(tmp_path / "lab", HOSTS) as found:
        yield found


def test_hosts_are_reached_with_the_keys_that_are_mounted(
    built: tuple[DockerEngine, str], lab: Lab, tmp_path: Path
) -> None:
    """As the first lines of the file show: the fleet, the keys, and a volume for the state."""
    engine, _ = built
    fleet, keys = tmp_path / "fleet", tmp_path / "keys"
    for folder in (fleet / "inventories", fleet / "tasks", keys):
        folder.mkdir(parents=True)
    inner = "/home/edgectl/.ssh"
    config = (
        lab.ssh_config.read_text()
        .replace(str(lab.user_key), f"{inner}/id")
        .replace(str(lab.known_hosts), f"{inner}/known_hosts")
    )
    (keys / "config").write_text(config)
    shutil.copy(lab.user_key, keys / "id")
    shutil.copy(lab.known_hosts, keys)
    for path in (keys, *keys.iterdir()):
        os.chown(path, UID, UID)
    (keys / "id").chmod(0o600)
    edges = "".join(f"  {name}: {{host: {name}, capacity: {{cpu: 2, memory: 1Gi}}}}\n" for name in HOSTS)
    (fleet / "inventories/lab.yaml").write_text(f"version: 1\nfleet: image-{os.getpid()}\nedges:\n{edges}")
    task = "{command: exec sleep 600, demand: {cpu: 0.1, memory: 1Mi}, up: 100ms}"
    (fleet / "tasks/lab.yaml").write_text(f"version: 1\ntasks:\n  zeta: {task}\n")
    run = (
        "run", "--rm", "--network=host", "--volume", f"{fleet}:/fleet:ro", "--volume", f"{keys}:{inner}:ro",
        "--volume", "edgectl-state:/state", "edgectl",
    )  # fmt: skip
    probed = json.loads(engine.call(*run, "get", "hosts", "-o", "json"))
    assert {item["host"]: item["status"] for item in probed["items"]} == dict.fromkeys(HOSTS, "ok")
    assert json.loads(engine.call(*run, "apply", "--yes", "-o", "json"))["item"]["done"]
    assert engine.call(*run, "get", "tasks", "--field", "state") in ("running", "ready")
    # The state is in the volume: a second container knows the first apply.
    assert engine.call(*run, "history", "-o", "name") == "revision/1"
    assert json.loads(engine.call(*run, "stop", "--all", "--yes", "-o", "json"))["item"]["done"]
