# SPDX-License-Identifier: Apache-2.0
"""Tests of the emulated computers: power, cable, reboot, and no leftovers."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import sshd
from tests.faults import cgroup, scan
from tests.faults.hosts import LIMIT, start_loopback_hosts, wait_for
from tests.faults.namespace_host import (
    NamespaceHost,
    find_missing_for_namespaces,
    find_missing_for_systemd,
    start_namespace_hosts,
)
from tests.faults.network import ManagerNetwork
from tests.pace import patience

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, ManagerNetwork, NamespaceHost]]:
    if why := find_missing_for_namespaces():
        assert os.geteuid() != 0, f"root, but no computers in namespaces: {why}"
        pytest.skip(f"computers in namespaces: not run: {why}")
    directory = tmp_path_factory.mktemp("computers")
    with start_namespace_hosts(directory, ["edge1"], cores={"edge1": 0.8}) as (site, hosts):
        host = hosts["edge1"]
        assert isinstance(host, NamespaceHost)
        yield directory, site, host


def run_ssh(
    place: tuple[Path, ManagerNetwork, NamespaceHost], command: str, *, within: int = 20
) -> "subprocess.CompletedProcess[str]":
    """Run a command on the computer; ``within``: seconds to wait for the answer, few where none is expected."""
    directory, site, host = place
    address, port, user, key = host.login
    (directory / "known").write_text(f"{address} {key}\n")
    options = [
        f"UserKnownHostsFile={directory}/known",
        "BatchMode=yes",
        f"ConnectTimeout={within}",
        f"IdentityFile={directory}/user_key",
        "IdentitiesOnly=yes",
    ]
    words = [word for option in options for word in ("-o", option)]
    line = [
        *site.prefix,
        sshd.find_program("ssh"),
        "-F",
        "none",
        *words,
        "-p",
        str(port),
        f"{user}@{address}",
        command,
    ]
    return subprocess.run(line, capture_output=True, text=True, timeout=patience(60), check=False)


def test_it_is_a_computer_of_its_own(place: tuple[Path, ManagerNetwork, NamespaceHost]) -> None:
    answer = run_ssh(place, "id -un; hostname; cat /proc/sys/kernel/random/boot_id; ls ~").stdout.split()
    assert answer == ["edge", "edge1", place[2].boot_id, "oracle"]
    assert len(run_ssh(place, "ps -e").stdout.splitlines()) < 12


def test_power(place: tuple[Path, ManagerNetwork, NamespaceHost]) -> None:
    host = place[2]
    before = host.boot_id
    run_ssh(place, "echo kept > file; setsid sleep 1000 >/dev/null 2>&1 &")
    wait_for(lambda: list_sleepers(host), "the sleeper")
    (sleeper,) = list_sleepers(host)
    host.power_off()
    assert not sleeper.alive
    said = run_ssh(place, "true", within=1).stderr
    assert "timed out" in said or "No route" in said
    host.boot()
    assert host.boot_id != before
    assert run_ssh(place, "cat file; cat /proc/sys/kernel/random/boot_id").stdout.split() == [
        "kept",
        host.boot_id,
    ]
    wait_for(lambda: host.processes() == [], "the end of the login")


def list_sleepers(host: NamespaceHost) -> list[scan.Process]:
    return [each for each in host.processes() if each.command == "sleep 1000"]


def test_cable(place: tuple[Path, ManagerNetwork, NamespaceHost]) -> None:
    host = place[2]
    host.unplug_cable()
    assert run_ssh(place, "true", within=1).returncode == 255
    host.plug_in_cable()
    wait_for(lambda: run_ssh(place, "true").returncode == 0, "the link")
    host.drop_packets()
    assert run_ssh(place, "true", within=1).returncode == 255
    host.plug_in_cable()
    wait_for(lambda: run_ssh(place, "true").returncode == 0, "the link")


def test_disk_and_mounts(place: tuple[Path, ManagerNetwork, NamespaceHost]) -> None:
    host = place[2]
    host.fill_disk()
    assert "No space left" in run_ssh(place, "echo something > full").stderr
    host.free_disk()
    host.home_read_only(yes=True)
    assert "Read-only" in run_ssh(place, "echo something > ro").stderr
    assert run_ssh(place, "echo something > oracle/records/note").returncode == 0
    host.home_read_only(yes=False)
    assert run_ssh(place, "echo something > rw").returncode == 0


def test_python_hidden(place: tuple[Path, ManagerNetwork, NamespaceHost]) -> None:
    host = place[2]
    host.hide_python(yes=True)
    assert run_ssh(place, "python3 -V").returncode == 127
    host.hide_python(yes=False)
    assert run_ssh(place, "python3 -V").returncode == 0


def test_login_and_key_and_environment(place: tuple[Path, ManagerNetwork, NamespaceHost]) -> None:
    host = place[2]
    host.allow_logins(allowed=False)
    assert "Permission denied" in run_ssh(place, "true").stderr
    host.allow_logins(allowed=True)
    old = host.key
    host.change_key()
    assert host.key != old
    host.set_env(LAMP="on and off")
    assert run_ssh(place, 'echo "$LAMP"').stdout == "on and off\n"
    host.set_env()


def test_a_bystander_takes_the_requested_pid(place: tuple[Path, ManagerNetwork, NamespaceHost]) -> None:
    host = place[2]
    bystander = host.start_bystander("bystander", "like", "slam", pid=4321)
    assert bystander.list_harm() == []
    assert run_ssh(place, "kill -TERM 4321").returncode == 0
    wait_for(bystander.list_harm, "the bystander's complaint")
    wait_for(lambda: host.processes() == [], "the end of the login")


def test_cpu_limit(place: tuple[Path, ManagerNetwork, NamespaceHost]) -> None:
    host = place[2]
    if LIMIT not in host.can:
        pytest.skip(f"CPU limit: not run: {host.group.why}")
    loop = "python3 -c 'import os, time; end = time.monotonic() + 1\nwhile time.monotonic() < end: pass\nprint(sum(os.times()[:2]))'"
    assert float(run_ssh(place, loop).stdout) < 0.95


def test_nothing_remains(tmp_path: Path) -> None:
    if why := find_missing_for_namespaces():
        pytest.skip(f"computers in namespaces: not run: {why}")
    with start_namespace_hosts(tmp_path / "c", ["edge1", "edge2"], cores={"edge1": 0.5}) as (site, hosts):
        host = hosts["edge1"]
        assert isinstance(host, NamespaceHost)
        host.run("sh", "-c", "setsid sleep 1000 >/dev/null 2>&1 &")
        spaces = [Path(f"/proc/{host.pid}/ns/{kind}").stat().st_ino for kind in ("pid", "net", "mnt")]
        groups = host.group.directories
        netns = site.netns.stat().st_ino
    found = [
        scan.list_processes_in_namespace(kind, inode)
        for kind, inode in zip(("pid", "net", "mnt"), spaces, strict=True)
    ]
    assert found == [[], [], []]
    assert scan.list_processes_in_namespace("net", netns) == []
    assert scan.list_marked_processes(str(tmp_path)) == []
    assert str(tmp_path) not in Path("/proc/self/mounts").read_text()
    assert not any(group.exists() for group in groups)


@pytest.mark.slow
def test_systemd_is_pid_1_and_leaves_nothing(tmp_path: Path) -> None:
    """The system has no failed unit, and the user's manager lingers."""
    if why := find_missing_for_systemd():
        pytest.skip(f"computers with systemd: not run: {why}")
    with start_namespace_hosts(tmp_path / "c", ["edge1"], systemd=True) as (site, hosts):
        host = hosts["edge1"]
        assert isinstance(host, NamespaceHost)
        words = (
            "systemctl is-system-running --wait; systemctl --user is-system-running --wait; cat /proc/1/comm"
        )
        answer = run_ssh((tmp_path / "c", site, host), words, within=10)
        assert answer.stdout.split() == ["running", "running", "systemd"], answer
        assert host.processes() == []
        groups = host.own_groups
    assert groups
    assert not any(group.exists() for group in groups)


