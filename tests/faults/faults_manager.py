"""Faults of the manager: killed, interrupted, doubled, its clock, its files."""

import datetime as dt
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tests.faults import oracle
from tests.faults.faults_host import pair
from tests.faults.faults_link import busy
from tests.faults.fleet import APPLY, Fleet
from tests.faults.hosts import wait_for
from tests.faults.outcome import ExpectationError
from tests.faults.powerless import survivors
from tests.faults.registry import fault

SKEW = Path(__file__).with_name("skew.c")


def kill(running: "subprocess.Popen[str]") -> None:
    """kill -9 of edgectl and of whatever it started."""
    with suppress(ProcessLookupError):
        os.killpg(running.pid, signal.SIGKILL)
    running.communicate()


def strike_at_random(fleet: Fleet, strike: Callable[["subprocess.Popen[str]"], None]) -> None:
    """Begin an apply and strike it at a random moment of its life."""
    running = fleet.begin(*APPLY)
    fleet.clock(fleet.draw.uniform(0.3, 2.6))
    strike(running)


@fault("manager killed (kill -9) at a random moment", quick=True, full=25)
def killed(fleet: Fleet) -> None:
    busy(fleet)
    strike_at_random(fleet, kill)


@fault("manager killed, and killed again while it recovers", full=10)
def killed_twice(fleet: Fleet) -> None:
    busy(fleet)
    strike_at_random(fleet, kill)
    strike_at_random(fleet, kill)


@fault("manager killed while a start-first move runs", full=8)
def killed_start_first(fleet: Fleet) -> None:
    """Two may run at once here, so this one may overlap; after recovery it is one."""
    fleet.want("slam", on="edge1", handoff={"order": "start-first"})
    fleet.settle()
    fleet.overlap_allowed.add("slam")
    fleet.pin("slam", "edge2")
    strike_at_random(fleet, kill)


def powerless(fleet: Fleet) -> dict[str, str]:
    """An environment in which edgectl's disk keeps only what was synced; see `powerless`."""
    place = fleet.directory / "powerless"
    (place / "shadow").mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(survivors.__code__.co_filename), place / "sitecustomize.py")
    path = f"{place}:{fleet.code}" if fleet.code else str(place)
    return {"PYTHONPATH": path, "POWERLESS_SHADOW": str(place / "shadow"), "POWERLESS_ROOT": str(fleet.state)}


@fault("manager loses power after it said done", full=3)
def power_after_done(fleet: Fleet) -> None:
    """What was promised by exit 0 is on the disk: a task that was marked done is not started again."""
    fleet.want("slam", on="edge1")
    fleet.want("nav", on="edge2")
    fleet.apply(**powerless(fleet)).must(0)
    fleet.check()
    fleet.edgectl("done", "slam", **powerless(fleet)).must(0)
    survivors(fleet.directory / "powerless" / "shadow", fleet.state)
    del fleet.expected["slam"]
    fleet.apply().must(0)
    fleet.check()


@fault("manager loses power at a random moment", full=8)
def power_at_random(fleet: Fleet) -> None:
    busy(fleet)
    running = fleet.begin(*APPLY, **powerless(fleet))
    fleet.clock(fleet.draw.uniform(0.5, 2.6))
    kill(running)
    survivors(fleet.directory / "powerless" / "shadow", fleet.state)


@fault("manager interrupted (Ctrl-C once, or twice)", full=8)
def interrupted(fleet: Fleet) -> None:
    busy(fleet)

    def interrupt(running: "subprocess.Popen[str]") -> None:
        for _ in range(fleet.draw.choice([1, 2])):
            with suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGINT)
            time.sleep(0.1)
        fleet.end(running).must(0, 4, 130, within=60)

    strike_at_random(fleet, interrupt)


@fault("manager's machine lost its state", full=3)
def state_lost(fleet: Fleet) -> None:
    """The hosts hold the truth: nothing is restarted, nothing doubled."""
    pair(fleet)
    before = {task: fleet.launches(task) for task in fleet.expected}
    fleet.pin("slam", "edge1")
    fleet.state.rename(fleet.state.with_name("old-state"))
    fleet.apply().must(0)
    if before != {task: fleet.launches(task) for task in fleet.expected}:
        raise ExpectationError("a task was started again")
    fleet.check()


