# SPDX-License-Identifier: Apache-2.0
"""Systemd scopes (``runtime: systemd``): choice of a scope, limits read back; with a real systemd --user where possible."""

import getpass
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.agent.link.errors import RefusalError
from edgectl.agent.measure import proc, system_files
from edgectl.agent.supervise import launch, lockfile, scope
from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost, a_spec, eventually, is_running
from tests.agent.test_cgroup import V1, V2, tree
from tests.agent.test_probe import interpreters
from tests.agent.user_systemd import V1 as V1_GROUPS
from tests.agent.user_systemd import UserSystemd, can_be_real, user_systemd

real_only = pytest.mark.skipif(
    not can_be_real(), reason="needs root, systemd and control groups that can be written"
)
LIMITS = {"cpu": 0.25, "memory": 64_000_000}


@pytest.fixture
def stand_in(tmp_path: Path) -> Iterator[UserSystemd]:
    with user_systemd(tmp_path / "stand-in", real=False) as found:
        yield found


def at(host: AgentHost, place: UserSystemd, runtime: str = "systemd") -> AgentHost:
    host.runtime, host.session.python = runtime, str(place.python)
    return host


def groups_of(pid: int) -> str:
    return Path(f"/proc/{pid}/cgroup").read_text()


@real_only
def test_limits_hold_and_are_read_back(host: AgentHost, systemd: UserSystemd) -> None:
    at(host, systemd).start("slam", "while :; do :; done", limits=LIMITS)
    entry = host.until("slam", "running")
    assert entry["limits"] == "enforced"
    assert "/edgectl-edge1-slam-" in groups_of(entry["pid"])
    assert "/edgectl-edge1-slam-" in groups_of(host.supervisor("slam"))
    used = host.ask("probe", window_s=2.0, links=[], detect=[], checks=[])["tasks"]["slam"]["used_cores"]
    assert 0.0 < used < 0.6, (
        "a quarter of a core, or less where others want it; without a limit it would be a whole one"
    )
    assert host.stop("slam")["state"] == "stopped"
    eventually(lambda: not any("slam" in line for line in systemd.units()))


@real_only
def test_hog_is_killed_alone_and_its_end_is_recorded(host: AgentHost, systemd: UserSystemd) -> None:
    at(host, systemd).start("slam", "echo up; exec tail /dev/zero", limits=LIMITS)
    entry = host.until("slam", "failed", seconds=30)
    assert (entry["exit_code"], entry["detail"]) == (137, "killed by SIGKILL (out of memory, or by hand)")
    assert entry["log_tail"] == ["up"]


@real_only
@pytest.mark.skipif(
    not V1_GROUPS.exists(), reason="needs control groups v1, whose controllers can be taken away one by one"
)
def test_limits_that_systemd_accepts_but_cannot_set_are_reported(host: AgentHost, tmp_path: Path) -> None:
    """As on JetPack 4 and 5: control groups v1 are not delegated to a user's systemd, which reports no error."""
    with user_systemd(tmp_path / "undelegated", real=True, read_only=("cpu", "memory")) as place:
        reply = at(host, place).start("slam", "exec sleep 600", limits=LIMITS)
        message = "not enforced: cpu and memory: accepted by systemd, but missing in the control group (control groups v1)"
        assert reply["detail"] == f"limits: {message}"
        assert host.until("slam", "running")["limits"] == message
        assert host.stop("slam")["state"] == "stopped"


def test_command_line_holds_nothing_of_the_users_own(host: AgentHost, stand_in: UserSystemd) -> None:
    secret = "hunter2; $(touch /tmp/x) 'quoted'"
    at(host, stand_in).start(
        "slam",
        f"echo {'y' * 100_000} >/dev/null; exec sleep 600",
        env={"TOKEN": secret},
        workdir="/usr",
        limits=LIMITS,
        prelude="export SAID=1",
    )
    program = "import sys;s=sys.stdin.buffer;exec(s.read(int(s.readline())))"
    unit = stand_in.argv[3]
    assert unit.startswith("--unit=edgectl-edge1-slam-")
    assert stand_in.argv[:-5] == [
        "--user", "--scope", "--collect", unit,
        "-p", "CPUQuota=25%", "-p", "MemoryMax=64000000", "-p", "OOMPolicy=continue", "--",
    ]  # fmt: skip
    assert stand_in.argv[-4:] == ["-I", "-S", "-c", program]
    host.stop("slam")


