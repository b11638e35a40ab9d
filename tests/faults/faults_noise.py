"""Noise and hostility: garbage around the document, hostile strings in every field."""

import json
from pathlib import Path

from tests.faults import oracle
from tests.faults.fleet import Fleet
from tests.faults.hosts import Host
from tests.faults.outcome import ExpectationError
from tests.faults.registry import fault

NOISE = {
    "a banner": "echo 'Welcome to Ubuntu 18.04'; echo 'Last login: now' >&2; trap 'echo bye' EXIT",
    "JSON look-alikes": """echo '{"v":1,"op":"probe","host":"edge1","tasks":{}}'; trap 'echo "{}"' EXIT""",
    "bytes that are no text": r"""printf '\377\376\000\033]0;x\007\233'; trap 'printf "\000\377\n\n"' EXIT""",
    "no newline": "printf 'prompt> '; trap 'printf tail' EXIT",
    "a lot of it": "head -c 600000 /dev/urandom; trap 'head -c 300000 /dev/urandom' EXIT",
}


def noise(host: Host, script: str) -> None:
    """The login shell's start file speaks."""
    path = host.home / ".bashrc"
    path.write_text(script + "\n")
    path.chmod(0o644)


@fault("garbage before and after the document", quick=True, full=6)
def garbage(fleet: Fleet) -> None:
    for name, host in fleet.hosts.items():
        noise(host, NOISE[fleet.draw.choice(sorted(NOISE))] if name == "edge2" else NOISE["JSON look-alikes"])
    fleet.want("slam", on="edge1")
    fleet.want("nav", on="edge2")
    fleet.settle()
    fleet.pin("slam", "edge2")
    fleet.settle()


@fault("a login shell that says too much, for ever", full=1)
def endless_noise(fleet: Fleet) -> None:
    """One host drowns the manager in noise: it is given up in time, the other goes on."""
    fleet.want("nav", on="edge2")
    noise(fleet.hosts["edge1"], "cat /dev/zero")
    fleet.apply().must(4, within=60).says("edge1")
    fleet.check()
    noise(fleet.hosts["edge1"], "")


CANARY = "edgectl-was-here"
HOSTILE = (
    "plain",
    "two words",
    'it\'s "quoted"',
    "line\nbreak\n",
    f"$(touch {CANARY})",
    f"`touch {CANARY}`",
    f"; touch {CANARY} #",
    f"' ; touch {CANARY} ; '",
    "-rf --help",
    "${HOME}$$*?[a-z]~",
    "\\ back\\slash \\n",
    "\t\x01\x1b]0;owned\x07",
    "\u202egnp.exe \U0001f916 \u00e9",
    "%s%n{0}{x}",
)


@fault("hostile strings in env and workdir", quick=True, full=2)
def hostile_fields(fleet: Fleet) -> None:
    """Every value arrives byte by byte as it was written, and no shell ever ran one."""
    env = {f"HOSTILE_{number}": text for number, text in enumerate(HOSTILE)}
    workdir = fleet.hosts["edge1"].records / f"dir '$(touch {CANARY})' \"x\""
    workdir.mkdir()
    workdir.chmod(0o777)
    inside = (
        workdir
        if fleet.hosts["edge1"].kind == "loopback"
        else Path("/home/edge/oracle/records") / workdir.name
    )
    dump = 'python3 -c \'import json, os; json.dump([os.getcwd(), dict(os.environ)], open(os.path.expanduser("~/oracle/records/dump"), "w"))\'; '
    fleet.want("slam", on="edge1", env=env, workdir=str(inside))
    fleet.tasks["slam"]["command"] = dump + str(fleet.tasks["slam"]["command"])
    fleet.write()
    fleet.settle()
    cwd, seen = json.loads((fleet.hosts["edge1"].records / "dump").read_text())
    if wrong := [text for name, text in env.items() if seen.get(name) != text]:
        raise ExpectationError(f"did not arrive as written: {wrong!r}")
    if cwd != str(inside):
        raise ExpectationError(f"the working directory is {cwd!r}")
    for words in (("status",), ("plan",), ("apply", "--dry-run"), ("probe", "-o", "wide")):
        fleet.edgectl(*words).must(0)
    no_canary(fleet)


def no_canary(fleet: Fleet) -> None:
    """No shell ran what was only text."""
    places = [fleet.directory, *(path for host in fleet.hosts.values() for path in (host.home, host.records))]
    if found := [str(path) for place in places for path in place.rglob(CANARY)]:
        raise ExpectationError(f"a shell ran a field: {found}")


@fault("hostile strings as names and addresses", full=1)
def hostile_names(fleet: Fleet) -> None:
    """Refused by their file and line, before anything is contacted."""
    fleet.want("nav", on="edge2")
    fleet.settle()
    before = oracle.now_ns()
    for text in HOSTILE[1:]:
        fleet.tasks[text] = dict(fleet.tasks["nav"])
        fleet.write()
        fleet.apply().must(64)
        del fleet.tasks[text]
        fleet.inventory["edge1"]["host"] = text
        fleet.write()
        fleet.apply().must(0, 4, 64)
        fleet.inventory["edge1"]["host"] = "edge1"
    fleet.write()
    no_canary(fleet)
    if oracle.now_ns() < before:
        raise ExpectationError("time went backwards")


@fault("hostile values of the host's environment", full=1)
def hostile_host_env(fleet: Fleet) -> None:
    """What sshd puts into the session: strange paths and Python's own switches must not reach the agent."""
    trap = fleet.hosts["edge1"].records / "trap"
    trap.mkdir()
    (trap / "json.py").write_text("raise SystemExit('poisoned')\n")
    (trap / "sitecustomize.py").write_text(f"open('/tmp/{CANARY}', 'w')\n")
    inside = trap if fleet.hosts["edge1"].kind == "loopback" else Path("/home/edge/oracle/records/trap")
    fleet.hosts["edge1"].set_env(
        PYTHONPATH=str(inside), PYTHONSTARTUP="/nonexistent", LANG="xx_YY.no", LC_ALL="tr_TR.UTF-8", IFS="/"
    )
    fleet.want("slam", on="edge1", env={"PYTHONPATH": ""})
    fleet.settle()
    fleet.hosts["edge1"].set_env()
