# SPDX-License-Identifier: Apache-2.0
"""Every reading verb x form x width x terminal or pipe x colour: what holds of all that the command line prints.

The whole command line runs in this process, over simulated hosts. tests/views/test_matrix.py holds the tables themselves
(headings, whole names); here is what a verb makes of them: forms, colour, width, streams and exit codes.
"""

import json
import os
import pty
import re
import sys
import termios
import threading
from collections.abc import Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from edgectl.cli.app import COMMANDS
from edgectl.cli.main import main
from edgectl.transport.fake import FakeTransport
from tests.cli.inprocess import Said, edgectl
from tests.docs.reference import help_of
from tests.executor.fake_fleet import FakeFleet, FakeHost, Request
from tests.fuzz.hostile_fleet import OTHER_REPLIES

HOSTS = ["edge3", "edge2", "edge1", "robot1"]
INVENTORY = """version: 1
fleet: lab
edges:
  edge3: {host: edge3.lab, labels: {gpu: "yes"}}
  edge2: {host: edge2.lab}
  edge1: {host: edge1.lab}
robots:
  robot1: {host: robot1.lab}
"""
DEMAND = "demand: {cpu: 0.5, memory: 10Mi, throughput: 1Mbit/s}"
TASKS = f"""version: 1
tasks:
  zeta: {{command: sleep 100, robot: robot1, {DEMAND}}}
  nav: {{command: sleep 100, robot: robot1, needs: [zeta], {DEMAND}}}
  big: {{command: sleep 100, demand: {{cpu: 64, memory: 1Mi, throughput: 0}}}}
"""
# The reading verbs, each with words that have an answer.
READING = {
    "probe": "probe",
    "plan": "plan",
    "diff": "diff",
    "watch": "watch --cycles 1",
    "status": "status",
    "get": "get all",
    "describe edge": "describe edge edge3",
    "describe robot": "describe robot robot1",
    "describe task": "describe task zeta",
    "top hosts": "top hosts",
    "top tasks": "top tasks",
    "wait": "wait zeta --for ready --timeout 5s",
    "logs": "logs zeta nav",
    "events": "events",
    "explain": "explain zeta",
    "graph": "graph",
    "history": "history",
    "show": "show 1",
    "profile": "profile zeta",
    "doctor": "doctor",
    "profilers status": "profilers status",
    "counters show": "counters show",
    "validate": "validate",
    "config view": "config view",
    "config get-contexts": "config get-contexts",
    "config current-context": "config current-context",
    "export csv": "export csv events",
    "export jsonl": "export jsonl events",
    "export cron": "export cron",
    "export systemd": "export systemd",
    "export kubernetes": "export kubernetes --image ros:jazzy",
    "export nomad": "export nomad",
    "export compose": "export compose --image ros:jazzy",
    "export bluechi": "export bluechi",
    "schema": "schema tasks",
    "version": "version",
    "completion": "completion bash",
    "trust": "trust --all --dry-run",
}
COUNTER = {"addresses": ["192.0.2.7"], "counted": True, "rx_bytes": 5e6, "tx_bytes": 7e6, "tcp_bytes": 2e6}
REPLIES: dict[str, Request] = {
    **OTHER_REPLIES,
    "counters": {"state": "installed", "tasks": True, "robots": {"robot1": COUNTER}},
}
# They act, serve until they are ended, read other files than those of a fleet, or need what is no part of one.
OTHERS = {
    *(
        "apply",
        "stop",
        "start",
        "restart",
        "move",
        "unpin",
        "rollback",
        "cordon",
        "uncordon",
        "drain",
        "fence",
    ),
    *(
        "unfence",
        "done",
        "reopen",
        "profilers start",
        "profilers stop",
        "counters install",
        "counters remove",
    ),
    *(
        "exec",
        "ssh",
        "serve",
        "export prometheus",
        "export ros",
        "init",
        "config use-context",
        "report",
        "ssim",
    ),
    *("replay", "simulate run", "simulate sweep", "simulate merge", "experiment run", "experiment show"),
    *("import ros", "import ssh", "import ansible", "import paper", "import compose"),
}
_READS, _WRITES = "changes nothing", "writes new files, or prints them"
NOT_TRIED = {
    **dict.fromkeys(
        ("serve", "export prometheus", "export ros", "replay", "ssim", "experiment show"), _READS
    ),
    **dict.fromkeys(("simulate run", "simulate sweep", "simulate merge", "report", "init"), _WRITES),
    **dict.fromkeys(
        ("import ros", "import ssh", "import ansible", "import paper", "import compose"), _WRITES
    ),
    "config use-context": "chooses what later commands read",
}
PEOPLE = ("table", "wide")
WIDTHS = (60, 80, 120)
ESCAPE = re.compile(r"\x1b\[[0-9;]*m")
# Instants, ages, durations and lines of a history differ from run to run, and with them the width of their columns.
MOMENT = re.compile(r"\d{4}-\d\d-\d\dT[\d:.]+Z|\b\d+(?:\.\d+)?(?:e-\d+)?|[ -]{2,}|[▁▂▃▄▅▆▇█]+")


