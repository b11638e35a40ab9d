# SPDX-License-Identifier: Apache-2.0
"""Contract of the supervisor, on real processes, in both runtimes."""

import os
import signal
import stat
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.measure import proc
from edgectl.agent.supervise import lockfile, records
from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost, both_runtimes, eventually, is_running, shared_memory

pytestmark = both_runtimes

# A child, a double-fork daemon, a nested setsid, one with an emptied environment, one that ignores TERM.
FIVE = """
import os, signal, subprocess, sys, time
if os.fork() == 0:
    time.sleep(600); os._exit(0)
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        time.sleep(600)
    os._exit(0)
subprocess.Popen(["setsid", "sleep", "600"])
subprocess.Popen(["env", "-i", "/bin/sleep", "600"], close_fds=True)
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("up", flush=True)
while True:
    time.sleep(1)
"""


def python(program: str, folder: Path) -> str:
    path = folder / "program.py"
    path.write_text(program)
    return f"exec {sys.executable} -u {path}"


def ignored(status: str) -> int:
    """The ignored signals of a /proc status, without 32 and 33, which are reserved to the C library."""
    line = next(line for line in status.splitlines() if line.startswith("SigIgn"))
    return int(line.split()[1], 16) & ~(3 << 31)


def test_task_outlives_the_session_and_is_stopped(host: AgentHost) -> None:
    started = host.start("slam", "echo hello; exec sleep 600")
    assert started["state"] == "started"
    assert host.ask("wait", task="slam", instance="i1", timeout_s=30)["state"] == "running"
    entry = host.entry("slam")
    assert entry is not None
    assert (entry["state"], entry["pid"], entry["instance"], entry["spec_hash"]) == (
        "running",
        started["pid"],
        "i1",
        "h1",
    )
    assert proc.read_cmdline(entry["pid"]) == ["sleep", "600"]
    assert os.getsid(entry["pid"]) == entry["pid"]
    assert os.getsid(host.supervisor("slam")) not in (os.getsid(0), entry["pid"])
    assert host.ask("logs", task="slam", tail=5)["text"] == "hello\n"
    stopped = host.stop("slam")
    assert (stopped["state"], stopped["left"]) == ("stopped", [])
    assert not is_running(entry["pid"])
    assert host.entry("slam") is None
    assert host.stop("slam")["state"] == "not-running"


def test_task_starts_with_clean_signals_descriptors_and_directory(host: AgentHost) -> None:
    read, write = os.pipe()
    os.set_inheritable(write, True)
    command = (
        "grep Sig /proc/self/status; ls -l /proc/$$/fd; pwd; umask; echo task=$EDGECTL_TASK; exec sleep 600"
    )
    host.start("slam", command, env={"EDGECTL_TASK": "slam"}, workdir="/usr")
    text = eventually(lambda: t if "task=" in (t := host.ask("logs", task="slam", tail=50)["text"]) else None)
    os.close(read)
    os.close(write)
    assert ignored(text) == 0
    assert "SigBlk:\t0000000000000000" in text
    assert "\n/usr\n0077\ntask=slam\n" in text
    links = [line.split(" -> ")[1] for line in text.splitlines() if " -> " in line]
    lock = str(host.folder("slam") / "lock")
    assert {link for link in links if not link.startswith(("pipe:", "/dev/null"))} == {lock}
    host.stop("slam")


