# SPDX-License-Identifier: Apache-2.0
"""Faults of tasks: ignored signals, forks, crashes, log floods, wrong output."""

from itertools import pairwise

from tests.faults import oracle, scan
from tests.faults.command_result import ExpectationError
from tests.faults.fleet import FaultFleet
from tests.faults.hosts import wait_for
from tests.faults.registry import fault

TREE = ("--with", "child,daemon,session")


@fault("task ignores SIGTERM", full=3)
def ignore_sigterm(fleet: FaultFleet) -> None:
    fleet.add_task("slam", "--deaf", on=fleet.first, stop={"grace": "1s"})
    fleet.apply_and_check()
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()
    old = oracle.group_by_task(oracle.list_lifetimes(fleet.records))["slam"][0]
    if "SIGTERM" not in old.signals:
        raise ExpectationError("the task was killed without being asked to end first")


@fault("task double-forks daemons", full=3)
def start_daemons(fleet: FaultFleet) -> None:
    """Child, daemon and daemon in its own session are stopped with the task, with and without the task's
    environment.
    """
    fleet.add_task("slam", *TREE, *fleet.random.choice([(), ("--bare",), ("--closed",)]), on=fleet.first)
    move_and_return(fleet)


@fault("daemons with emptied environment and closed descriptors", full=3)
def start_hidden_daemons(fleet: FaultFleet) -> None:
    fleet.add_task("slam", *TREE, "--bare", "--closed", "--deaf", on=fleet.first, stop={"grace": "1s"})
    move_and_return(fleet)


@fault("launcher ends, daemons stay", full=3)
def run_launcher(fleet: FaultFleet) -> None:
    """A command that daemonises and exits with 0 must never lead to a second set of daemons."""
    fleet.add_task("slam", "--with", "daemon", "--detach", on=fleet.first, restart="on-failure")
    fleet.apply().expect_exit(0, 4)
    fleet.apply().expect_exit(0, 4)
    found = oracle.watch_launches(fleet.records, seconds=0.7).get("slam", [])
    if len(found) > 1:
        raise ExpectationError(f"{len(found)} sets of daemons")
    fleet.remove_task("slam")


def move_and_return(fleet: FaultFleet) -> None:
    """Move the task to the other host and back."""
    fleet.apply_and_check()
    for host in (fleet.second, fleet.first):
        fleet.pin_task("slam", host)
        fleet.apply().expect_exit(0)
        fleet.check_verdict()


@fault("supervisor killed, task alive", full=4)
def kill_supervisor(fleet: FaultFleet) -> None:
    """With all processes killed except the task itself, the task is still found and never doubled."""
    fleet.add_task("slam", "--with", "daemon", on=fleet.first)
    fleet.apply_and_check()
    host = fleet.hosts[fleet.first]
    victims = [
        each for each in host.processes() if fleet.mark not in each.command and "sshd" not in each.command
    ]
    if not victims:
        raise ExpectationError("no supervisor was found")
    scan.kill_processes(victims)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()


@fault("main process and supervisor killed, daemon alive", full=4)
def leave_only_daemon(fleet: FaultFleet) -> None:
    fleet.add_task("slam", "--with", "daemon", on=fleet.first)
    fleet.apply_and_check()
    victims = [
        each
        for each in fleet.hosts[fleet.first].processes()
        if "--role daemon" not in each.command and "sshd" not in each.command
    ]
    fleet.random.shuffle(victims)
    scan.kill_processes(victims)
    fleet.apply().expect_exit(0, 4)


@fault("crash loop", full=2)
def run_crash_loop(fleet: FaultFleet) -> None:
    """Starts are bounded and reported; the other task is not restarted."""
    fleet.add_task("slam", "--for", "0.2", "--exit", "3", on=fleet.first, restart="always")
    fleet.add_task("nav", on=fleet.first)
    fleet.apply().expect_exit(0, 1, 4)
    fleet.wait(6)
    if not 2 <= fleet.count_launches("slam") <= 6:
        raise ExpectationError(f"{fleet.count_launches('slam')} starts in some 7 s")
    if fleet.count_launches("nav") != 1:
        raise ExpectationError("nav was started again")
    fleet.run_edgectl("status").expect_exit(0, 1, 4).expect_output("slam", "nav")
    fleet.remove_task("slam")


