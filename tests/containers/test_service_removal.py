# SPDX-License-Identifier: Apache-2.0
"""Proof that a service is gone, against a program ``docker`` that answers as the managers of a swarm do."""

from pathlib import Path

import pytest

from edgectl.agent.containers import record, swarm
from edgectl.agent.measure import system_files

# Services and the tasks of this node are lists in files; without a leader only what a manager remembers is shown.
DOCKER = """#!/bin/sh
cd {folder}
echo "$*" >> calls
case "$*" in
    "service ls "*) cat services;;
    info*) cat info;;
    *) if [ -e no-leader ]; then
        echo "Error response from daemon: rpc error: code = Unknown desc = The swarm does not have a leader." >&2
        exit 1
    fi;;
esac
case "$*" in
    "service create "*) echo barrier12345 | tee -a services;;
    "service rm "*) : > services;;
    "node ps "*) cat tasks;;
esac
"""


@pytest.fixture
def docker(tmp_path: Path) -> Path:
    folder = tmp_path / "docker"
    folder.mkdir()
    (folder / "docker").write_text(DOCKER.format(folder=folder))
    (folder / "docker").chmod(0o755)
    (folder / "info").write_text('{"NodeID": "n0de", "LocalNodeState": "active"}')
    for name in ("services", "tasks", "calls"):
        (folder / name).touch()
    return folder


def write_record(folder: Path, docker: Path, **stated: object) -> str:
    """The record of a service that was asked for, and of which nothing was seen yet."""
    found = {
        "id": "", "program": str(docker / "docker"), "managers": [""], "place": f"n0de:{folder}", "service": "edgectl-lab-a-slam",
        "image": "lab/slam:1", "services": [], "asked": 0.0, "boot_id": system_files.read_boot_id(), "pending": True,
    }  # fmt: skip
    record.write_container(str(folder), found | stated)
    return str(folder)


def list_calls(docker: Path, word: str) -> list[str]:
    return [line for line in (docker / "calls").read_text().splitlines() if line.startswith(word)]


def test_a_service_that_is_listed_is_removed(tmp_path: Path, docker: Path) -> None:
    folder = write_record(tmp_path, docker)
    (docker / "services").write_text("5erv1ce12345\n")
    assert swarm.remove_service(folder) == ""
    assert list_calls(docker, "service rm") == ["service rm 5erv1ce12345"]
    assert list_calls(docker, "service create") == []
    found = record.read_container(folder)
    assert (found["place"], found["pending"], record.may_start(folder)) == ("", False, False)


def test_that_there_is_none_is_believed_of_a_quorum_only(tmp_path: Path, docker: Path) -> None:
    """A manager without the others lists none, too, and may agree with them later on what it was asked."""
    folder = write_record(tmp_path, docker)
    (docker / "no-leader").touch()
    assert swarm.remove_service(folder).endswith("its service may still start here")
    assert record.may_start(folder)
    (docker / "no-leader").unlink()
    assert swarm.remove_service(folder) == ""
    (created,) = list_calls(docker, "service create")[1:]
    assert "--replicas 0 --name edgectl-lab-a-slam" in created
    assert list_calls(docker, "service rm") == ["service rm barrier12345"]
    assert not record.may_start(folder)


def test_its_tasks_must_have_ended(tmp_path: Path, docker: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swarm, "_TASKS_S", 0.2)
    folder = write_record(tmp_path, docker, services=["5erv1ce12345"])
    (docker / "services").write_text("5erv1ce12345\n")
    (docker / "tasks").write_text("other67890.1\n5erv1ce12345abcdefghijklm.1\n")
    assert "has not ended its task on this node yet" in swarm.remove_service(folder)
    assert record.may_start(folder)
    # Not listed any more, but known from before.
    (docker / "tasks").write_text("other67890.1\n")
    assert swarm.remove_service(folder) == ""
    assert not record.may_start(folder)


def test_a_host_that_is_another_node_now_starts_nothing(tmp_path: Path, docker: Path) -> None:
    folder = write_record(tmp_path, docker)
    (docker / "no-leader").touch()
    (docker / "info").write_text('{"NodeID": "", "LocalNodeState": "inactive"}')
    assert swarm.remove_service(folder) == ""
    assert not record.may_start(folder)


def test_one_whose_container_has_run_is_left_for_later(tmp_path: Path, docker: Path) -> None:
    folder = write_record(tmp_path, docker, pending=False, run="r1")
    (docker / "services").write_text("5erv1ce12345\n")
    (docker / "no-leader").touch()
    assert swarm.remove_service(folder) == ""
    assert record.read_container(folder)["place"]
    record.note_removal(folder, record.read_container(folder))
    assert record.may_be_left(folder)
    (docker / "no-leader").unlink()
    assert swarm.remove_service(folder) == ""
    record.note_removal(folder, record.read_container(folder))
    assert not record.may_be_left(folder)