@fault("two applies at once", quick=True, full=8)
def two_applies(fleet: Fleet) -> None:
    busy(fleet)
    both = []
    for _ in range(2):
        both.append(fleet.begin(*APPLY))
        fleet.clock(fleet.draw.uniform(0, 0.4))
    codes = sorted(fleet.end(running).must(0, 75).code for running in both)
    if codes == [75, 75]:
        raise ExpectationError("both refused to work")


@fault("two managers at once, each with its own state", full=8)
def two_managers(fleet: Fleet) -> None:
    busy(fleet)
    other = {"EDGECTL_STATE_DIR": str(fleet.directory / "other-state")}
    first = fleet.begin(*APPLY)
    fleet.clock(fleet.draw.uniform(0, 1.0))
    second = fleet.begin(*APPLY, **other)
    for running in (first, second):
        fleet.end(running).must(0, 1, 4, 75)
    moment = oracle.now_ns()
    most = max(
        (count for count in oracle.live_at(oracle.lives(fleet.records), moment - 10**8).values()), default=0
    )
    if most > 1:
        raise ExpectationError(f"{most} at once")


@fault("lock holder killed", full=5)
def lock_holder_killed(fleet: Fleet) -> None:
    """The lock dies with its process: the next apply works at once."""
    busy(fleet)
    strike_at_random(fleet, kill)
    fleet.apply().must(0, 4)
    fleet.check()


@fault("a saved plan applied twice, and after a change", full=3)
def stale_plan(fleet: Fleet) -> None:
    pair(fleet)
    plan = str(fleet.directory / "saved.plan")
    fleet.pin("slam", "edge2")
    fleet.edgectl("plan", "--out", plan).must(0, 2)
    fleet.edgectl("apply", plan).must(0)
    fleet.check()
    fleet.edgectl("apply", plan).must(75)
    fleet.pin("slam", "edge1")
    fleet.edgectl("plan", "--out", plan).must(0, 2)
    fleet.want("late", on="edge1")
    fleet.edgectl("apply", plan).must(75)
    fleet.check({"slam": "edge2", "nav": "edge2"})


HOUR, DAY = 3600, 86400


def no_compiler() -> str:
    return "" if shutil.which("cc") else "no C compiler for the skewed clock"


