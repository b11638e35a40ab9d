# SPDX-License-Identifier: Apache-2.0
"""What commands import, compile, start and ask: bounded by count, since times differ by machine.

A bound that is missed has a reason in the change at hand: a module that moved, or an import for a rare case, which
belongs into the function that needs it. Raise a bound only for what the command itself needs.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.sshd import running_lab

# Runs edgectl, and writes down its modules, how many texts were compiled, such as methods of dataclasses, and how many
# connections were opened and processes started.
PROGRAM = """
import json, os, sys
counts = {"compiled": 0, "connections": 0, "processes": 0}
def listen(event, args):
    if event == "compile" and args[1] in (None, "<string>"):
        counts["compiled"] += 1
    elif event == "socket.connect" and isinstance(args[1], tuple):
        counts["connections"] += 1
    elif event == "subprocess.Popen":
        counts["processes"] += 1
sys.addaudithook(listen)
from edgectl.cli.main import main
code = main()
modules = sorted(sys.modules)
with open(os.environ["STARTUP_REPORT"], "w") as report:
    json.dump({"code": code, "modules": modules, **counts}, report)
"""
# Never on the way of one of these commands.
NOT_WANTED = {
    "unittest.mock",
    "invoke.vendor.yaml",
    "importlib.metadata",
    "fabric",
    "invoke",
    "zipfile",
    "platform",
    "decimal",
    "asyncio",
    "ssl",
    "email",
    "http",
    "rich",
    "statistics",
    "psutil",
    "numpy",
    "multiprocessing",
    "edgectl.experiments",
    "edgectl.importers",
    "edgectl.solver",
    "edgectl.tui",
    "edgectl.web",
    "edgectl.doctor",
    "edgectl.scaffold",
}
SSH = {"paramiko", "cryptography", "nacl"}
PLANNING = {"edgectl.scheduler.assign", "edgectl.executor.diff"}


@dataclass(frozen=True, kw_only=True)
class Start:
    """What one command imported, compiled and started, and its requests to the host in their order."""

    code: int
    modules: set[str]
    compiled: int
    connections: int
    processes: int
    requests: list[str]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """A fleet of one real SSH host, whose task runs; and the environment of commands."""
    folder = tmp_path_factory.mktemp("startup")
    (folder / "inventories").mkdir()
    (folder / "tasks").mkdir()
    (folder / "inventories" / "lab.yaml").write_text(
        "version: 1\nfleet: startup\nedges:\n  edge1: {host: edge1}\n"
        "robots:\n  robot1: {host: 127.0.0.1, probe: false}\n"
    )
    (folder / "tasks" / "lab.yaml").write_text(
        "version: 1\ntasks:\n  beat: {robot: robot1, command: sleep 1000, demand: {cpu: 0, memory: 0, throughput: 0}}\n"
    )
    with running_lab(folder / "lab", ["edge1"]) as lab:
        env = {
            **os.environ,
            **lab.environment,
            "EDGECTL_STATE_DIR": str(folder / "state"),
            "STARTUP_REPORT": str(folder / "report.json"),
        }
        start(folder, env, "probe", "--window", "0", "--out", "snap.json")
        yield folder, env


def start(folder: Path, env: dict[str, str], *words: str) -> Start:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words, "-v", "--log-format", "json"],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(Path(env["STARTUP_REPORT"]).read_text())
    said = [json.loads(line) for line in done.stderr.splitlines() if line.startswith('{"at"')]
    requests = [event["operation"] for event in said if "operation" in event]
    return Start(**{**report, "modules": set(report["modules"]), "requests": requests})


@pytest.mark.parametrize(
    ("words", "most_modules", "most_compiled", "foreign"),
    [
        (("--help",), 154, 30, SSH | PLANNING),
        (("validate",), 293, 36, SSH | PLANNING),
        (("plan", "--snapshot", "snap.json"), 432, 71, SSH),
        (("probe", "--window", "0"), 503, 50, PLANNING | {"edgectl.views.results", "edgectl.views.reasons"}),
        (("plan",), 570, 80, set()),
        (("apply", "-y"), 611, 86, set()),
        (("status",), 568, 79, set()),
        (("logs", "beat"), 452, 44, PLANNING),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_a_command_imports_and_compiles_no_more_than(
    fleet: tuple[Path, dict[str, str]],
    words: tuple[str, ...],
    most_modules: int,
    most_compiled: int,
    foreign: set[str],
) -> None:
    if words[0] == "logs":
        start(
            *fleet, "apply", "-y", "--best-effort"
        )  # the order of the cases is not given; nor is an idle machine
    seen = start(*fleet, *words)
    assert seen.code == 0
    assert sorted(seen.modules & (NOT_WANTED | foreign)) == []
    assert len(seen.modules) <= most_modules
    assert seen.compiled <= most_compiled


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("validate",), []),
        (("plan", "--snapshot", "snap.json"), []),
        (("probe", "--window", "0"), ["login", "probe"]),
        (("plan",), ["login", "probe"]),
        (("status",), ["login", "probe"]),
        (("logs", "beat"), ["login", "status", "logs"]),
    ],
    ids=lambda value: value[0] if value and isinstance(value, tuple) else "",
)
def test_a_command_asks_each_host_once(
    fleet: tuple[Path, dict[str, str]], words: tuple[str, ...], wanted: list[str]
) -> None:
    """Over one connection, and without a process: what ssh makes of its configuration is known since the first probe."""
    if words[0] == "logs":
        start(*fleet, "apply", "-y", "--best-effort")
    seen = start(*fleet, *words)
    assert (seen.code, seen.requests) == (0, wanted)
    assert (seen.connections, seen.processes) == ((1, 0) if wanted else (0, 0))


def test_ssh_is_asked_for_its_configuration_once(fleet: tuple[Path, dict[str, str]], tmp_path: Path) -> None:
    """In the first run that needs it: once for the host, once for the robot."""
    folder, env = fleet
    own = {**env, "EDGECTL_STATE_DIR": str(tmp_path / "state")}
    assert [start(folder, own, "probe", "--window", "0").processes for _ in range(2)] == [2, 0]