def list_processes() -> set[str]:
    return {name for name in os.listdir("/proc") if name.isdigit()}  # noqa: PTH208 - a fifth of the CPU of Path


def test_secrets_stand_in_no_command_line_and_on_no_disk(host: AgentHost, systemd: UserSystemd) -> None:
    """In both runtimes, while the task starts, runs, restarts and stops. Processes from before it cannot have them."""
    others = list_processes()
    for runtime in ("process", "systemd"):
        if runtime == "systemd":
            at(host, systemd)
        host.start(
            "slam",
            "test ${#TOKEN} = 14 && sleep 0.5; exit 1",
            restart="always",
            env={"TOKEN": "hunter2-in-env"},
        )
        deadline = time.monotonic() + 2.5
        while time.monotonic() < deadline:
            lines = [system_files.read_file(f"/proc/{pid}/cmdline") for pid in list_processes() - others]
            assert not [line for line in lines if b"hunter2" in line]
            for path in host.state.rglob("*"):
                assert path.is_dir() or b"hunter2" not in path.read_bytes(), path
            time.sleep(0.005)
        host.stop("slam")


def test_auto_takes_systemd_only_with_lingering(host: AgentHost, stand_in: UserSystemd) -> None:
    at(host, stand_in, "auto").start("slam", "exec sleep 600", limits=LIMITS)
    assert stand_in.argv[0] == "--user"
    host.stop("slam")
    (stand_in.folder / "argv").unlink()
    Path(f"/proc/{stand_in.pid}/root/var/lib/systemd/linger/root").unlink()
    reply = host.start("slam", "exec sleep 600", instance="i2", limits=LIMITS)
    assert reply["detail"] == "limits: not enforced: lingering is off for root"
    assert not (stand_in.folder / "argv").exists()
    host.stop("slam")
    with pytest.raises(
        RefusedError, match="runtime systemd is not available: lingering is off for root"
    ) as caught:
        host.start("slam", "exec sleep 600", instance="i3", runtime="systemd")
    assert "loginctl enable-linger root" in (caught.value.hint or "")


def test_systemd_that_fails_is_refused_or_for_auto_done_without(
    host: AgentHost, stand_in: UserSystemd
) -> None:
    (stand_in.folder / "refuse").touch()
    with pytest.raises(
        RefusedError, match="systemd-run did not start the task: Failed to start transient scope unit: no"
    ):
        at(host, stand_in).start("slam", "exec sleep 600")
    reply = at(host, stand_in, "auto").start("slam", "exec sleep 600", limits={"cpu": 1.0, "memory": None})
    assert reply["state"] == "started"
    assert (
        reply["detail"]
        == "limits: not enforced: systemd-run failed: Failed to start transient scope unit: no"
    )
    assert len(host.members("slam")) == 1
    host.stop("slam")


def test_systemd_that_hangs_is_ended_and_for_auto_done_without(
    host: AgentHost, stand_in: UserSystemd
) -> None:
    (stand_in.folder / "systemd-run").write_text("#!/bin/sh\nexec sleep 611\n")
    reply = at(host, stand_in, "auto").start("slam", "exec sleep 600", limits={"cpu": 1.0, "memory": None})
    assert reply["detail"] == "limits: not enforced: systemd-run failed: no answer within 10 s"
    assert len(host.members("slam")) == 1
    lines = [
        system_files.read_file(f"{folder}/cmdline")
        for folder in Path("/proc").iterdir()
        if folder.name.isdigit()
    ]
    assert b"sleep\x00611\x00" not in lines
    host.stop("slam")


@pytest.mark.parametrize(
    ("data", "in_time", "expected"),
    [
        (
            b"12 345\nA dependency job failed.\nSee journalctl.\n",
            True,
            "A dependency job failed. See journalctl.",
        ),
        (b"12 345\nRunning scope as unit: x.scope\n", True, "the supervisor ended in its scope"),
        (b"12 345\nRunning scope as unit: x.scope\nno module\n", True, "no module"),
        (b"12 345\n", True, "it ended without a word"),
        (b"12 345\n", False, "no answer within 10 s"),
        # A machine so busy that not even the first process had come to write.
        (b"", False, "no answer within 10 s"),
        (b"12 345\nthe bus is gone\n", False, "the bus is gone; no answer within 10 s"),
    ],
)
def test_what_is_said_of_a_systemd_run_without_a_report(data: bytes, in_time: bool, expected: str) -> None:
    assert launch.describe_silence(data, in_time=in_time) == expected


