# SPDX-License-Identifier: Apache-2.0
"""Facts of ``doctor``: real ones of this machine, and fixture trees for configurations that it does not have."""

import os
import sys
import time
from pathlib import Path

import pytest

from edgectl.agent.measure import doctor
from edgectl.agent.supervise import logind
from edgectl.agent.supervise.shell import ShellCommand
from tests.agent.conftest import AgentHost

# The kernel refuses a connection to the broadcast address without sending anything.
NOWHERE = "255.255.255.255"


def seen(prelude: str, env: dict[str, str] | None = None, timeout_s: float = 20.0) -> dict[str, object]:
    """The surroundings of a task after ``prelude``."""
    return doctor.parse_surroundings(ShellCommand(doctor._build_script(prelude), "", env, timeout_s).result())


@pytest.fixture(autouse=True)
def no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in doctor.ROS_VARIABLES:
        monkeypatch.delenv(name, raising=False)


def test_this_machine(host: AgentHost) -> None:
    links = [
        {"robot": "near", "address": "127.0.0.1"},  # a refusal counts as an answer
        {"robot": "far", "address": NOWHERE},
        {"robot": "who", "address": "no-such-robot.invalid"},
    ]
    before = time.time()
    answer = host.ask("doctor", links=links, prelude="", env={"ROS_DOMAIN_ID": "7"}, timeout_s=20.0)
    assert (answer["v"], answer["op"], answer["host"]) == (1, "doctor", "edge1")
    assert answer["python"] == sys.version.split()[0]
    assert before - 1.0 <= answer["clock"]["began"] <= answer["clock"]["ended"] <= time.time() + 1.0
    assert answer["links"]["near"]["reachable"] is True
    assert (answer["links"]["far"]["reachable"], answer["links"]["far"]["found"]) == (False, True)
    assert (answer["links"]["who"]["reachable"], answer["links"]["who"]["found"]) == (None, False)
    assert answer["surroundings"] == {
        "status": 0, "timed_out": False, "said": "", "variables": {"ROS_MASTER_URI": "", "ROS_DOMAIN_ID": "7", "RMW_IMPLEMENTATION": ""},
    }  # fmt: skip
    space = os.statvfs(host.state)
    assert answer["disk"]["path"] == str(host.state)
    assert answer["disk"]["obstacle"] == ""
    assert answer["disk"]["total_bytes"] == space.f_blocks * space.f_frsize
    assert 0 < answer["disk"]["free_bytes"] < answer["disk"]["total_bytes"]
    assert 0 < answer["memory"]["used_bytes"] < answer["memory"]["total_bytes"]


def test_what_a_host_lacks_of_its_ros(host: AgentHost, tmp_path: Path) -> None:
    """Packages are looked for in the environment of the set-up files, which leave their names alone."""
    index = tmp_path / "ws/share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "slam").touch()
    setup, missing = tmp_path / "setup.bash", str(tmp_path / "none.bash")
    setup.write_text(f"export AMENT_PREFIX_PATH=/nowhere:{tmp_path}/ws ROS_DOMAIN_ID=9\n")
    answer = host.ask(
        "doctor",
        links=[{"robot": "near", "address": "127.0.0.1"}],
        prelude="",
        ros={"setup": [str(setup), missing], "peers": ["127.0.0.1"], "values": {}},
        packages=["slam", "camera"],
        env={"ROS_IP": "{host_address}"},
        timeout_s=20.0,
    )
    assert answer["ros"]["missing_files"] == [missing]
    assert answer["ros"]["missing_packages"] == ["camera"]
    assert answer["ros"]["addresses"] == {"near": "127.0.0.1"}
    assert answer["ros"]["receive_bytes"] > 0
    assert answer["surroundings"]["variables"]["ROS_DOMAIN_ID"] == "9"


def test_the_prelude_overrides_and_only_its_exports_count() -> None:
    assert seen("export ROS_DOMAIN_ID=8", {"ROS_DOMAIN_ID": "7"})["variables"]["ROS_DOMAIN_ID"] == "8"  # type: ignore[index]
    assert seen("RMW_IMPLEMENTATION=x")["variables"]["RMW_IMPLEMENTATION"] == ""  # type: ignore[index]
    assert seen("unset ROS_DOMAIN_ID", {"ROS_DOMAIN_ID": "7"})["variables"]["ROS_DOMAIN_ID"] == ""  # type: ignore[index]


