# SPDX-License-Identifier: Apache-2.0
"""Faults of hosts: power, reboot, disk, mounts, Python, login."""

import shutil
from pathlib import Path

from tests.faults import oracle
from tests.faults.command_result import ExpectationError
from tests.faults.fleet import FaultFleet
from tests.faults.hosts import wait_for
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.registry import OWN, fault


def start_tasks(fleet: FaultFleet) -> None:
    """Start slam on the first host, nav on the second and grip on the third, then unpin slam."""
    for task, host in zip(("slam", "nav", "grip"), fleet.edges, strict=False):
        fleet.add_task(task, on=host)
    fleet.apply_and_check()
    fleet.pin_task("slam", None)


def check_held(fleet: FaultFleet, *words: str, within: float = 45) -> None:
    """The first host is unreachable: apply reports it in time, changes nothing else, and starts slam nowhere."""
    fleet.apply().expect_exit(4, within=within).expect_output(fleet.first, *words)
    alive = oracle.watch_launches(fleet.records, seconds=0.5, patience=12.0, expected=["nav", "grip"])
    running = {
        (task, life.host) for task, lives in alive.items() for life in lives if life.host != fleet.first
    }
    if running != {("nav", fleet.second), ("grip", fleet.third)}:
        raise ExpectationError(f"the other hosts run {sorted(running)}, wanted nav and grip only")


@fault("host powered off", quick=True, kinds=OWN, full=5)
def power_off_host(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.hosts[fleet.first].power_off()
    check_held(fleet, "does not answer")
    fleet.run_edgectl("status").expect_exit(4).expect_output(fleet.first)


@fault("host powered off in the middle of an apply", kinds=OWN, full=10)
def power_off_during_apply(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    victim = fleet.random.choice(fleet.edges)
    fleet.pin_task("slam", fleet.second)
    running = fleet.start_edgectl("apply", "--yes")
    wait_random_part(fleet, 2.2)
    fleet.hosts[victim].power_off()
    fleet.wait_for_edgectl(running).expect_exit(0, 4)


def wait_random_part(fleet: FaultFleet, seconds: float) -> None:
    """Sleep for a random part of ``seconds``."""
    fleet.wait(fleet.random.uniform(0, seconds))


@fault("sshd stopped, tasks keep running", full=2)
def stop_sshd(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.get_relay(fleet.first).set(LinkFault(kind=LinkFaultKind.REFUSE))
    check_held(fleet, within=25)
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})


@fault("authentication refused", quick=True, full=3)
def refuse_logins(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.hosts[fleet.first].allow_logins(allowed=False)
    check_held(fleet, fleet.first)
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})


@fault("host key changed", full=3)
def change_host_key(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.hosts[fleet.first].change_key()
    check_held(fleet, "key", within=25)
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})
    fleet.trust_host_keys()


