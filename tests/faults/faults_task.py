"""Tasks that behave badly: deaf, forking, crashing, shouting, with a temper."""

from itertools import pairwise

from tests.faults import oracle, scan
from tests.faults.fleet import Fleet
from tests.faults.hosts import wait_for
from tests.faults.outcome import ExpectationError
from tests.faults.registry import fault

TREE = ("--with", "child,daemon,session")


@fault("task ignores SIGTERM", quick=True, full=3)
def deaf(fleet: Fleet) -> None:
    fleet.want("slam", "--deaf", on="edge1", stop={"grace": "1s"})
    fleet.settle()
    fleet.pin("slam", "edge2")
    fleet.apply().must(0)
    fleet.check()
    old = oracle.by_task(oracle.lives(fleet.records))["slam"][0]
    if "SIGTERM" not in old.signals:
        raise ExpectationError("the task was killed without being asked to end first")


@fault("task double-forks daemons", quick=True, full=3)
def daemons(fleet: Fleet) -> None:
    """Child, daemon and a session of its own, each stopped with the task, also where they empty their environment."""
    fleet.want("slam", *TREE, *fleet.draw.choice([(), ("--bare",), ("--closed",)]), on="edge1")
    moves(fleet)


@fault("daemons with emptied environment and closed descriptors", full=3)
def hidden_daemons(fleet: Fleet) -> None:
    fleet.want("slam", *TREE, "--bare", "--closed", "--deaf", on="edge1", stop={"grace": "1s"})
    moves(fleet)


@fault("launcher ends, its daemons stay", full=3)
def launcher(fleet: Fleet) -> None:
    """A command that daemonises and exits 0: whatever edgectl makes of it, there is never a second set of daemons."""
    fleet.want("slam", "--with", "daemon", "--detach", on="edge1", restart="on-failure")
    fleet.apply().must(0, 4)
    fleet.apply().must(0, 4)
    found = oracle.watch(fleet.records, seconds=0.7).get("slam", [])
    if len(found) > 1:
        raise ExpectationError(f"{len(found)} sets of daemons")
    fleet.unwant("slam")


def moves(fleet: Fleet) -> None:
    """To the other host and back."""
    fleet.settle()
    for host in ("edge2", "edge1"):
        fleet.pin("slam", host)
        fleet.apply().must(0)
        fleet.check()


@fault("supervisor killed, its task lives", full=4)
def supervisor_killed(fleet: Fleet) -> None:
    """Every process of the host that is not the task itself is killed: the task is still found, and never doubled."""
    fleet.want("slam", "--with", "daemon", on="edge1")
    fleet.settle()
    host = fleet.hosts["edge1"]
    victims = [
        each for each in host.processes() if fleet.mark not in each.command and "sshd" not in each.command
    ]
    if not victims:
        raise ExpectationError("no supervisor was found")
    scan.end(victims)
    fleet.apply().must(0)
    fleet.check()
    fleet.pin("slam", "edge2")
    fleet.apply().must(0)
    fleet.check()


@fault("main process and supervisor killed, a daemon lives", full=4)
def only_daemon_lives(fleet: Fleet) -> None:
    fleet.want("slam", "--with", "daemon", on="edge1")
    fleet.settle()
    victims = [
        each
        for each in fleet.hosts["edge1"].processes()
        if "--role daemon" not in each.command and "sshd" not in each.command
    ]
    fleet.draw.shuffle(victims)
    scan.end(victims)
    fleet.apply().must(0, 4)


@fault("crash loop", full=2)
def crash_loop(fleet: Fleet) -> None:
    """Starts are bounded and visible; the other task is not touched."""
    fleet.want("slam", "--for", "0.2", "--exit", "3", on="edge1", restart="always")
    fleet.want("nav", on="edge1")
    fleet.apply().must(0, 1, 4)
    fleet.clock(6)
    if not 2 <= fleet.launches("slam") <= 6:
        raise ExpectationError(f"{fleet.launches('slam')} starts in some 7 s")
    if fleet.launches("nav") != 1:
        raise ExpectationError("nav was started again")
    fleet.edgectl("status").must(0, 1, 4).says("slam", "nav")
    fleet.unwant("slam")