def answer(host: FakeHost, request: Request) -> Request:
    """The reply of a simulated host, or the one that stands here for an operation that it does not have."""
    if request["op"] in REPLIES:
        return {**REPLIES[str(request["op"])], "host": host.name, "op": request["op"]}
    return host(request)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """A folder with a fleet of three edges and a robot on which two of three tasks run, and its environment."""
    folder = tmp_path_factory.mktemp("matrix")
    hosts = FakeFleet.of(HOSTS)
    for name, text in (("inventories", INVENTORY), ("tasks", TASKS)):
        (folder / name).mkdir()
        (folder / name / "lab.yaml").write_text(text)
    kept = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ}
    env = {**kept, "EDGECTL_STATE_DIR": str(folder / "state"), "TERM": "xterm-256color", "LANG": "C.UTF-8"}
    with pytest.MonkeyPatch.context() as patch:
        transport = FakeTransport({name: partial(answer, host) for name, host in hosts.hosts.items()})
        patch.setattr("edgectl.transport.fleet_transport.FleetTransport", lambda **_: transport)
        applied = edgectl(["apply", "--yes"], folder, env)
        assert hosts.placed.keys() == {"zeta", "nav"}, applied
        yield folder, env


def show(words: list[str], folder: Path, env: Mapping[str, str], width: int) -> Said:
    """Run it with a terminal of ``width`` columns as stdout; stderr is a pipe."""
    ours, theirs = pty.openpty()
    attributes = termios.tcgetattr(theirs)
    attributes[1] &= ~termios.OPOST  # no carriage returns
    termios.tcsetattr(theirs, termios.TCSANOW, attributes)
    seen: list[bytes] = []

    def read() -> None:
        while True:
            try:
                data = os.read(ours, 65536)
            except OSError:
                return
            seen.append(data)

    reader = threading.Thread(target=read)
    reader.start()
    before = dict(os.environ), sys.stdout, sys.stderr, sys.stdin, Path.cwd()
    with (
        os.fdopen(theirs, "w", encoding="utf-8") as out,
        (folder / "err").open("w+") as err,
        Path(os.devnull).open() as no,
    ):
        try:
            os.environ.clear()
            os.environ.update(env, COLUMNS=str(width))
            sys.stdout, sys.stderr, sys.stdin = out, err, no
            os.chdir(folder)
            code = main(words)
        finally:
            os.environ.clear()
            os.environ.update(before[0])
            sys.stdout, sys.stderr, sys.stdin = before[1:4]
            os.chdir(before[4])
        err.seek(0)
        told = err.read()
    reader.join()
    os.close(ours)
    return Said(int(code), b"".join(seen).decode(), told)


@cache
def _list_forms(verb: str, folder: Path, env: tuple[tuple[str, str], ...]) -> tuple[str, ...]:
    """The forms that the verb names itself when it is asked for one that there is not."""
    said = edgectl([*READING[verb].split(), "-o", "nosuch"], folder, dict(env))
    assert said.code == 64, said
    if "No such option" in said.err:
        return ()
    found = re.search(r"use -o ([a-z, ]+)\n", said.err)
    assert found is not None, said.err
    return tuple(re.split(r", | or ", found[1]))


def settle(text: str) -> str:
    """Text without what differs from one run to the next: moments, and what a resolver says of a name."""
    return MOMENT.sub("#", re.sub(r"name unknown \([^)]*\)", "name unknown", text))


def drop_history(form: str, text: str) -> str:
    """A document without its histories, to which each run adds an entry; other text as it is."""
    if form not in ("json", "yaml") or "history" not in text:
        return re.sub(r'\[\{""?at""?.*?}]', "", text)

    def drop(value: Any) -> Any:
        if isinstance(value, list):
            return [drop(each) for each in value]
        if isinstance(value, dict):
            return {key: drop(each) for key, each in value.items() if key != "history"}
        return value

    return json.dumps(drop(yaml.safe_load(text)), indent=1, default=str)


def test_each_verb_is_read_here_or_named_as_none_that_reads() -> None:
    assert READING.keys() | OTHERS == COMMANDS.keys()
    assert not READING.keys() & OTHERS


