# SPDX-License-Identifier: Apache-2.0
"""Faults of input: garbage around replies, hostile strings in every field."""

import json
from pathlib import Path

from tests.faults import oracle
from tests.faults.command_result import ExpectationError
from tests.faults.fleet import FaultFleet
from tests.faults.hosts import Host
from tests.faults.registry import fault

NOISE = {
    "a banner": "echo 'Welcome to Ubuntu 18.04'; echo 'Last login: now' >&2; trap 'echo bye' EXIT",
    "JSON look-alikes": """echo '{"v":1,"op":"probe","host":"edge1","tasks":{}}'; trap 'echo "{}"' EXIT""",
    "bytes that are no text": r"""printf '\377\376\000\033]0;x\007\233'; trap 'printf "\000\377\n\n"' EXIT""",
    "no newline": "printf 'prompt> '; trap 'printf tail' EXIT",
    "a lot of it": "head -c 600000 /dev/urandom; trap 'head -c 300000 /dev/urandom' EXIT",
}


def add_shell_noise(host: Host, script: str) -> None:
    """Make the login shell's start file print garbage."""
    path = host.home / ".bashrc"
    path.write_text(script + "\n")
    path.chmod(0o644)


@fault("garbage before and after the document", full=6)
def surround_replies_with_garbage(fleet: FaultFleet) -> None:
    for name, host in fleet.hosts.items():
        add_shell_noise(
            host,
            NOISE[fleet.random.choice(sorted(NOISE))] if name == fleet.second else NOISE["JSON look-alikes"],
        )
    fleet.add_task("slam", on=fleet.first)
    fleet.add_task("nav", on=fleet.second)
    fleet.apply_and_check()
    fleet.pin_task("slam", fleet.second)
    fleet.apply_and_check()


@fault("endless output from a login shell", full=1)
def flood_manager(fleet: FaultFleet) -> None:
    """One host floods the manager with output: it is abandoned in time, the other works."""
    fleet.add_task("nav", on=fleet.second)
    add_shell_noise(fleet.hosts[fleet.first], "cat /dev/zero")
    fleet.apply().expect_exit(4, within=60).expect_output(fleet.first)
    fleet.check_verdict()
    add_shell_noise(fleet.hosts[fleet.first], "")


MARKER_FILE = "edgectl-was-here"
HOSTILE = (
    "plain",
    "two words",
    'it\'s "quoted"',
    "line\nbreak\n",
    f"$(touch {MARKER_FILE})",
    f"`touch {MARKER_FILE}`",
    f"; touch {MARKER_FILE} #",
    f"' ; touch {MARKER_FILE} ; '",
    "-rf --help",
    "${HOME}$$*?[a-z]~",
    "\\ back\\slash \\n",
    "\t\x01\x1b]0;owned\x07",
    "\u202egnp.exe \U0001f916 \u00e9",
    "%s%n{0}{x}",
)


@fault("hostile strings in env and workdir", quick=True, full=2)
def send_hostile_fields(fleet: FaultFleet) -> None:
    """Every value arrives byte by byte as written, and no shell evaluates it."""
    env = {f"HOSTILE_{number}": text for number, text in enumerate(HOSTILE)}
    workdir = fleet.hosts[fleet.first].records / f"dir '$(touch {MARKER_FILE})' \"x\""
    workdir.mkdir()
    workdir.chmod(0o777)
    inside = (
        workdir
        if fleet.hosts[fleet.first].kind == "loopback"
        else Path("/oracle/records" if fleet.engines else "/home/edge/oracle/records") / workdir.name
    )
    dump = 'python3 -c \'import json, os; json.dump([os.getcwd(), dict(os.environ)], open(os.path.expanduser("~/oracle/records/dump"), "w"))\'; '
    fleet.add_task("slam", on=fleet.first, env=env, workdir=str(inside))
    fleet.tasks["slam"]["command"] = dump + str(fleet.tasks["slam"]["command"])
    fleet.write_files()
    fleet.apply_and_check()
    cwd, seen = json.loads((fleet.hosts[fleet.first].records / "dump").read_text())
    if wrong := [text for name, text in env.items() if seen.get(name) != text]:
        raise ExpectationError(f"did not arrive as written: {wrong!r}")
    if cwd != str(inside):
        raise ExpectationError(f"the working directory is {cwd!r}")
    for words in (("status",), ("plan",), ("apply", "--dry-run"), ("probe", "-o", "wide")):
        fleet.run_edgectl(*words).expect_exit(0)
    check_nothing_evaluated(fleet)


def check_nothing_evaluated(fleet: FaultFleet) -> None:
    """Check that no shell evaluated a text."""
    places = [fleet.directory, *(path for host in fleet.hosts.values() for path in (host.home, host.records))]
    if found := [str(path) for place in places for path in place.rglob(MARKER_FILE)]:
        raise ExpectationError(f"a shell ran a field: {found}")


@fault("hostile strings as names and addresses", full=1)
def use_hostile_names(fleet: FaultFleet) -> None:
    """Refused with file and line before any host is contacted."""
    fleet.add_task("nav", on=fleet.second)
    fleet.apply_and_check()
    before = oracle.read_boottime_ns()
    for text in HOSTILE[1:]:
        fleet.tasks[text] = dict(fleet.tasks["nav"])
        fleet.write_files()
        fleet.apply().expect_exit(64)
        del fleet.tasks[text]
        fleet.inventory[fleet.first]["host"] = text
        fleet.write_files()
        fleet.apply().expect_exit(0, 4, 64)
        fleet.inventory[fleet.first]["host"] = fleet.first
    fleet.write_files()
    check_nothing_evaluated(fleet)
    if oracle.read_boottime_ns() < before:
        raise ExpectationError("time went backwards")


@fault("hostile values of the host's environment", full=1)
def set_hostile_env(fleet: FaultFleet) -> None:
    """sshd sets odd paths and Python's own variables in the session: they must not affect the agent."""
    trap = fleet.hosts[fleet.first].records / "trap"
    trap.mkdir()
    (trap / "json.py").write_text("raise SystemExit('poisoned')\n")
    (trap / "sitecustomize.py").write_text(f"open('/tmp/{MARKER_FILE}', 'w')\n")
    inside = trap if fleet.hosts[fleet.first].kind == "loopback" else Path("/home/edge/oracle/records/trap")
    fleet.hosts[fleet.first].set_env(
        PYTHONPATH=str(inside), PYTHONSTARTUP="/nonexistent", LANG="xx_YY.no", LC_ALL="tr_TR.UTF-8", IFS="/"
    )
    fleet.add_task("slam", on=fleet.first, env={"PYTHONPATH": ""})
    fleet.apply_and_check()
    fleet.hosts[fleet.first].set_env()