def test_nothing_is_started_beside_what_a_dead_supervisor_has_left(
    host: AgentHost, stand_in: UserSystemd
) -> None:
    """It was killed after the start and before its report: auto must not start the task once more."""
    (stand_in.folder / "systemd-run").write_text(
        f"#!{sys.executable}\nimport os\nos.fork() and os._exit(0)\nfor fd in os.listdir('/proc/self/fd'):\n"
        "    if os.path.realpath('/proc/self/fd/' + fd).rpartition('/')[2].startswith('pipe:'): os.close(int(fd))\n"
        "os.execvp('sleep', ['sleep', '612'])\n"
    )
    with pytest.raises(RefusedError, match="left processes"):
        at(host, stand_in, "auto").start("slam", "exec sleep 600", limits={"cpu": 1.0, "memory": None})
    folder = str(host.folder("slam"))
    holders = lockfile.find_lock_holders(folder, proc.read_process_table())
    assert len(holders) == 1
    os.kill(holders.pop(), signal.SIGKILL)
    eventually(lambda: not lockfile.is_lock_held(folder))
    assert host.entry("slam") is None


def test_start_that_cannot_be_is_not_tried_twice(host: AgentHost, stand_in: UserSystemd) -> None:
    with pytest.raises(RefusedError, match="/no/such/folder: No such file or directory"):
        at(host, stand_in, "auto").start("slam", "exec sleep 600", workdir="/no/such/folder")
    assert host.start("slam", "exec sleep 600", instance="i2")["state"] == "started"
    host.stop("slam")


def test_supervisor_that_nobody_awaits_starts_nothing(
    host: AgentHost, stand_in: UserSystemd, tmp_path: Path
) -> None:
    """A systemd that responds after the agent gave up and replied that nothing was started."""
    program = (stand_in.folder / "systemd-run").read_text()
    (stand_in.folder / "systemd-run").write_text(program.replace('exec "$@"', 'sleep 3; exec "$@"'))
    with pytest.raises(Exception, match="no answer within"):
        at(host, stand_in).ask(
            "start", task="slam", instance="i1", generation=1, timeout=1.0,
            spec={"command": f"touch {tmp_path}/started", "log": {"max_bytes": 5000, "files": 1}, "runtime": "systemd"},
        )  # fmt: skip
    time.sleep(4)
    assert not (tmp_path / "started").exists()
    assert host.entry("slam") is None
    host.start("slam", "exec sleep 600", instance="i2", runtime="process")
    host.stop("slam")


@real_only
def test_an_orphan_in_a_scope_is_not_adopted_but_stopped_and_started_in_a_new_one(
    host: AgentHost, systemd: UserSystemd
) -> None:
    """A new supervisor would start the command outside of the scope and its limits."""
    pid = at(host, systemd).start("slam", "exec sleep 600", limits=LIMITS)["pid"]
    host.until("slam", "running")
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    entry = eventually(lambda: e if (e := host.entry("slam")) and e.get("orphaned") else None)
    assert (entry["pid"], entry["adoptable"]) == (pid, False)
    with pytest.raises(RefusedError, match="runs in a systemd scope, which takes no new supervisor"):
        host.ask("takeover", task="slam", instance="i1", generation=2, spec=a_spec("exec sleep 600"))
    assert is_running(pid)
    # What apply does instead (tests/executor/test_diff.py): the stop and the start of a restart.
    assert host.stop("slam")["state"] == "stopped"
    assert not is_running(pid)
    again = host.start("slam", "exec sleep 600", limits=LIMITS, instance="i2", generation=3)["pid"]
    assert "/edgectl-edge1-slam-" in groups_of(again)
    assert host.entry("slam")["limits"] == "enforced"  # type: ignore[index]


def test_runtime_process_reports_that_limits_are_not_enforced(host: AgentHost) -> None:
    reply = host.start("slam", "exec sleep 600", limits=LIMITS)
    assert reply["detail"] == "limits: not enforced: runtime process sets no control group"
    entry = host.entry("slam")
    assert entry is not None
    assert entry["limits"] == "not enforced: runtime process sets no control group"
    host.stop("slam")
    host.start("slam", "exec sleep 600", instance="i2")
    assert (host.entry("slam") or {})["limits"] == ""
    host.stop("slam")