@pytest.mark.parametrize("verb", READING)
def test_a_verb_in_every_form_for_people_and_programs(verb: str, fleet: tuple[Path, dict[str, str]]) -> None:
    folder, env = fleet
    words, forms = READING[verb].split(), _list_forms(verb, folder, tuple(env.items()))
    plain: dict[str, Said] = {}
    for form in forms or ("",):
        asked = [*words, *(["-o", form] if form else [])]
        piped = plain[form] = edgectl(asked, folder, env)
        assert "\x1b" not in piped.out + piped.err, "a pipe has no colour"
        assert "Traceback" not in piped.err
        assert "unexpected " not in piped.err, "what is read here has an answer"
        always = edgectl([*asked, "--color", "always"], folder, env)
        assert always.code == piped.code
        if form in PEOPLE:
            assert settle(ESCAPE.sub("", always.out)) == settle(piped.out), "colour carries no meaning alone"
            continue
        assert "\x1b" not in always.out, "a document has no colour"
        seen = show(asked, folder, env, 60)
        texts = [settle(drop_history(form, said.out)) for said in (seen, piped)]
        assert (seen.code, texts[0]) == (piped.code, texts[1]), "a document knows no terminal"
    codes = {said.code for said in plain.values()}
    # show has the forms of a plan, which a revision has not got.
    assert len(codes - {64} if verb == "show" else codes) == 1, "the form decides no exit code"
    for form in set(forms) & set(PEOPLE):
        for width in WIDTHS:
            asked = [*words, "-o", form]
            coloured, dull = (
                show([*asked, "--color", color], folder, env, width) for color in ("auto", "never")
            )
            assert "\x1b" not in dull.out
            assert settle(ESCAPE.sub("", coloured.out)) == settle(dull.out)
            assert coloured.code == plain[form].code
            long = [line for line in dull.out.splitlines() if len(line) > width]
            # -o wide has a column for each term, watch prints a journal; a name and a digest stay whole.
            if form == "table" and width >= 80 and verb != "watch":
                assert all(max(map(len, line.split())) > width // 3 for line in long), long


# Of one table or one document of their own, of records that are lines, or text for another program.
_OTHER_FORMS = {
    "watch",
    "logs",
    "export csv",
    "export jsonl",
    "export cron",
    "export systemd",
    "export kubernetes",
}
_OTHER_FORMS |= {
    "export nomad",
    "export compose",
    "export bluechi",
    "config current-context",
    "schema",
    "completion",
}


def test_all_readers_have_the_same_forms(fleet: tuple[Path, dict[str, str]]) -> None:
    folder, env = fleet
    documents = {"json", "jsonl", "yaml", "csv"}
    for verb in READING.keys() - _OTHER_FORMS:
        forms = set(_list_forms(verb, folder, tuple(env.items())))
        assert documents <= forms, verb
        assert "table" in forms or verb == "graph", verb
    assert {verb for verb in _OTHER_FORMS if _list_forms(verb, folder, tuple(env.items()))} == {"watch"}


def test_a_table_names_its_fleet_on_a_terminal_alone(fleet: tuple[Path, dict[str, str]]) -> None:
    folder, env = fleet
    assert edgectl(["plan", "--out", "next.plan"], folder, env).code == 0
    lost = (f"diff --without edge{number}" for number in (3, 2, 1))
    for words in (
        next(words for words in lost if edgectl(words.split(), folder, env).out),
        "probe",
        "get hosts",
        "get all",
        "top hosts",
        "top tasks",
        "plan",
        "status",
        "trust --all --dry-run",
        "history",
        "show 1",
        "events",
        "explain zeta",
        "describe edge edge3",
        "describe task zeta",
        "doctor",
        "profilers status",
        "counters show",
        "show next.plan",
        "apply --dry-run --target big --best-effort",
        "stop zeta --dry-run",
    ):
        seen = show(words.split(), folder, {**env, "NO_COLOR": "1"}, 80)
        first = seen.out.splitlines()[:3]
        assert any(re.search(r"\b[Ff]leet lab\b", line) for line in first), (words, seen)
    for words in ("get hosts", "top hosts"):
        assert "lab\n" not in edgectl(words.split(), folder, env).out
        assert "Fleet" not in show([*words.split(), "--no-headers"], folder, env, 80).out


def test_what_acts_can_be_tried() -> None:
    """On hosts, on the fleet's records, on a task file, or by programs of on_event."""
    acting = (OTHERS - NOT_TRIED.keys()) | {"profile", "events", "trust"}
    tried = {verb for verb in COMMANDS if re.search(r"^  --dry-run ", help_of(verb.split()), re.MULTILINE)}
    assert tried == acting


def test_what_colours_are_decided_by(fleet: tuple[Path, dict[str, str]]) -> None:
    """NO_COLOR, TERM=dumb and CI switch them off, FORCE_COLOR on, and --color stands above all of them."""
    folder, env = fleet
    for given, option, terminal, coloured in (
        ({}, "auto", True, True),
        ({"NO_COLOR": "1"}, "auto", True, False),
        ({"TERM": "dumb"}, "auto", True, False),
        ({"CI": "true"}, "auto", True, False),
        ({"CI": "false"}, "auto", True, True),
        ({"CI": "true", "FORCE_COLOR": "1"}, "auto", True, True),
        ({"NO_COLOR": "1"}, "always", False, True),
        ({"FORCE_COLOR": "1"}, "auto", False, True),
        ({"FORCE_COLOR": "1"}, "never", True, False),
    ):
        words = ["status", "--color", option]
        said = (
            show(words, folder, {**env, **given}, 80)
            if terminal
            else edgectl(words, folder, {**env, **given})
        )
        assert ("\x1b[" in said.out) is coloured, (given, option, terminal)