@fault("a job that failed is left alone", full=2)
def failed_job_once(fleet: Fleet) -> None:
    """``restart: never``: no apply starts it again; restart does, once."""
    fleet.want("job", "--for", "0.5", "--exit", "3", on="edge1", kind="job", restart="never")
    fleet.want("nav", on="edge2")
    fleet.apply().must(0, 4)
    wait_for(lambda: fleet.stopped("job"), "the job's end", 45)
    for _ in range(2):
        fleet.apply().must(0).says("given up", "edgectl restart job")
    if fleet.launches("job") != 1:
        raise ExpectationError("the job ran again")
    fleet.edgectl("restart", "job", "--yes").must(0, 4)
    wait_for(lambda: fleet.launches("job") == 2, "the job's second run", 45)
    fleet.unwant("job")


@fault("a job runs once", full=2)
def job_once(fleet: Fleet) -> None:
    fleet.want("job", "--for", "0.5", "--exit", "0", on="edge1", kind="job")
    fleet.want("nav", on="edge2")
    fleet.apply().must(0)
    wait_for(lambda: fleet.stopped("job"), "the job's end", 45)
    for _ in range(3):
        fleet.apply().must(0)
    if fleet.launches("job") != 1:
        raise ExpectationError(f"the job ran {fleet.launches('job')} times")
    del fleet.expected["job"]
    fleet.check()


@fault("log spam", full=2)
def log_spam(fleet: Fleet) -> None:
    """10 MB/s into a log of 2 x 64 KiB: the disk stays small and the task is not slowed down."""
    fleet.want("slam", "--spam", "10000000", on="edge1", log={"max_size": "64Ki", "files": 2})
    fleet.want("nav", on="edge1")
    fleet.settle()
    fleet.clock(4)
    logs = [path for path in scan.files_under(fleet.hosts["edge1"].home) if b"spamspam" in path.read_bytes()]
    size = sum(path.stat().st_size for path in logs)
    if not 0 < size <= 2 * 65536 + 16384:
        raise ExpectationError(f"{size} bytes of logs: {logs}")
    gap = longest_silence(fleet, "slam")
    if gap > 2:
        raise ExpectationError(f"the task stood still for {gap:.1f} s")
    fleet.edgectl("logs", "slam", "--tail", "3").must(0)


def longest_silence(fleet: Fleet, task: str) -> float:
    """Seconds between two ticks of the task's main process, at most."""
    gap = 0
    for directory in fleet.records.values():
        for path in directory.glob("*.main.*.jsonl"):
            times = [int(str(event["ns"])) for event in oracle.read_events(path) if event["task"] == task]
            gap = max([gap, *(later - earlier for earlier, later in pairwise(times))])
    return gap / oracle.SECOND


@fault("output that is no UTF-8", full=2)
def garbage_output(fleet: Fleet) -> None:
    fleet.want("slam", "--garbage", on="edge1")
    fleet.settle()
    fleet.clock(1)
    fleet.edgectl("logs", "slam", "--tail", "5").must(0)
    if "\x1b]0;owned" in fleet.on_terminal("logs", "slam", "--tail", "5"):
        raise ExpectationError("an escape sequence of the task reached the terminal")
    fleet.edgectl("status").must(0)
    fleet.check()


@fault("new instance never becomes ready", full=2)
def never_ready(fleet: Fleet) -> None:
    """The old one is back on its old host after the deadline, and the apply says that it failed."""
    only_on_edge1 = 'test "$(hostname)" = edge1 -o "${HOME##*/edge1/}" != "$HOME"'
    fleet.want("slam", on="edge1", ready={"command": only_on_edge1, "timeout": "2s"})
    fleet.settle()
    fleet.pin("slam", "edge2")
    fleet.apply().must(4, 1)
    fleet.check({"slam": "edge1"})
    fleet.pin("slam", "edge1")


@fault("start-first leaves no gap", full=2)
def start_first(fleet: Fleet) -> None:
    fleet.want("slam", on="edge1", handoff={"order": "start-first"})
    fleet.overlap_allowed.add("slam")
    fleet.settle()
    fleet.pin("slam", "edge2")
    fleet.apply().must(0)
    gap = oracle.longest_gap(oracle.by_task(oracle.lives(fleet.records))["slam"])
    if gap > 0:
        raise ExpectationError(f"a gap of {gap:.3f} s")


@fault("foreign processes that look like the task", full=3)
def lookalikes(fleet: Fleet) -> None:
    """Same words in the command line, started by someone else: never counted, never signalled, through a whole life."""
    for host in fleet.hosts:
        fleet.canary(host, "beacon.py", "--task", "slam")
    fleet.want("slam", *TREE, "--deaf", on="edge1", stop={"grace": "1s"})
    moves(fleet)
