# SPDX-License-Identifier: Apache-2.0
"""What commands import and compile before they do anything: bounded by count, since times differ by machine.

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

# Runs edgectl, and writes down its modules and how many texts were compiled, such as methods of dataclasses.
PROGRAM = """
import json, os, sys
compiled = []
sys.addaudithook(lambda event, args: compiled.append(1) if event == "compile" and args[1] in (None, "<string>") else None)
from edgectl.cli.main import main
code = main()
modules = sorted(sys.modules)
with open(os.environ["STARTUP_REPORT"], "w") as report:
    json.dump({"code": code, "modules": modules, "compiled": len(compiled)}, report)
"""
# Never on the way of one of these commands.
NOT_WANTED = {
    "unittest.mock",
    "invoke.vendor.yaml",
    "importlib.metadata",
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
SSH = {"fabric", "invoke", "paramiko", "cryptography", "nacl"}
PLANNING = {"edgectl.scheduler.assign", "edgectl.executor.diff"}


@dataclass(frozen=True, kw_only=True)
class Start:
    """What one command imported and compiled."""

    code: int
    modules: set[str]
    compiled: int


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
        [sys.executable, "-c", PROGRAM, *words],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(Path(env["STARTUP_REPORT"]).read_text())
    return Start(code=report["code"], modules=set(report["modules"]), compiled=report["compiled"])


@pytest.mark.parametrize(
    ("words", "most_modules", "most_compiled", "foreign"),
    [
        (("--help",), 165, 40, SSH | PLANNING),
        (("validate",), 298, 85, SSH | PLANNING),
        (("plan", "--snapshot", "snap.json"), 431, 175, SSH),
        (("probe", "--window", "0"), 556, 170, PLANNING | {"edgectl.views.results"}),
        (("plan",), 618, 240, set()),
        (("apply", "-y"), 649, 260, set()),
        (("status",), 614, 235, set()),
        (("logs", "beat"), 506, 165, PLANNING),
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
        start(*fleet, "apply", "-y")  # the order of the cases is not given
    seen = start(*fleet, *words)
    assert not seen.modules & (NOT_WANTED | foreign)
    assert len(seen.modules) <= most_modules
    assert seen.compiled <= most_compiled
