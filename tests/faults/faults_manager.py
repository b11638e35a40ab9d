# SPDX-License-Identifier: Apache-2.0
"""Faults of the manager: killed, interrupted, run twice, wrong clock, damaged files."""

import datetime as dt
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tests.faults.command_result import ExpectationError
from tests.faults.faults_host import start_tasks
from tests.faults.faults_link import prepare_changes
from tests.faults.fleet import APPLY, FaultFleet
from tests.faults.registry import fault
from tests.faults.synced_disk import record_all, restore_synced_files
from tests.pace import patience

SKEW = Path(__file__).with_name("skew.c")


def kill_manager(running: "subprocess.Popen[str]") -> None:
    """Kill edgectl and its child processes with SIGKILL."""
    with suppress(ProcessLookupError):
        os.killpg(running.pid, signal.SIGKILL)
    running.communicate()


def interrupt_at_random(fleet: FaultFleet, strike: Callable[["subprocess.Popen[str]"], None]) -> None:
    """Start an apply and run ``strike`` at a random moment."""
    running = fleet.start_edgectl(*APPLY)
    fleet.wait(fleet.random.uniform(0.3, 2.6))
    strike(running)


@fault("manager killed (kill -9) at a random moment", full=25)
def kill_at_random(fleet: FaultFleet) -> None:
    prepare_changes(fleet)
    interrupt_at_random(fleet, kill_manager)


@fault("manager killed again during recovery", full=10)
def kill_twice(fleet: FaultFleet) -> None:
    prepare_changes(fleet)
    interrupt_at_random(fleet, kill_manager)
    interrupt_at_random(fleet, kill_manager)


@fault("manager killed while a start-first move runs", full=8)
def kill_during_start_first(fleet: FaultFleet) -> None:
    """A start-first move may run two copies at once, so an overlap is allowed here; one copy is left after
    the recovery.
    """
    fleet.add_task("slam", on=fleet.first, handoff={"order": "start-first"})
    fleet.apply_and_check()
    fleet.overlap_allowed.add("slam")
    fleet.pin_task("slam", fleet.second)
    interrupt_at_random(fleet, kill_manager)


def build_synced_disk_env(fleet: FaultFleet) -> dict[str, str]:
    """Environment in which edgectl's disk keeps only synced data; see `synced_disk`."""
    place = fleet.directory / "synced-disk"
    (place / "shadow").mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(restore_synced_files.__code__.co_filename), place / "sitecustomize.py")
    path = f"{place}:{fleet.code}" if fleet.code else str(place)
    return {
        "PYTHONPATH": path,
        "SYNCED_DISK_SHADOW": str(place / "shadow"),
        "SYNCED_DISK_ROOT": str(fleet.state),
    }


@fault("manager loses power after done", full=3)
def cut_power_after_done(fleet: FaultFleet) -> None:
    """The effect of a command that exited with 0 is on the disk: a task marked done is not started again."""
    fleet.add_task("slam", on=fleet.first)
    fleet.add_task("nav", on=fleet.second)
    fleet.apply(**build_synced_disk_env(fleet)).expect_exit(0)
    fleet.check_verdict()
    fleet.run_edgectl("done", "slam", **build_synced_disk_env(fleet)).expect_exit(0)
    restore_synced_files(fleet.directory / "synced-disk" / "shadow", fleet.state)
    del fleet.expected["slam"]
    fleet.apply().expect_exit(0)
    fleet.check_verdict()


@fault("manager loses power at a random moment", full=8)
def cut_power_at_random(fleet: FaultFleet) -> None:
    prepare_changes(fleet)
    env = build_synced_disk_env(fleet)
    # What the apply before has left was written seconds ago by a process without this disk.
    record_all(fleet.directory / "synced-disk" / "shadow", fleet.state)
    running = fleet.start_edgectl(*APPLY, **env)
    fleet.wait(fleet.random.uniform(0.5, 2.6))
    kill_manager(running)
    restore_synced_files(fleet.directory / "synced-disk" / "shadow", fleet.state)


@fault("manager interrupted (Ctrl-C once, or twice)", full=8)
def send_sigint(fleet: FaultFleet) -> None:
    prepare_changes(fleet)

    def interrupt(running: "subprocess.Popen[str]") -> None:
        for _ in range(fleet.random.choice([1, 2])):
            with suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGINT)
            time.sleep(0.1)
        fleet.wait_for_edgectl(running).expect_exit(0, 4, 130, within=60)

    interrupt_at_random(fleet, interrupt)