def test_ignored_int_is_not_passed_on(host: AgentHost) -> None:
    """``nohup cmd &`` over SSH leaves INT ignored, and Python passes that on to its children."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        pid = host.start("slam", "exec sleep 600")["pid"]
    finally:
        signal.signal(signal.SIGINT, before)
    assert ignored(Path(f"/proc/{pid}/status").read_text()) == 0
    host.stop("slam")


def test_files_are_private(host: AgentHost) -> None:
    before = os.umask(0)
    try:
        host.start("slam", "exec sleep 600")
    finally:
        os.umask(before)
    for path in [host.state, *host.state.rglob("*")]:
        mode = stat.S_IMODE(path.lstat().st_mode)
        assert mode == (0o700 if path.is_dir() else 0o600), path
    assert not any("sleep" in p.read_bytes().decode("latin-1") for p in host.folder("slam").iterdir()), (
        "no command is written down"
    )
    host.stop("slam")


@pytest.mark.parametrize("killed", ["nobody", "supervisor"])
def test_five_process_task_is_stopped_whole(host: AgentHost, tmp_path: Path, killed: str) -> None:
    host.start("slam", python(FIVE, tmp_path), stop={"signal": "TERM", "grace_s": 0.5, "preset": None})
    pids = eventually(lambda: found if len(found := host.members("slam")) >= 5 else None)
    if killed == "supervisor":
        os.kill(host.supervisor("slam"), signal.SIGKILL)
        eventually(lambda: not is_running(host.supervisor("slam")))
    stopped = host.stop("slam")
    assert (stopped["state"], stopped["left"]) == ("stopped", [])
    assert [pid for pid in pids if is_running(pid)] == []


def test_killed_supervisor_leaves_an_orphan_that_is_never_doubled(host: AgentHost) -> None:
    pid = host.start("slam", "exec sleep 600")["pid"]
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    entry = eventually(lambda: e if (e := host.entry("slam")) and "orphaned" in e["detail"] else None)
    assert (entry["state"], entry["pid"]) == ("running", pid)
    again = host.start("slam", "exec sleep 600", instance="i2")
    assert (again["state"], again["instance"], again["pid"]) == ("already-running", "i1", pid)
    assert host.stop("slam")["state"] == "stopped"
    assert not is_running(pid)
    assert host.start("slam", "exec sleep 600", instance="i3")["state"] == "started"
    host.stop("slam")


def test_launcher_that_closes_descriptors_is_found_by_its_cookie(host: AgentHost, tmp_path: Path) -> None:
    pid = host.start("slam", python("import os, time\nos.closerange(3, 100)\ntime.sleep(600)\n", tmp_path))[
        "pid"
    ]
    folder = str(host.folder("slam"))
    eventually(lambda: pid not in lockfile.find_lock_holders(folder, proc.read_process_table()))
    os.kill(host.supervisor("slam"), signal.SIGKILL)
    eventually(lambda: not lockfile.is_lock_held(folder))
    assert host.start("slam", "exec sleep 600", instance="i2")["state"] == "already-running"
    assert host.stop("slam")["state"] == "stopped"
    assert not is_running(pid)


def test_task_and_supervisor_killed_is_a_failure_that_can_be_started_again(host: AgentHost) -> None:
    pid, supervisor = host.start("slam", "exec sleep 600")["pid"], host.supervisor("slam")
    os.kill(supervisor, signal.SIGKILL)
    os.kill(pid, signal.SIGKILL)
    entry = eventually(lambda: e if (e := host.entry("slam")) and e["state"] == "failed" else None)
    assert (entry["pid"], entry["detail"]) == (0, "unknown: the supervisor was lost")
    assert host.start("slam", "exec sleep 600", instance="i2")["state"] == "started"
    host.stop("slam")


def test_starts_at_the_same_time_give_one_instance(host: AgentHost) -> None:
    host.ask("status", task=None)
    replies: list[dict[str, Any]] = []
    threads = [
        threading.Thread(target=lambda n=number: replies.append(host.start("slam", "exec sleep 600", instance=f"i{n}")))
        for number in range(6)
    ]  # fmt: skip
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(reply["state"] for reply in replies) == ["already-running"] * 5 + ["started"]
    # The pid of a reply may still be the supervisor's, before the command is recorded.
    assert len({reply["instance"] for reply in replies}) == 1
    # Until the command replaces its shell there may be a second process.
    eventually(lambda: len(host.members("slam")) == 1)
    host.stop("slam")


def test_lower_generation_is_refused(host: AgentHost) -> None:
    host.start("slam", "exec sleep 600", generation=5)
    with pytest.raises(RefusedError, match="generation 4 of slam is older than 5"):
        host.stop("slam", generation=4)
    with pytest.raises(RefusedError, match="older than 5"):
        host.start("slam", "exec sleep 600", instance="i2", generation=4)
    assert host.stop("slam", generation=6)["state"] == "stopped"
    probed = host.ask("probe", window_s=0.05)
    assert probed["generations"] == {"slam": 6}
    with pytest.raises(RefusedError, match="older than 6"):
        host.start("slam", "exec sleep 600", instance="i3", generation=5)


def test_stop_of_another_instance_leaves_this_one_alone(host: AgentHost) -> None:
    pid = host.start("slam", "exec sleep 600")["pid"]
    assert host.stop("slam", instance="i0")["state"] == "not-running"
    assert is_running(pid)
    host.stop("slam")


@pytest.mark.parametrize(
    ("command", "spec", "state", "code", "detail", "given_up"),
    [
        ("exit 0", {"kind": "job"}, "completed", 0, "exited with 0", False),
        ("exit 3", {"kind": "job"}, "failed", 3, "exited with 3", True),
        ("exit 0", {"restart": "on-failure"}, "failed", 0, "exited with 0", False),
        ("kill -SEGV $$", {}, "failed", 139, "killed by SIGSEGV", True),
        ("no-such-program", {}, "failed", 127, "exited with 127", True),
    ],
)
def test_end_is_recorded(
    host: AgentHost, command: str, spec: dict[str, Any], state: str, code: int, detail: str, given_up: bool
) -> None:
    """With ``restart: never`` unless the spec differs: only then, or in a crash loop, is a failure final."""
    host.start("work", command, **spec)
    entry = host.until("work", state)
    assert (entry["exit_code"], entry["detail"], entry["pid"], entry["given_up"]) == (
        code,
        detail,
        0,
        given_up,
    )
    assert 0.0 <= entry["ended_s"] < 600.0
    assert not lockfile.is_lock_held(str(host.folder("work")))


def test_a_command_that_dies_early_never_counts_as_up(host: AgentHost) -> None:
    """And one that lives does so when its time has passed, not before."""
    for task, command in (("dies", "sleep 0.4; exit 3"), ("lives", "exec sleep 600")):
        host.start(task, command)

    def wait(task: str, timeout_s: float, up_s: float) -> dict[str, Any]:
        return host.ask("wait", task=task, instance="i1", timeout_s=timeout_s, up_s=up_s)

    dead = wait("dies", 30.0, 60.0)
    assert (dead["state"], dead["exit_code"], dead["settled"]) == ("failed", 3, False)
    early = wait("lives", 0.0, 600.0)
    assert (early["state"], early["settled"]) == ("running", False)
    up_s = early["age_s"] + 0.3
    late = wait("lives", 30.0, up_s)
    assert (late["state"], late["settled"], late["age_s"] >= up_s) == ("running", True, True)
    host.stop("lives")


def test_an_end_in_the_future_is_reported_as_now(host: AgentHost) -> None:
    """The manager rejects a negative age, and with it the whole reply."""
    host.start("work", "exit 0", kind="job")
    host.until("work", "completed")
    path = str(host.folder("work") / "status")
    records.write_record(path, {**records.read_record(path), "ended": proc.read_uptime_s() + 600.0})
    entry = host.entry("work")
    assert entry is not None
    assert entry["ended_s"] == 0.0


def test_completed_job_is_not_run_twice_by_a_repeated_start(host: AgentHost, tmp_path: Path) -> None:
    command = f"echo ran >> {tmp_path}/runs"
    host.start("work", command, kind="job")
    host.until("work", "completed")
    assert host.start("work", command, kind="job")["state"] == "already-running"
    assert host.start("work", command, kind="job", instance="i2")["state"] == "started"
    eventually(lambda: (tmp_path / "runs").read_text() == "ran\nran\n")
    host.until("work", "completed")


def test_failed_run_is_restarted_after_a_pause(host: AgentHost, tmp_path: Path) -> None:
    command = f"test -e {tmp_path}/once && exec sleep 600; touch {tmp_path}/once; exit 7"
    host.start("slam", command, restart="on-failure")
    waiting = eventually(lambda: e if (e := host.entry("slam")) and "restarting" in e["detail"] else None)
    assert (waiting["state"], waiting["exit_code"], waiting["pid"]) == (
        "starting",
        7,
        host.supervisor("slam"),
    )
    entry = host.until("slam", "running")
    assert (entry["restarts"], entry["exit_code"]) == (1, None)
    assert host.stop("slam")["state"] == "stopped"


def test_digests_of_the_spec_and_the_last_exit_are_reported(host: AgentHost, tmp_path: Path) -> None:
    command = f"test -e {tmp_path}/once && exec sleep 600; touch {tmp_path}/once; exit 7"
    host.start("slam", command, restart="on-failure", fields={"command": "0a1b2c3d", "env": "00000000"})
    entry = host.until("slam", "running")
    entry = eventually(lambda: e if (e := host.entry("slam")) and e["restarts"] else None)
    assert entry["fields"] == {"command": "0a1b2c3d", "env": "00000000"}
    assert (entry["exit_code"], entry["last_exit"], entry.get("log_tail")) == (None, 7, None)
    host.stop("slam")


def test_stop_during_the_pause_cancels_the_restart(host: AgentHost) -> None:
    host.start("slam", "exit 1", restart="always")
    eventually(lambda: "restarting" in (host.entry("slam") or {"detail": ""})["detail"])
    assert host.stop("slam")["state"] == "stopped"
    assert host.entry("slam") is None


def test_leftovers_of_an_ended_run_are_cleared(host: AgentHost, tmp_path: Path) -> None:
    host.start("slam", f"setsid sleep 611 & until test -e {tmp_path}/seen; do sleep 0.05; done; exit 1")
    left = eventually(
        lambda: [pid for pid in host.members("slam") if proc.read_cmdline(pid) == ["sleep", "611"]]
    )
    (tmp_path / "seen").touch()
    host.until("slam", "failed")
    assert not is_running(left[0])


def test_ready_check_makes_a_task_ready(host: AgentHost, tmp_path: Path) -> None:
    ready = {"command": f"test -e {tmp_path}/up", "timeout_s": 20}
    host.start("slam", "exec sleep 600", ready=ready)
    waiting = host.ask("wait", task="slam", instance="i1", timeout_s=0.5)
    assert waiting["state"] == "starting"
    (tmp_path / "up").touch()
    assert host.ask("wait", task="slam", instance="i1", timeout_s=30)["state"] == "ready"
    host.stop("slam")


def test_mark_makes_a_task_ready(host: AgentHost) -> None:
    host.start("slam", "exec sleep 600")
    assert host.ask("mark", task="slam", instance="i1", ready=True)["state"] == "ready"
    entry = host.entry("slam")
    assert entry is not None
    assert entry["state"] == "ready"
    with pytest.raises(RefusedError, match="instance i0 of slam is not running here"):
        host.ask("mark", task="slam", instance="i0", ready=True)
    host.stop("slam")


def test_wait_returns_at_once_for_what_failed_or_is_gone(host: AgentHost) -> None:
    host.start("slam", "exit 4")
    failed = host.ask("wait", task="slam", instance="i1", timeout_s=10)
    assert (failed["state"], failed["exit_code"]) == ("failed", 4)
    gone = host.ask("wait", task="slam", instance="i9", timeout_s=10)
    assert (gone["state"], gone["detail"]) == ("failed", "not on this host")


def test_ros_preset_interrupts_the_command_behind_its_shell_only(host: AgentHost, tmp_path: Path) -> None:
    """A shell that waits for a command does not forward INT, and a node must not get it before its launcher."""
    program = f"""
