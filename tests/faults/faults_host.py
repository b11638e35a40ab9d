"""Faults of the host: power, reboot, disk, mounts, Python, the way in."""

import shutil
from pathlib import Path

from tests.faults import oracle
from tests.faults.fleet import Fleet
from tests.faults.hosts import wait_for
from tests.faults.outcome import ExpectationError
from tests.faults.registry import OWN, fault
from tests.faults.trouble import Kind, Trouble


def pair(fleet: Fleet) -> None:
    """slam runs on edge1, nav on edge2, and slam is free to go."""
    fleet.want("slam", on="edge1")
    fleet.want("nav", on="edge2")
    fleet.settle()
    fleet.pin("slam", None)


def held(fleet: Fleet, *words: str, within: float = 45) -> None:
    """edge1 cannot be reached: apply says so, in time, touches nothing else, and starts slam nowhere."""
    fleet.apply().must(4, within=within).says("edge1", *words)
    running = {
        task: found
        for task, found in oracle.watch(fleet.records, seconds=0.5, patience=12.0, expected=["nav"]).items()
        if found[0].host == "edge2"
    }
    if set(running) != {"nav"}:
        raise ExpectationError(f"edge2 runs {sorted(running)}, wanted nav only")


@fault("host powered off", quick=True, kinds=OWN, full=5)
def powered_off(fleet: Fleet) -> None:
    pair(fleet)
    fleet.hosts["edge1"].power_off()
    held(fleet, "does not answer")
    fleet.edgectl("status").must(4).says("edge1")


@fault("host powered off in the middle of an apply", kinds=OWN, full=10)
def powered_off_in_apply(fleet: Fleet) -> None:
    pair(fleet)
    victim = fleet.draw.choice(["edge1", "edge2"])
    fleet.pin("slam", "edge2")
    running = fleet.begin("apply", "--yes")
    wait_a_part(fleet, 2.2)
    fleet.hosts[victim].power_off()
    fleet.end(running).must(0, 4)


def wait_a_part(fleet: Fleet, seconds: float) -> None:
    """Sleep for a part of these seconds, drawn at random."""
    fleet.clock(fleet.draw.uniform(0, seconds))


@fault("sshd gone, tasks run on", full=2)
def no_sshd(fleet: Fleet) -> None:
    pair(fleet)
    fleet.relay("edge1").set(Trouble(kind=Kind.REFUSE))
    held(fleet, within=25)
    fleet.check({"slam": "edge1", "nav": "edge2"})


@fault("authentication refused", quick=True, full=3)
def auth_refused(fleet: Fleet) -> None:
    pair(fleet)
    fleet.hosts["edge1"].admit(everybody=False)
    held(fleet, "edge1")
    fleet.check({"slam": "edge1", "nav": "edge2"})


@fault("host key changed", full=3)
def key_changed(fleet: Fleet) -> None:
    pair(fleet)
    fleet.hosts["edge1"].change_key()
    held(fleet, "key", within=25)
    fleet.check({"slam": "edge1", "nav": "edge2"})
    fleet.trust_again()


@fault("host rebooted, its old pids taken by strangers", quick=True, kinds=OWN, full=5)
def rebooted(fleet: Fleet) -> None:
    pair(fleet)
    (slam,) = [life for life in oracle.lives(fleet.records) if life.task == "slam"]
    computer = fleet.computer("edge1")
    pids = [inner for each in computer.processes() if (inner := computer.inner_pid(each))]
    computer.power_off()
    computer.boot()
    for pid in sorted({*pids, *slam.pids}):
        fleet.canary("edge1", "beacon.py", "--task", "slam", pid=pid)
    fleet.apply().must(0)
    fleet.check()


@fault("host rebooted twice, once while apply works", kinds=OWN, full=5)
def rebooted_in_apply(fleet: Fleet) -> None:
    pair(fleet)
    computer = fleet.computer("edge1")
    computer.power_off()
    computer.boot()
    running = fleet.begin("apply", "--yes")
    wait_a_part(fleet, 2.0)
    computer.power_off()
    computer.boot()
    fleet.end(running).must(0, 4)