@fault("state directory lost", full=3)
def delete_state(fleet: FaultFleet) -> None:
    """The hosts hold the state: nothing is restarted and nothing runs twice."""
    start_tasks(fleet)
    before = {task: fleet.count_launches(task) for task in fleet.expected}
    fleet.pin_task("slam", fleet.first)
    fleet.state.rename(fleet.state.with_name("old-state"))
    fleet.apply().expect_exit(0)
    if before != {task: fleet.count_launches(task) for task in fleet.expected}:
        raise ExpectationError("a task was started again")
    fleet.check_verdict()


@fault("two applies at once", full=8)
def run_two_applies(fleet: FaultFleet) -> None:
    prepare_changes(fleet)
    both = []
    for _ in range(2):
        both.append(fleet.start_edgectl(*APPLY))
        fleet.wait(fleet.random.uniform(0, 0.4))
    codes = sorted(fleet.wait_for_edgectl(running).expect_exit(0, 75).code for running in both)
    if codes == [75, 75]:
        raise ExpectationError("both refused to work")


@fault("a saved plan applied twice, and after a change", full=3)
def apply_stale_plan(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    plan = str(fleet.directory / "saved.plan")
    fleet.pin_task("slam", fleet.second)
    fleet.run_edgectl("plan", "--out", plan).expect_exit(0, 2)
    fleet.run_edgectl("apply", plan).expect_exit(0)
    fleet.check_verdict()
    fleet.run_edgectl("apply", plan).expect_exit(75)
    fleet.pin_task("slam", fleet.first)
    fleet.run_edgectl("plan", "--out", plan).expect_exit(0, 2)
    fleet.add_task("late", on=fleet.first)
    fleet.run_edgectl("apply", plan).expect_exit(75)
    fleet.check_verdict({"slam": fleet.second, "nav": fleet.second, "grip": fleet.third})


HOUR, DAY = 3600, 86400


def find_missing_compiler() -> str:
    return "" if shutil.which("cc") else "no C compiler for the skewed clock"


def build_skewed_env(fleet: FaultFleet, seconds: int) -> dict[str, str]:
    """Environment whose wall clock is off by ``seconds``; the monotonic clock stays true."""
    library = fleet.directory / "skew.so"
    if not library.exists():
        subprocess.run(
            ["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(SKEW)], check=True, timeout=patience(60)
        )
    return {"LD_PRELOAD": str(library), "CLOCK_SKEW": str(seconds)}


def skew_host(fleet: FaultFleet, name: str, seconds: int) -> None:
    """Skew the host's wall clock: its users' processes preload the library from a world-readable path."""
    environment = build_skewed_env(fleet, seconds)
    host = fleet.hosts[name]
    shutil.copy(environment["LD_PRELOAD"], host.records / "skew.so")
    inside = host.records if host.kind == "loopback" else Path("/home/edge/oracle/records")
    host.set_env(**environment | {"LD_PRELOAD": str(inside / "skew.so")})


@fault("clocks an hour apart", full=4, missing=find_missing_compiler)
def skew_all_clocks(fleet: FaultFleet) -> None:
    """One host an hour ahead, one ten years behind, the manager a day ahead: clocks are never compared."""
    start_tasks(fleet)
    skew_host(fleet, fleet.first, fleet.random.choice([HOUR, -HOUR]))
    skew_host(fleet, fleet.second, fleet.random.choice([-3650 * DAY, 3650 * DAY]))
    fleet.pin_task("slam", fleet.second)
    fleet.add_task("map", on=fleet.first)
    # On the host, also where the task runs in a container.
    fleet.tasks["map"]["ready"] = {"command": 'date +%s > "$HOME/oracle/records/date"'}
    fleet.write_files()
    fleet.apply(**build_skewed_env(fleet, DAY)).expect_exit(0)
    fleet.check_verdict()
    assert abs(int((fleet.hosts[fleet.first].records / "date").read_text()) - time.time()) > HOUR / 2, (
        "the host's clock was not skewed"
    )
    fleet.run_edgectl("status").expect_exit(0)
    check_ages(fleet)


def check_ages(fleet: FaultFleet) -> None:
    snapshot = fleet.run_edgectl("probe", "-o", "json").expect_exit(0).data
    taken = dt.datetime.fromisoformat(str(snapshot["taken_at"]))
    hosts = snapshot["hosts"]
    assert isinstance(hosts, dict)
    for name, host in hosts.items():
        for task, sample in host["tasks"].items():
            age = (taken - dt.datetime.fromisoformat(sample["started_at"])).total_seconds()
            if not -1 < age < 300:
                raise ExpectationError(f"{task} on {name} is {age} s old")


@fault("manager's clock goes backwards between applies", full=3, missing=find_missing_compiler)
def set_clock_back(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    launches = fleet.count_launches("slam")
    fleet.pin_task("slam", fleet.first)
    for seconds in (2 * HOUR, -2 * HOUR, -30 * DAY):
        fleet.apply(**build_skewed_env(fleet, seconds)).expect_exit(0)
    if fleet.count_launches("slam") != launches:
        raise ExpectationError("slam was started again")
    fleet.pin_task("slam", fleet.second)
    fleet.apply(**build_skewed_env(fleet, -HOUR)).expect_exit(0)
    fleet.check_verdict()


@fault("state files truncated", full=12)
def truncate_state(fleet: FaultFleet) -> None:
    damage_state_file(fleet, lambda data: data[: fleet.random.randrange(len(data))])


@fault("state files with a flipped bit", full=12)
def flip_state_bit(fleet: FaultFleet) -> None:
    def flip(data: bytes) -> bytes:
        place = fleet.random.randrange(len(data))
        return data[:place] + bytes([data[place] ^ (1 << fleet.random.randrange(8))]) + data[place + 1 :]

    damage_state_file(fleet, flip)


def damage_state_file(fleet: FaultFleet, harm: Callable[[bytes], bytes]) -> None:
    """Damage one of the manager's files. Apply must exit with a documented code, and no task is lost or
    doubled.
    """
    start_tasks(fleet)
    fleet.pin_task("slam", fleet.first)
    files = sorted(path for path in fleet.state.rglob("*") if path.is_file() and path.stat().st_size)
    victim = fleet.random.choice(files)
    good = victim.read_bytes()
    victim.write_bytes(harm(good))
    outcome = fleet.apply().expect_exit(0, 1, 4, 64)
    fleet.check_verdict()
    if outcome.code in (1, 64):
        outcome.expect_output(victim.name)
        follow_hint(fleet, victim)


def follow_hint(fleet: FaultFleet, victim: Path) -> None:
    """Follow the hint for an unreadable file: move it away."""
    victim.rename(fleet.directory / "tmp" / victim.name)


def set_future_version(document: bytes) -> bytes:
    return re.sub(rb'"format_version": ?\d+', b'"format_version": 99', document)


@fault("state files of a future format_version", full=3)
def write_future_state(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.pin_task("slam", fleet.first)
    changed = []
    for path in sorted(fleet.state.rglob("*")):
        if path.is_file() and b'"format_version":' in (data := path.read_bytes()):
            path.write_bytes(set_future_version(data))
            changed.append(path)
    assert changed, "no state file has a format_version"
    fleet.apply().expect_exit(1, 64).expect_output("newer edgectl")
    fleet.check_verdict()
    for path in changed:
        follow_hint(fleet, path)


@fault("saved snapshot and plan damaged", full=3)
def damage_saved_files(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.pin_task("slam", fleet.second)
    snapshot, plan = fleet.directory / "saved.json", fleet.directory / "saved.plan"
    fleet.run_edgectl("probe", "--out", str(snapshot)).expect_exit(0)
    fleet.run_edgectl("plan", "--out", str(plan)).expect_exit(0, 2)
    for path, words in ((snapshot, ("plan", "--snapshot")), (plan, ("apply",))):
        good = path.read_bytes()
        for _ in range(3):
            path.write_bytes(good[: fleet.random.randrange(len(good) - 2)])
            fleet.run_edgectl(*words, str(path)).expect_exit(64, 1, 75)
        path.write_bytes(set_future_version(good))
        fleet.run_edgectl(*words, str(path)).expect_exit(64, 1, 75).expect_output("version")
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})


@fault("state directory not writable", full=2)
def block_state_dir(fleet: FaultFleet) -> None:
    """A file stands in place of the state directory: the command is refused before any host is contacted."""
    fleet.add_task("slam", on=fleet.first)
    aside = fleet.state.rename(fleet.state.with_name("aside"))
    fleet.state.write_text("in the way")
    fleet.apply().expect_exit(1, 64)
    fleet.check_verdict({})
    fleet.state.unlink()
    aside.rename(fleet.state)
