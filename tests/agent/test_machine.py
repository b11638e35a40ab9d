# SPDX-License-Identifier: Apache-2.0
"""Which machine a host is, where it has no machine id: real agents, from whose eyes /etc/machine-id is hidden."""

import os
import shutil
import sys
from pathlib import Path

import pytest

from edgectl.gateway.probe_reply import ReplyContext, decode_host_sample
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.rules.lost_places import find_shared_machine
from tests.agent.conftest import AgentHost
from tests.builders import NOW, an_edge, an_inventory

ROOT_ONLY = pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("unshare"), reason="needs root, unshare")


def probe_without_id(name: str, folder: Path, *spaces: str) -> HostSample:
    """Probe a host whose Python runs in namespaces of its own, with an empty /etc/machine-id."""
    python = folder / f"python-{name}"
    python.write_text(
        f"#!/bin/sh\nexec unshare --mount --propagation private {' '.join(spaces)} sh -c "
        f'\'mount --bind /dev/null /etc/machine-id && exec "$@"\' sh {sys.executable} "$@"\n'
    )
    python.chmod(0o755)
    agent = AgentHost(name, folder / "state", str(python))
    reply = agent.ask("probe", window_s=0.0)
    return decode_host_sample(reply, ReplyContext(host=an_edge(name), answered_at=NOW))


@ROOT_ONLY
@pytest.mark.skipif(not Path("/etc/machine-id").exists(), reason="no /etc/machine-id to hide")
def test_two_names_of_a_machine_without_an_id_are_one_machine_and_two_containers_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    container = ("--pid", "--fork", "--mount-proc")
    seen = {
        "jetson": probe_without_id("jetson", tmp_path),
        "desk": probe_without_id("desk", tmp_path, *container),
        "arm": probe_without_id("arm", tmp_path),
    }
    assert {sample.machine for sample in seen.values()} == {""}
    inventory = an_inventory(*map(an_edge, seen))
    assert find_shared_machine(inventory, Snapshot(taken_at=NOW, hosts=seen)) == ("jetson", "arm")
    del seen["arm"]
    assert find_shared_machine(inventory, Snapshot(taken_at=NOW, hosts=seen)) is None