@pytest.mark.parametrize(
    ("prelude", "status", "said"),
    [
        ("echo Welcome; echo 'edgectl-sees: 9'", 0, "edgectl-sees: 9"),
        ("set -u; export ROS_MASTER_URI='a b\"c'", 0, ""),
        ("echo missing >&2; false", 1, "missing"),
        ("echo bye; exit 0", None, "bye"),
        ("set -e; false", None, ""),
        ("exit 3 # with no newline", None, ""),
    ],
)
def test_how_the_prelude_ended(prelude: str, status: int | None, said: str) -> None:
    found = seen(prelude)
    assert (found["status"], found["said"], found["timed_out"]) == (status, said, False)


def test_a_prelude_that_hangs_is_ended() -> None:
    found = seen("sleep 600", timeout_s=0.3)
    assert (found["status"], found["timed_out"]) == (None, True)


def test_a_state_directory_that_cannot_be_used(tmp_path: Path) -> None:
    assert doctor.read_disk_facts(str(tmp_path / "a" / "b"))["obstacle"] == ""
    assert not (tmp_path / "a").exists(), "reading creates nothing"
    (tmp_path / "file").touch()
    assert "not a directory" in doctor.read_disk_facts(str(tmp_path / "file"))["obstacle"]
    assert "not a directory" in doctor.read_disk_facts(str(tmp_path / "file" / "b"))["obstacle"]
    (tmp_path / "link").symlink_to(tmp_path)
    assert "not a directory" in doctor.read_disk_facts(str(tmp_path / "link"))["obstacle"]
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    assert "mode 0700" in doctor.read_disk_facts(str(tmp_path / "open"))["obstacle"]


def logind_tree(root: Path, *settings: tuple[str, str]) -> None:
    """Create a host with logind and these (file, text) of its configuration."""
    (root / "run/systemd/system").mkdir(parents=True)
    (root / "run/systemd/seats").mkdir(parents=True)
    for name, text in settings:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(f"[Login]\n{text}\n")


def test_the_end_of_the_login_on_a_host_without_logind(tmp_path: Path) -> None:
    assert doctor.read_login_facts(str(tmp_path))["present"] is False


@pytest.mark.parametrize(
    ("settings", "removes", "kills"),
    [
        ([], True, False),
        ([("etc/systemd/logind.conf", "#RemoveIPC=no")], True, False),
        ([("etc/systemd/logind.conf", "RemoveIPC=no\nKillUserProcesses=yes")], False, True),
        ([("etc/systemd/logind.conf", "RemoveIPC=no"), ("usr/lib/systemd/logind.conf.d/50-vendor.conf", "RemoveIPC=yes")], True, False),
        ([("etc/systemd/logind.conf.d/90-ros.conf", "RemoveIPC=no"), ("usr/lib/systemd/logind.conf.d/50-vendor.conf", "RemoveIPC=yes")], False, False),
        # A file of the same name in /etc overrides the vendor's, and an empty value changes nothing.
        ([("etc/systemd/logind.conf.d/50-a.conf", ""), ("usr/lib/systemd/logind.conf.d/50-a.conf", "RemoveIPC=no")], True, False),
        ([("etc/systemd/logind.conf", "RemoveIPC=no"), ("usr/lib/systemd/logind.conf", "KillUserProcesses=yes")], False, False),
    ],
)  # fmt: skip
def test_the_end_of_the_login_as_logind_is_configured(
    tmp_path: Path, settings: list[tuple[str, str]], removes: bool, kills: bool
) -> None:
    logind_tree(tmp_path, *settings)
    found = doctor.read_login_facts(str(tmp_path))
    assert (found["present"], found["removes_ipc"], found["kills"], found["lingers"]) == (
        True,
        removes,
        kills,
        False,
    )
    linger = tmp_path / "var/lib/systemd/linger" / str(found["user"])
    linger.parent.mkdir(parents=True)
    linger.touch()
    assert doctor.read_login_facts(str(tmp_path))["lingers"] is True


def test_only_the_exact_name_of_a_setting_counts(tmp_path: Path) -> None:
    logind_tree(tmp_path, ("etc/systemd/logind.conf", "XRemoveIPC=no\nRemoveIPC=\nremoveipc=no"))
    assert logind.removes_ipc(str(tmp_path)) is True