@fault("disk full before the start", kinds=OWN, full=3)
def disk_full_before(fleet: Fleet) -> None:
    """A full disk refuses with its reason or works elsewhere (shared memory); it never half-starts."""
    fleet.computer("edge1").fill_disk()
    fleet.want("slam", on="edge1")
    fleet.want("nav", on="edge2")
    fleet.apply().must(0, 4)
    expected: dict[str, str | None] = {"nav": "edge2"}
    if "slam" in oracle.watch(fleet.records, seconds=0.7):
        expected["slam"] = "edge1"
    fleet.check(expected)


@fault("disk full while the task runs", quick=True, kinds=OWN, full=3)
def disk_full_during(fleet: Fleet) -> None:
    fleet.want("slam", "--spam", "200000", on="edge1", log={"max_size": "64Ki", "files": 2})
    fleet.want("job", "--for", "4", "--exit", "0", on="edge1", kind="job", restart="never")
    fleet.apply().must(0)
    fleet.computer("edge1").fill_disk()
    wait_for(lambda: fleet.stopped("job"), "the job's end", 45)
    del fleet.expected["job"]
    fleet.check()
    fleet.apply().must(0, 4)
    if fleet.launches("job") != 1:
        raise ExpectationError("the job ran twice: its exit code was lost on the full disk")


@fault("disk full while the task moves away", kinds=OWN, full=3)
def disk_full_move(fleet: Fleet) -> None:
    pair(fleet)
    fleet.computer("edge1").fill_disk()
    fleet.pin("slam", "edge2")
    fleet.apply().must(0)
    fleet.check()


@fault("home read-only before the start", kinds=OWN, full=3)
def home_read_only_before(fleet: Fleet) -> None:
    fleet.computer("edge1").home_read_only(yes=True)
    fleet.want("slam", on="edge1")
    fleet.want("nav", on="edge2")
    fleet.apply().must(0, 4)
    expected: dict[str, str | None] = {"nav": "edge2"}
    if "slam" in oracle.watch(fleet.records, seconds=0.7):
        expected["slam"] = "edge1"
    fleet.check(expected)


@fault("home read-only while the task moves", kinds=OWN, full=3)
def home_read_only_move(fleet: Fleet) -> None:
    """To and fro: neither the old host's nor the new host's home can be written."""
    pair(fleet)
    fleet.computer(fleet.draw.choice(["edge1", "edge2"])).home_read_only(yes=True)
    fleet.pin("slam", "edge2")
    fleet.apply().must(0, 4)
    verdict = fleet.judge({"slam": None, "nav": "edge2"})
    if not verdict.clean:
        raise ExpectationError(f"refused, but not before the old instance was stopped: {verdict}")


@fault("no python3 on the host", kinds=OWN, full=2)
def no_python(fleet: Fleet) -> None:
    computer = fleet.computer("edge1")
    computer.hide_python(yes=True)
    fleet.want("slam")
    fleet.want("nav", on="edge2")
    fleet.apply().must(0, 4, within=25).says("edge1", "python")
    fleet.check({"slam": "edge2", "nav": "edge2"})
    computer.hide_python(yes=False)


@fault("python3 vanishes while tasks run", kinds=OWN, full=2)
def python_vanishes(fleet: Fleet) -> None:
    pair(fleet)
    computer = fleet.computer("edge1")
    computer.hide_python(yes=True)
    held(fleet, "python", within=25)
    fleet.check({"slam": "edge1", "nav": "edge2"})
    computer.hide_python(yes=False)


def no_psutil_here() -> str:
    found = [
        path
        for path in ("/usr/lib/python3/dist-packages/psutil", "/usr/local/lib/python3/dist-packages/psutil")
        if Path(path).exists()
    ]
    return f"the system's Python has psutil: {found}" if found else ""


@fault("no psutil on the host", kinds=OWN, full=1, missing=no_psutil_here)
def no_psutil(fleet: Fleet) -> None:
    """Everything that a host with psutil tells: the same document, by /proc alone."""
    pair(fleet)
    host = fleet.probed("edge1")
    if not host.get("cpu") or not host.get("memory") or "slam" not in dict(host.get("tasks") or {}):
        raise ExpectationError(f"a poor probe: {host}")


@fault("psutil on the host", kinds=OWN, full=1)
def with_psutil(fleet: Fleet) -> None:
    import psutil

    for name in ("edge1", "edge2"):
        source = Path(str(psutil.__file__)).parent
        shutil.copytree(source, fleet.computer(name).path("usr/lib/python3/dist-packages/psutil"))
    no_psutil(fleet)
