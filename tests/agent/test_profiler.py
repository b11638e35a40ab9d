# SPDX-License-Identifier: Apache-2.0
"""Resident profiler: one per host, cheap, never a task; probes that read it; every cause of its end."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.daemon import daemon, pidfile, sample_ring
from edgectl.agent.measure import proc, system_files, task
from edgectl.agent.supervise import liveness, state_dir
from edgectl.errors import RefusedError
from tests.agent.conftest import Profiled, eventually, is_running
from tests.agent.test_probe import build_links, connected, interpreters, sent

LINKS = build_links(41)
ROBOT = LINKS[0]["address"]

MOST_BYTES = 20 << 20


# -- hand-worked numbers --


def test_the_weight_of_a_reading_knows_how_much_time_it_covers() -> None:
    assert daemon.compute_weight(1.0, 1.0) == pytest.approx(0.3)
    assert daemon.compute_weight(2.0, 1.0) == pytest.approx(0.51)  # 1 - .7 * .7
    assert daemon.compute_weight(5.0, 5.0) == pytest.approx(0.3)
    assert daemon.compute_weight(0.0, 1.0) == 0.0


def test_readings_are_smoothed_by_hand_worked_numbers() -> None:
    first = daemon.smooth_values(None, {"cpu": 10.0, "links": {"robot1": {"rx": 100.0, "rtt_ms": None}}}, 1.0)
    after_1s = daemon.smooth_values(
        first, {"cpu": 20.0, "links": {"robot1": {"rx": 0.0, "rtt_ms": 4.0}}}, daemon.compute_weight(1.0, 1.0)
    )
    assert after_1s == {
        "cpu": pytest.approx(13.0),
        "links": {"robot1": {"rx": pytest.approx(70.0), "rtt_ms": 4.0}},
    }
    after_3s = daemon.smooth_values(
        after_1s, {"cpu": 20.0, "links": {}, "new": 5.0}, daemon.compute_weight(2.0, 1.0)
    )
    assert after_3s == {"cpu": pytest.approx(13.0 + 0.51 * 7.0), "links": {}, "new": 5.0}


def test_a_sample_in_two_halves_weighs_as_much_as_one() -> None:
    half = daemon.compute_weight(0.5, 1.0)
    twice = daemon.smooth_values(daemon.smooth_values(10.0, 20.0, half), 20.0, half)
    assert twice == pytest.approx(daemon.smooth_values(10.0, 20.0, daemon.compute_weight(1.0, 1.0)))


def a_process(pid: int, *, cpu_s: float, age_s: float) -> proc.Process:
    field = [b"0"] * 22
    field[0], field[1] = b"S", b"1"
    field[11] = b"%d" % round(cpu_s * system_files.TICKS_PER_S)
    field[19] = b"%d" % round((proc.read_uptime_s() - age_s) * system_files.TICKS_PER_S)
    return proc.Process(pid, field)


def test_a_process_that_comes_into_view_brings_no_more_than_its_average() -> None:
    # Numbers that no process has: of others the kernel knows the time better.
    old, new = 1 << 23, (1 << 23) + 1
    table = {old: a_process(old, cpu_s=6.0, age_s=100.0), new: a_process(new, cpu_s=50.0, age_s=100.0)}
    now = task.collect_cpu_s(task.TaskProcesses({old, new}, 0, {}), table)
    # 2 s for the known process, and half a core for the one that has run for 100 s.
    assert task.compute_cores(now, table, {old: 4.0}, 1.0) == pytest.approx(2.5, abs=0.01)
    young = {old: a_process(old, cpu_s=0.5, age_s=0.5)}
    found = task.compute_cores(task.collect_cpu_s(task.TaskProcesses({old}, 0, {}), young), young, {}, 1.0)
    assert found == pytest.approx(0.5, abs=0.02)


def test_the_ring_is_bounded_and_gives_the_newest_whole_sample(tmp_path: Path) -> None:
    fd = sample_ring.create_ring(str(tmp_path))
    try:
        assert (sample_ring.read_newest(fd), sample_ring.read_description(fd)) == ((0, {}), {})
        sample_ring.write_description(fd, {"pid": 7})
        for number in range(1, 3 * sample_ring.MAX_SAMPLES):
            sample_ring.write_sample(fd, number, {"at": number, "long": "x" * (9000 if number < 100 else 1)})
        size = os.fstat(fd).st_size
        assert size == sample_ring.SLOT_BYTES * (1 + sample_ring.MAX_SAMPLES)
        assert sample_ring.read_newest(fd) == (
            3 * sample_ring.MAX_SAMPLES - 1,
            {"at": 3 * sample_ring.MAX_SAMPLES - 1, "long": "x"},
        )
        os.pwrite(
            fd,
            b"#",
            sample_ring.SLOT_BYTES * (1 + (3 * sample_ring.MAX_SAMPLES - 1) % sample_ring.MAX_SAMPLES) + 40,
        )  # a partly written slot
        assert sample_ring.read_newest(fd)[0] == 3 * sample_ring.MAX_SAMPLES - 2
        with pytest.raises(ValueError, match="too long"):
            sample_ring.write_sample(fd, 1, {"long": "x" * sample_ring.SLOT_BYTES})
        assert sample_ring.read_description(fd) == {"pid": 7}
        assert list(tmp_path.iterdir()) == [], "it has no name"
    finally:
        os.close(fd)


# -- probes --


def test_a_probe_reads_the_profiler_instead_of_waiting(profiled: Profiled) -> None:
    plain = profiled.host.ask("probe", window_s=0.05, links=LINKS)
    assert profiled.start(links=LINKS)["state"] == "started"
    found = profiled.probe(links=LINKS)
    assert set(found) - set(plain) == {"resident", "sample_age_s"}
    assert set(plain) <= set(found)
    assert 0.0 <= found["sample_age_s"] < 3.0
    assert found["cpu"]["cores"] == plain["cpu"]["cores"]
    assert found["memory"]["total_bytes"] == plain["memory"]["total_bytes"]
    assert set(found["interfaces"]) == set(plain["interfaces"])
    assert [(link["reachable"], link["interface"]) for link in found["links"].values()] == [(True, "lo")] * 2


def test_tasks_are_as_they_are_now_however_old_the_sample(profiled: Profiled) -> None:
    host = profiled.host
    profiled.start()
    profiled.probe()
    started = host.start("slam", f"exec {sys.executable} -c 'while True: pass'")
    young = profiled.probe()["tasks"]["slam"]
    assert (young["state"], young["pid"]) == ("running", started["pid"])
    busy = eventually(
        lambda: found if (found := profiled.probe())["tasks"]["slam"]["used_cores"] > 0.02 else None,
        seconds=30,
    )
    assert busy["cpu"]["used_cores"] >= busy["tasks"]["slam"]["used_cores"]
    eventually(lambda: profiled.probe()["tasks"]["slam"]["used_bytes"] > 1 << 20, seconds=30)
    os.kill(started["pid"], signal.SIGKILL)
    host.until("slam", "failed")
    failed = profiled.probe()["tasks"]["slam"]
    assert (failed["state"], failed["used_cores"], failed["used_bytes"], failed["links"]) == (
        "failed",
        0.0,
        0,
        {},
    )
    host.stop("slam")
    assert profiled.probe()["tasks"] == {}
    assert is_running(profiled.holders()[0]), "stopping a task is no concern of the profiler"


def test_traffic_of_links_and_tasks_is_seen(profiled: Profiled) -> None:
    profiled.start(every=0.5, links=LINKS)
    over = threading.Event()
    program = f"import socket; s = socket.create_connection(('{ROBOT}', %d)); [s.sendall(bytes(10000)) for _ in iter(lambda: __import__('time').sleep(.05), 1)]"
    with socket.create_server((ROBOT, 0)) as server, connected(LINKS[1]["address"]) as (near, far):
        profiled.host.start("slam", f'exec {sys.executable} -c "{program % server.getsockname()[1]}"')
        peer, _ = server.accept()

        def carry() -> None:
            while not over.wait(0.02):
                sent(near, far, 4_000)

        threads = [
            threading.Thread(target=carry),
            threading.Thread(target=lambda: [None for _ in iter(lambda: peer.recv(1 << 16), b"")]),
        ]
        for thread in threads:
            thread.start()

        def seen() -> dict[str, Any] | None:
            found = profiled.probe(links=LINKS)
            links, entry = found["links"], found["tasks"]["slam"]
            there = entry["links"].get("robot1", 0.0) > 1e3 and links["robot2"]["tx_bytes_per_s"] > 1e3
            return (
                found if there and links["robot1"]["tx_bytes_per_s"] >= entry["tx_bytes_per_s"] - 1 else None
            )

        try:
            eventually(seen, seconds=30)
        finally:
            over.set()
            profiled.host.stop("slam")
            for thread in threads:
                thread.join()
            peer.close()


def test_checks_run_and_detected_tasks_are_found(profiled: Profiled) -> None:
    mark = f"{os.getpid()}.7531"
    spec: dict[str, Any] = {"detect": [{"task": "found", "cmdline": f"^sleep {mark}$"}]}
    profiled.start(**spec)
    assert profiled.probe(**spec)["tasks"] == {}
    for _ in range(2):
        process = subprocess.Popen(["sleep", mark])
        try:
            checks = [
                {"task": "found", "command": "exit 3", "timeout_s": 20},
                {"task": "gone", "command": "exit 0", "timeout_s": 20},
            ]
            found = profiled.probe(checks=checks, **spec)
            assert (found["tasks"]["found"]["pid"], found["tasks"]["found"]["managed"]) == (
                process.pid,
                False,
            )
            assert {name: result["exit"] for name, result in found["checks"].items()} == {"found": 3}
        finally:
            process.kill()
            process.wait()


def test_metrics_of_the_application_are_as_they_are_now(profiled: Profiled, tmp_path: Path) -> None:
    profiled.start()
    profiled.probe()
    profiled.host.start(
        "slam", f'echo "fps 1" >>"$EDGECTL_METRICS"; echo "$EDGECTL_METRICS" >{tmp_path}/path; exec sleep 600'
    )
    file = Path(
        eventually(lambda: ((tmp_path / "path").exists() and (tmp_path / "path").read_text().strip()) or None)
    )
    assert profiled.probe()["tasks"]["slam"]["metrics"] == {"fps": 1.0}
    with file.open("a") as lines:
        lines.write("fps 2\nloss 0.5\n")
    assert profiled.probe()["tasks"]["slam"]["metrics"] == {"fps": 2.0, "loss": 0.5}
    profiled.host.stop("slam")


def test_a_directory_that_others_may_write_is_not_believed(
    profiled: Profiled, monkeypatch: pytest.MonkeyPatch
) -> None:
    profiled.start()
    profiled.probe()
    monkeypatch.setattr(state_dir, "BASES", [str(profiled.host.state)])
    monkeypatch.setattr(state_dir, "_FLEET", [profiled.host.fleet])
    profiled.folder.chmod(0o770)
    assert pidfile.find_profiler("edge1") is None
    assert "resident" not in profiled.host.ask("probe", window_s=0.05)
    profiled.folder.chmod(0o700)
    assert pidfile.find_profiler("edge1") is not None


def test_only_the_same_probe_spec_is_served(profiled: Profiled) -> None:
    profiled.start(links=LINKS)
    profiled.probe(links=list(reversed(LINKS)))
    assert "resident" not in profiled.host.ask("probe", window_s=0.05, links=LINKS[:1])
    assert profiled.status(links=LINKS)["current"] is True
    assert profiled.status(links=LINKS[:1])["current"] is False


# -- one per host, cheap, no task --


def test_starts_at_the_same_time_make_one(profiled: Profiled) -> None:
    profiled.host.ask("status", task=None)  # puts the agent on the host
    with ThreadPoolExecutor(4) as pool:
        reply = list(pool.map(lambda _: profiled.start(), range(6)))
    assert sorted(each["state"] for each in reply) == ["already-running"] * 5 + ["started"]
    assert {each["pid"] for each in reply} == set(profiled.holders())


def test_another_probe_spec_replaces_it(profiled: Profiled) -> None:
    first = profiled.start(links=LINKS)
    assert profiled.start(links=list(reversed(LINKS)))["state"] == "already-running"
    changes: tuple[dict[str, Any], ...] = ({"every": 0.5}, {"ttl": 60.0}, {"links": LINKS[:1]})
    for change in changes:
        reply = profiled.start(**{"links": LINKS, **change})
        assert reply["state"] == "replaced"
        assert profiled.holders() == [reply["pid"]]
    assert not is_running(first["pid"])


def test_it_is_no_task_and_writes_nothing_to_the_disk(profiled: Profiled) -> None:
    pid = profiled.start(every=0.1)["pid"]
    assert liveness.has_cookie(pid), "no detect matches it"
    assert profiled.host.ask("status", task=None)["tasks"] == {}
    first = profiled.sampled(3)
    written = {path.name: path.stat().st_mtime_ns for path in profiled.folder.iterdir()}
    open_files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    later = profiled.sampled(first["samples"] + 10)
    assert {path.name: path.stat().st_mtime_ns for path in profiled.folder.iterdir()} == written
    assert set(written) == {"lock", "record"}
    assert len(list(Path(f"/proc/{pid}/fd").iterdir())) <= open_files + 2
    assert later["used_bytes"] < MOST_BYTES
    assert (later["pid"], later["state"]) == (pid, "running")


@pytest.mark.parametrize(
    "python", interpreters()[:2][-1:], ids=lambda path: "-".join(Path(path).parts[-3::2])
)
def test_it_runs_on_the_oldest_python(profiled: Profiled, python: str) -> None:
    profiled.host.session.python = python
    profiled.start(links=LINKS)
    assert profiled.probe(links=LINKS)["links"]["robot1"]["reachable"] is True


# -- end --


def test_stop_is_proven_and_a_second_one_has_nothing_to_do(profiled: Profiled) -> None:
    pid = profiled.start()["pid"]
    os.kill(pid, signal.SIGSTOP)
    assert profiled.host.ask("profiler-stop") == {"state": "stopped", "pid": pid}
    assert not is_running(pid)
    assert profiled.host.ask("profiler-stop") == {"state": "not-running", "pid": 0}
    assert profiled.status() == {"state": "not-running", "pid": 0, "detail": ""}


def test_without_a_fresh_sample_a_window_is_measured(profiled: Profiled) -> None:
    pid = profiled.start(every=0.1)["pid"]
    profiled.sampled(1)
    os.kill(pid, signal.SIGSTOP)
    assert eventually(lambda: (reply := profiled.status())["state"] == "stalled" and reply)["pid"] == pid
    assert "resident" not in profiled.host.ask("probe", window_s=0.05)
    os.kill(pid, signal.SIGKILL)
    eventually(lambda: not is_running(pid))
    assert "resident" not in profiled.host.ask("probe", window_s=0.05)
    assert profiled.status()["detail"] == "it was killed"
    assert profiled.start()["state"] == "started"


def test_it_ends_when_no_manager_calls(profiled: Profiled) -> None:
    pid = profiled.start(every=0.1, ttl=1.0)["pid"]
    eventually(lambda: not is_running(pid), seconds=30)
    assert profiled.status()["detail"] == "no edgectl called for 1 s"


def test_it_ends_when_its_directory_is_removed(profiled: Profiled) -> None:
    pid = profiled.start(every=0.1)["pid"]
    shutil.rmtree(profiled.host.state)
    eventually(lambda: not is_running(pid), seconds=30)
    assert profiled.start()["state"] == "started"


def test_a_host_that_was_rebooted_has_none(profiled: Profiled, monkeypatch: pytest.MonkeyPatch) -> None:
    profiled.start()
    monkeypatch.setattr(state_dir, "BASES", [str(profiled.host.state)])
    monkeypatch.setattr(state_dir, "_FLEET", [profiled.host.fleet])
    assert pidfile.find_profiler("edge1") is not None
    monkeypatch.setattr(system_files, "read_boot_id", lambda: "another boot")
    assert pidfile.find_profiler("edge1") is None
    assert pidfile.read_end_reason("edge1") == "the host was rebooted"


def test_concurrent_starts_with_other_specs_leave_one(profiled: Profiled) -> None:
    profiled.start()

    def start(number: int) -> int:
        try:
            return int(profiled.start(ttl=600.0 + number % 2)["pid"])
        except RefusedError:  # replaced by the others repeatedly
            return 0

    with ThreadPoolExecutor(4) as pool:
        pids = set(pool.map(start, range(6)))
    (pid,) = profiled.holders()
    assert pids - {0}
    assert profiled.status()["pid"] == pid
    assert not any(is_running(other) for other in pids - {0, pid})