@pytest.mark.parametrize(
    ("cores", "percent"),
    [(0.001, 1), (0.25, 25), (0.333, 34), (1.0, 100), (2.5, 250), (0.29, 29), (1.1, 110)],
)
def test_quota_in_whole_percent(cores: float, percent: int) -> None:
    assert scope.compute_cpu_percent(cores) == percent


def a_host(root: Path, *, lingering: bool = True) -> str:
    user = root / "run" / "user" / str(os.geteuid()) / "systemd"
    user.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(user / "private"))
    if lingering:
        (root / "var/lib/systemd/linger").mkdir(parents=True)
        (root / "var/lib/systemd/linger" / getpass.getuser()).touch()
    return str(root)


def test_what_stands_in_the_way(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    program = tmp_path / "bin" / "systemd-run"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    user = getpass.getuser()
    assert scope.find_obstacle(str(tmp_path / "nothing"))[0] == f"no systemd --user is running for {user}"
    why, hint = scope.find_obstacle(a_host(tmp_path / "a", lingering=False))
    assert (why, hint) == (
        f"lingering is off for {user}",
        f"on the host, as root: loginctl enable-linger {user}; or use runtime: auto or process",
    )
    assert scope.find_obstacle(a_host(tmp_path / "b")) == ("", "")
    with pytest.raises(RefusalError, match="no systemd --user is running"):
        scope.choose_scope("systemd", "edge1", "slam", None, str(tmp_path / "nothing"))


@pytest.mark.parametrize(
    ("limits", "files", "text"),
    [
        (None, V2, ""),
        ({"cpu": None, "memory": None}, V2, ""),
        ({"cpu": 1.5, "memory": 536870912}, V2, "enforced"),
        ({"cpu": 2.0, "memory": None}, V2, "enforced"),
        (
            {"cpu": 1.0, "memory": 536870912},
            V2,
            "not enforced: cpu: accepted by systemd, but missing in the control group",
        ),
        (
            {"cpu": 0.1, "memory": 1e8},
            {
                "proc/self/cgroup": "0::/a\n",
                "sys/fs/cgroup/cgroup.controllers": "memory pids\n",
                "sys/fs/cgroup/a/memory.max": "99999744\n",
            },
            "not enforced: cpu: accepted by systemd, but missing in the control group",
        ),
        (
            {"cpu": 0.4, "memory": 1 << 20},
            V1,
            "not enforced: memory: accepted by systemd, but missing in the control group (control groups v1)",
        ),
    ],
)
def test_limits_are_read_back_from_the_control_group(
    tmp_path: Path, limits: dict[str, float], files: dict[str, str], text: str
) -> None:
    assert scope.describe_limits(limits, "", tree(tmp_path, files)) == text


@pytest.mark.parametrize("python", interpreters(), ids=lambda path: "-".join(Path(path).parts[-3::2]))
def test_any_python_can_be_the_supervisor_in_a_scope(
    host: AgentHost, systemd: UserSystemd, tmp_path: Path, python: str
) -> None:
    wrapper = tmp_path / "python3"
    wrapper.write_text(systemd.python.read_text().replace(sys.executable, python))
    wrapper.chmod(0o755)
    host.session.python = str(wrapper)
    host.start("slam", "exec sleep 600", runtime="systemd", self_fence_s=600)
    assert host.ask("wait", task="slam", instance="i1", timeout_s=30)["state"] == "running"
    assert Path(f"/proc/{host.supervisor('slam')}/exe").resolve() == Path(python).resolve()
    assert host.stop("slam")["state"] == "stopped"


def test_scope_outlives_the_agent_and_its_session(host: AgentHost, systemd: UserSystemd) -> None:
    pid = at(host, systemd).start("slam", "exec sleep 600")["pid"]
    supervisor = host.supervisor("slam")
    assert os.getsid(supervisor) not in (os.getsid(0), os.getsid(pid))
    assert (
        subprocess.run(
            ["ps", "-o", "args=", "-p", str(supervisor)], capture_output=True, text=True, check=True
        ).stdout.count("slam")
        == 0
    )
    assert is_running(pid)
    host.stop("slam")
    assert not is_running(supervisor)