@fault("a failed job is not restarted", full=2)
def run_failed_job(fleet: FaultFleet) -> None:
    """``restart: never``: apply does not start the task again; ``edgectl restart`` does, once."""
    fleet.add_task("job", "--for", "0.5", "--exit", "3", on=fleet.first, kind="job", restart="never")
    fleet.add_task("nav", on=fleet.second)
    fleet.apply().expect_exit(0, 4)
    wait_for(lambda: fleet.has_stopped("job"), "the job's end", 45)
    for _ in range(2):
        fleet.apply().expect_exit(4).expect_output("given up", "edgectl restart job")
    if fleet.count_launches("job") != 1:
        raise ExpectationError("the job ran again")
    fleet.run_edgectl("restart", "job", "--yes").expect_exit(0, 4)
    wait_for(lambda: fleet.count_launches("job") == 2, "the job's second run", 45)
    fleet.remove_task("job")


@fault("a job runs once", full=2)
def run_job(fleet: FaultFleet) -> None:
    fleet.add_task("job", "--for", "0.5", "--exit", "0", on=fleet.first, kind="job")
    fleet.add_task("nav", on=fleet.second)
    fleet.apply().expect_exit(0)
    wait_for(lambda: fleet.has_stopped("job"), "the job's end", 45)
    for _ in range(3):
        fleet.apply().expect_exit(0)
    if fleet.count_launches("job") != 1:
        raise ExpectationError(f"the job ran {fleet.count_launches('job')} times")
    del fleet.expected["job"]
    fleet.check_verdict()


@fault("log spam", full=2)
def flood_log(fleet: FaultFleet) -> None:
    """10 MB/s into a log of 2 x 64 KiB: disk use stays small and the task is not slowed down."""
    fleet.add_task("slam", "--spam", "10000000", on=fleet.first, log={"max_size": "64Ki", "files": 2})
    fleet.add_task("nav", on=fleet.first)
    fleet.apply_and_check()
    fleet.wait(4)
    logs = [
        path for path in scan.list_files(fleet.hosts[fleet.first].home) if b"spamspam" in path.read_bytes()
    ]
    size = sum(path.stat().st_size for path in logs)
    if not 0 < size <= 2 * 65536 + 16384:
        raise ExpectationError(f"{size} bytes of logs: {logs}")
    gap = compute_longest_silence(fleet, "slam")
    if gap > 2:
        raise ExpectationError(f"the task stood still for {gap:.1f} s")
    fleet.run_edgectl("logs", "slam", "--tail", "3").expect_exit(0)


def compute_longest_silence(fleet: FaultFleet, task: str) -> float:
    """Return the longest time in seconds between two ticks of the task's main process."""
    gap = 0
    for directory in fleet.records.values():
        for path in directory.glob("*.main.*.jsonl"):
            times = [int(str(event["ns"])) for event in oracle.read_events(path) if event["task"] == task]
            gap = max([gap, *(later - earlier for earlier, later in pairwise(times))])
    return gap / oracle.SECOND


@fault("output that is not UTF-8", full=2)
def write_garbage(fleet: FaultFleet) -> None:
    fleet.add_task("slam", "--garbage", on=fleet.first)
    fleet.apply_and_check()
    fleet.wait(1)
    fleet.run_edgectl("logs", "slam", "--tail", "5").expect_exit(0)
    if "\x1b]0;owned" in fleet.run_on_terminal("logs", "slam", "--tail", "5"):
        raise ExpectationError("an escape sequence of the task reached the terminal")
    fleet.run_edgectl("status").expect_exit(0)
    fleet.check_verdict()


@fault("new instance never becomes ready", full=2)
def start_unready_instance(fleet: FaultFleet) -> None:
    """The old instance is back on its host after the deadline, and apply reports the failure."""
    old = fleet.first
    only_there = f'test "$(hostname)" = {old} -o "${{HOME##*/{old}/}}" != "$HOME"'
    fleet.add_task("slam", on=old, ready={"command": only_there, "timeout": "2s"})
    fleet.apply_and_check()
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(4, 1)
    fleet.check_verdict({"slam": fleet.first})
    fleet.pin_task("slam", fleet.first)


@fault("start-first leaves no gap", full=2)
def move_start_first(fleet: FaultFleet) -> None:
    fleet.add_task("slam", on=fleet.first, handoff={"order": "start-first"})
    fleet.overlap_allowed.add("slam")
    fleet.apply_and_check()
    fleet.pin_task("slam", fleet.second)
    fleet.apply().expect_exit(0)
    gap = oracle.compute_longest_gap(oracle.group_by_task(oracle.list_lifetimes(fleet.records))["slam"])
    if gap > 0:
        raise ExpectationError(f"a gap of {gap:.3f} s")


@fault("foreign processes that look like the task", full=3)
def start_lookalikes(fleet: FaultFleet) -> None:
    """Foreign processes with the same command line are never counted and never signalled."""
    for host in fleet.hosts:
        fleet.start_bystander(host, "recording_task.py", "--task", "slam")
    fleet.add_task("slam", *TREE, "--deaf", on=fleet.first, stop={"grace": "1s"})
    move_and_return(fleet)