def skewed(fleet: Fleet, seconds: int) -> dict[str, str]:
    """An environment in which the wall clock is off by so many seconds; the monotonic one stays true."""
    library = fleet.directory / "skew.so"
    if not library.exists():
        subprocess.run(
            ["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(SKEW)], check=True, timeout=60
        )
    return {"LD_PRELOAD": str(library), "CLOCK_SKEW": str(seconds)}


def skew_host(fleet: Fleet, name: str, seconds: int) -> None:
    """The host's wall clock is off: its users' processes preload the library, which lies where each of them can read it."""
    environment = skewed(fleet, seconds)
    host = fleet.hosts[name]
    shutil.copy(environment["LD_PRELOAD"], host.records / "skew.so")
    inside = host.records if host.kind == "loopback" else Path("/home/edge/oracle/records")
    host.set_env(**environment | {"LD_PRELOAD": str(inside / "skew.so")})


@fault("clocks an hour apart", full=4, missing=no_compiler)
def clock_skew(fleet: Fleet) -> None:
    """One host an hour ahead, one ten years behind, the manager a day ahead: nothing compares them."""
    pair(fleet)
    skew_host(fleet, "edge1", fleet.draw.choice([HOUR, -HOUR]))
    skew_host(fleet, "edge2", fleet.draw.choice([-3650 * DAY, 3650 * DAY]))
    fleet.pin("slam", "edge2")
    fleet.want("map", on="edge1")
    fleet.tasks["map"]["command"] = f'date +%s > "$HOME/oracle/records/date"; {fleet.tasks["map"]["command"]}'
    fleet.write()
    fleet.apply(**skewed(fleet, DAY)).must(0)
    fleet.check()
    assert abs(int((fleet.hosts["edge1"].records / "date").read_text()) - time.time()) > HOUR / 2, (
        "the host's clock was not skewed"
    )
    fleet.edgectl("status").must(0)
    ages_are_sane(fleet)


def ages_are_sane(fleet: Fleet) -> None:
    snapshot = fleet.edgectl("probe", "-o", "json").must(0).data
    taken = dt.datetime.fromisoformat(str(snapshot["taken_at"]))
    hosts = snapshot["hosts"]
    assert isinstance(hosts, dict)
    for name, host in hosts.items():
        for task, sample in host["tasks"].items():
            age = (taken - dt.datetime.fromisoformat(sample["started_at"])).total_seconds()
            if not -1 < age < 300:
                raise ExpectationError(f"{task} on {name} is {age} s old")


@fault("manager's clock goes backwards between applies", full=3, missing=no_compiler)
def clock_backwards(fleet: Fleet) -> None:
    pair(fleet)
    launches = fleet.launches("slam")
    fleet.pin("slam", "edge1")
    for seconds in (2 * HOUR, -2 * HOUR, -30 * DAY):
        fleet.apply(**skewed(fleet, seconds)).must(0)
    if fleet.launches("slam") != launches:
        raise ExpectationError("slam was started again")
    fleet.pin("slam", "edge2")
    fleet.apply(**skewed(fleet, -HOUR)).must(0)
    fleet.check()


@fault("state files truncated", quick=True, full=12)
def state_truncated(fleet: Fleet) -> None:
    spoil(fleet, lambda data: data[: fleet.draw.randrange(len(data))])


@fault("state files with a flipped bit", full=12)
def state_flipped(fleet: Fleet) -> None:
    def flip(data: bytes) -> bytes:
        place = fleet.draw.randrange(len(data))
        return data[:place] + bytes([data[place] ^ (1 << fleet.draw.randrange(8))]) + data[place + 1 :]

    spoil(fleet, flip)


def spoil(fleet: Fleet, harm: Callable[[bytes], bytes]) -> None:
    """Harm one of the manager's files. Whatever apply says, it is one of its own words, and no task is lost or doubled."""
    pair(fleet)
    fleet.pin("slam", "edge1")
    files = sorted(path for path in fleet.state.rglob("*") if path.is_file() and path.stat().st_size)
    victim = fleet.draw.choice(files)
    good = victim.read_bytes()
    victim.write_bytes(harm(good))
    outcome = fleet.apply().must(0, 1, 4, 64)
    fleet.check()
    if outcome.code in (1, 64):
        outcome.says(victim.name)
        mend_by_hint(fleet, victim)


def mend_by_hint(fleet: Fleet, victim: Path) -> None:
    """What the operator is told to do about a file that cannot be read: put it aside."""
    victim.rename(fleet.directory / "tmp" / victim.name)


@fault("state files of a future format_version", full=3)
def state_of_the_future(fleet: Fleet) -> None:
    pair(fleet)
    fleet.pin("slam", "edge1")
    changed = []
    for path in sorted(fleet.state.rglob("*")):
        if path.is_file() and b'"format_version":' in (data := path.read_bytes()):
            path.write_bytes(
                data.replace(b'"format_version":1', b'"format_version":9').replace(
                    b'"format_version": 1', b'"format_version": 9'
                )
            )
            changed.append(path)
    if not changed:
        return
    fleet.apply().must(1, 64).says("newer edgectl")
    fleet.check()
    for path in changed:
        mend_by_hint(fleet, path)


@fault("saved snapshot and plan harmed", full=3)
def saved_files_harmed(fleet: Fleet) -> None:
    pair(fleet)
    fleet.pin("slam", "edge2")
    snapshot, plan = fleet.directory / "saved.json", fleet.directory / "saved.plan"
    fleet.edgectl("probe", "--out", str(snapshot)).must(0)
    fleet.edgectl("plan", "--out", str(plan)).must(0, 2)
    for path, words in ((snapshot, ("plan", "--snapshot")), (plan, ("apply",))):
        good = path.read_bytes()
        for _ in range(3):
            path.write_bytes(good[: fleet.draw.randrange(len(good) - 2)])
            fleet.edgectl(*words, str(path)).must(64, 1, 75)
        path.write_bytes(
            good.replace(b'"format_version": 1', b'"format_version": 9').replace(
                b'"format_version":1', b'"format_version":9'
            )
        )
        fleet.edgectl(*words, str(path)).must(64, 1, 75).says("version")
    fleet.check({"slam": "edge1", "nav": "edge2"})


@fault("no room for the manager's state", full=2)
def state_unwritable(fleet: Fleet) -> None:
    """A file stands where the state directory should be: refused before anything is touched."""
    fleet.want("slam", on="edge1")
    fleet.state.rmdir()
    fleet.state.write_text("in the way")
    fleet.apply().must(1, 64)
    fleet.check({})
    fleet.state.unlink()
    wait_for(lambda: not fleet.state.exists(), "the state's place")