def test_nothing_remains_of_a_killed_run(tmp_path: Path) -> None:
    """The computers end with the tests that are killed; only the empty cgroup stays."""
    if why := find_missing_for_namespaces():
        pytest.skip(f"computers in namespaces: not run: {why}")
    script = (
        "import sys, time, pathlib; from tests.faults.namespace_host import start_namespace_hosts\n"
        "with start_namespace_hosts(pathlib.Path(sys.argv[1]), ['edge1']) as (site, hosts):\n"
        "    print('up', flush=True); time.sleep(60)\n"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path / "c")],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).parents[2],
    )
    assert run.stdout is not None
    with run.stdout:
        assert run.stdout.readline() == b"up\n"
        run.kill()
        run.wait()
    wait_for(lambda: scan.list_marked_processes(str(tmp_path)) == [], "the end of the computers")


def test_a_loopback_host(tmp_path: Path) -> None:
    with start_loopback_hosts(tmp_path, ["edge1"]) as hosts:
        host = hosts["edge1"]
        assert (host.home / "oracle" / "recording_task.py").exists()
        assert host.start_bystander("bystander", "x").list_harm() == []
        host.power_off()
        host.boot()
        host.set_env(LAMP="on")
        host.allow_logins(allowed=False)
        host.allow_logins(allowed=True)
        assert host.processes() == []


def test_no_group_where_no_limit_is_wanted() -> None:
    assert cgroup.create_cgroup("edgectl-faults-none", None).procs_files == []


AT_ONCE = """
import sys, threading
from pathlib import Path
from tests.compiled_agent import give_agent

sys.setswitchinterval(1e-6)
together, failed = threading.Barrier(4), []

def give(name):
    together.wait()
    try:
        give_agent(Path(sys.argv[1]) / name)
    except OSError as error:
        failed.append(error)

threads = [threading.Thread(target=give, args=(name,)) for name in "dcba"]
for each in threads:
    each.start()
for each in threads:
    each.join()
sys.exit(str(failed) if failed else 0)
"""


def test_fleets_that_start_at_once_share_one_agent(tmp_path: Path) -> None:
    """`--jobs 2` begins with two threads; each made the folder of the agent, and one was removed under the other."""
    words = [sys.executable, "-c", AT_ONCE, str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, timeout=patience(20))
    assert not done.returncode, done.stderr
    assert len(list(tmp_path.glob("[abcd]/agent/*.pyz"))) == 4