import signal, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import signal,time;signal.signal(2,lambda *_:open({str(tmp_path / "bad")!r},'w'));time.sleep(600)"])
def end(*_):
    child.terminate(); child.wait(); print("clean end", flush=True); sys.exit(0)
signal.signal(signal.SIGINT, end)
print("up", flush=True)
time.sleep(600)
"""
    command = python(program, tmp_path).removeprefix("exec ") + "; true"
    host.start("nav", command, prelude="export X=1", stop={"signal": None, "grace_s": None, "preset": "ros"})
    eventually(lambda: "up" in host.ask("logs", task="nav", tail=5)["text"])
    stopped = host.stop("nav")
    assert stopped["state"] == "stopped"
    assert stopped["seconds"] < 15, "INT was enough: TERM comes after 20 s"
    assert "clean end" in host.ask("logs", task="nav", tail=5)["text"]
    assert not (tmp_path / "bad").exists()


def test_stopped_process_can_still_be_stopped(host: AgentHost) -> None:
    pid = host.start("slam", "exec sleep 600")["pid"]
    os.kill(pid, signal.SIGSTOP)
    os.kill(host.supervisor("slam"), signal.SIGSTOP)
    assert host.stop("slam")["state"] == "stopped"
    assert not is_running(pid)


def test_start_that_cannot_be_is_refused_with_the_reason(host: AgentHost) -> None:
    with pytest.raises(RefusedError, match="/no/such/folder: No such file or directory"):
        host.start("slam", "exec sleep 600", workdir="/no/such/folder")
    with pytest.raises(RefusedError, match="not a name"):
        host.start("../slam", "exec sleep 600")
    assert host.start("slam", "exec sleep 600")["state"] == "started"
    host.stop("slam")


def test_home_that_cannot_be_written_falls_back_to_shared_memory(
    host: AgentHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    if host.runtime == "systemd" and os.geteuid() != 0:
        pytest.skip(
            "without root, the stub of systemd makes us root of a namespace, with another user's directory in shared memory"
        )
    monkeypatch.setenv("EDGECTL_STATE_DIR", "/proc/nowhere")
    fallback = Path(f"/dev/shm/edgectl-{os.geteuid()}")
    host.name, host.state = f"test-{os.getpid()}", fallback
    with shared_memory():
        try:
            pid = host.start("slam", "exec sleep 600")["pid"]
            assert stat.S_IMODE(fallback.stat().st_mode) == 0o700
            assert host.start("slam", "exec sleep 600", instance="i2")["pid"] == pid
            assert host.stop("slam")["state"] == "stopped"
        finally:
            for path in sorted(host.home.rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
            host.home.rmdir()