@fault("host rebooted, old pids reused", quick=True, kinds=OWN, full=5)
def reboot_host(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    (slam,) = [life for life in oracle.list_lifetimes(fleet.records) if life.task == "slam"]
    computer = fleet.get_computer(fleet.first)
    pids = [inner for each in computer.processes() if (inner := computer.inner_pid(each))]
    computer.power_off()
    computer.boot()
    # Those that a task in a container knows are not those of its computer, whose engine has taken some again.
    known = [pid for pid in pids if not Path(f"/proc/{computer.pid}/root/proc/{pid}").exists()]
    for pid in sorted(known if computer.engine else {*pids, *slam.pids}):
        fleet.start_bystander(fleet.first, "recording_task.py", "--task", "slam", pid=pid)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()


@fault("host rebooted twice, once while apply works", kinds=OWN, full=5)
def reboot_during_apply(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    computer = fleet.get_computer(fleet.first)
    computer.power_off()
    computer.boot()
    running = fleet.start_edgectl("apply", "--yes")
    wait_random_part(fleet, 2.0)
    computer.power_off()
    computer.boot()
    fleet.wait_for_edgectl(running).expect_exit(0, 4)


@fault("disk full before the start", kinds=OWN, full=3)
def fill_disk_before_start(fleet: FaultFleet) -> None:
    """A full disk is reported with its reason or avoided (shared memory); the task is never half started."""
    fleet.get_computer(fleet.first).fill_disk()
    fleet.add_task("slam", on=fleet.first)
    fleet.add_task("nav", on=fleet.second)
    fleet.apply().expect_exit(0, 4)
    expected: dict[str, str | None] = {"nav": fleet.second}
    if "slam" in oracle.watch_launches(fleet.records, seconds=0.7):
        expected["slam"] = fleet.first
    fleet.check_verdict(expected)


@fault("disk full while the task runs", quick=True, kinds=OWN, full=3)
def fill_disk_during_run(fleet: FaultFleet) -> None:
    fleet.add_task("slam", "--spam", "200000", on=fleet.first, log={"max_size": "64Ki", "files": 2})
    fleet.add_task("job", "--for", "4", "--exit", "0", on=fleet.first, kind="job", restart="never")
    fleet.apply().expect_exit(0)
    fleet.get_computer(fleet.first).fill_disk()
    wait_for(lambda: fleet.has_stopped("job"), "the job's end", 45)
    del fleet.expected["job"]
    fleet.check_verdict()
    fleet.apply().expect_exit(0, 4)
    if fleet.count_launches("job") != 1:
        raise ExpectationError("the job ran twice: its exit code was lost on the full disk")


@fault("disk full while the task moves away", kinds=OWN, full=3)
def fill_disk_during_move(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.get_computer(fleet.first).fill_disk()
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()


@fault("home read-only before the start", kinds=OWN, full=3)
def lock_home_before_start(fleet: FaultFleet) -> None:
    fleet.get_computer(fleet.first).home_read_only(yes=True)
    fleet.add_task("slam", on=fleet.first)
    fleet.add_task("nav", on=fleet.second)
    fleet.apply().expect_exit(0, 4)
    expected: dict[str, str | None] = {"nav": fleet.second}
    if "slam" in oracle.watch_launches(fleet.records, seconds=0.7):
        expected["slam"] = fleet.first
    fleet.check_verdict(expected)


@fault("home read-only while the task moves", kinds=OWN, full=3)
def lock_home_during_move(fleet: FaultFleet) -> None:
    """Move back and forth with a read-only home, on the old host and on the new one."""
    start_tasks(fleet)
    fleet.get_computer(fleet.random.choice(fleet.edges[:2])).home_read_only(yes=True)
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(0, 4)
    verdict = fleet.judge_launches({**fleet.expected, "slam": None})
    if not verdict.clean:
        raise ExpectationError(f"refused, but not before the old instance was stopped: {verdict}")


@fault("no python3 on the host", kinds=OWN, full=2)
def hide_python_before_start(fleet: FaultFleet) -> None:
    computer = fleet.get_computer(fleet.first)
    computer.hide_python(yes=True)
    fleet.add_task("slam")
    fleet.add_task("nav", on=fleet.second)
    fleet.apply().expect_exit(0, 4, within=25).expect_output(fleet.first, "python")
    fleet.check_verdict({"slam": None, "nav": fleet.second})
    computer.hide_python(yes=False)


@fault("python3 vanishes while tasks run", kinds=OWN, full=2)
def hide_python_during_run(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    computer = fleet.get_computer(fleet.first)
    computer.hide_python(yes=True)
    check_held(fleet, "python", within=25)
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})
    computer.hide_python(yes=False)


def find_installed_psutil() -> str:
    found = [
        path
        for path in ("/usr/lib/python3/dist-packages/psutil", "/usr/local/lib/python3/dist-packages/psutil")
        if Path(path).exists()
    ]
    return f"the system's Python has psutil: {found}" if found else ""


@fault("no psutil on the host", kinds=OWN, full=1, missing=find_installed_psutil)
def probe_without_psutil(fleet: FaultFleet) -> None:
    """The reply without psutil has the same fields as with it."""
    start_tasks(fleet)
    host = fleet.probe_host(fleet.first)
    if not host.get("cpu") or not host.get("memory") or "slam" not in dict(host.get("tasks") or {}):
        raise ExpectationError(f"a poor probe: {host}")


@fault("psutil on the host", kinds=OWN, full=1)
def probe_with_psutil(fleet: FaultFleet) -> None:
    import psutil

    for name in fleet.edges:
        source = Path(str(psutil.__file__)).parent
        shutil.copytree(source, fleet.get_computer(name).path("usr/lib/python3/dist-packages/psutil"))
    probe_without_psutil(fleet)
