# SPDX-License-Identifier: Apache-2.0
"""Run every example of every command's help as printed, those of a running fleet in a natural order.

Most run in this process, which saves the start of Python; those that need a terminal, a signal or a port are
processes of their own.
"""

import contextlib
import io
import os
import shlex
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from edgectl.cli.app import COMMANDS, GROUP_EXAMPLES, split_docstring
from edgectl.scaffold.write import write_scaffold
from tests.cli.conftest import Run
from tests.cli.inprocess import Said
from tests.cli.terminal import Terminal
from tests.compiled_agent import give_scaffold_keys
from tests.docs.blocks import blocks, make_tasks_idle, stopped
from tests.forkserver import ForkedProcess
from tests.pace import patience
from tests.ros1_peer import serve_master
from tests.rospy_standin import write_standin

DOCS = Path(__file__).parents[2] / "docs"
ENDLESS = ("edgectl logs slam-robot1 -f --since 10m",)
SERVING = ("edgectl export prometheus --listen 127.0.0.1:9815",)
SHOWING = (
    "edgectl serve",
    "edgectl serve --listen 9900 --every 2s",
    "edgectl serve --listen 127.0.0.1:9817 --token-file serve.token",
)
# With a stand-in for the packages of ROS; make ros runs them with real ones.
PUBLISHING = ("edgectl export ros", "edgectl export ros --setup /opt/ros/humble/setup.bash")
WATCHING = ("edgectl watch --apply --every 30s",)
# They become another program.
BECOMING = ("edgectl exec", "edgectl ssh")
ASKING = ("edgectl apply", "edgectl drain edge1", "edgectl rollback")
BUSY = 75  # the demo's tasks run
FULL = 4  # the other edges of the demo have no room for all that runs on edge1
CODES = {
    "edgectl events test --kind task-failed": 64,  # the example fleet states no on_event
    "edgectl plan --without edge2 --detailed-exitcode": 3,  # slam-robot2 is pinned there
    "edgectl simulate merge docs/scenarios/sweep-robots.yaml part-1 part-2": 1,  # no other machine was here
    "edgectl simulate merge docs/scenarios/sweep-robots.yaml part-1 part-2 -o csv": 1,
    "edgectl profile slam-robot1 --write --yes": 1,  # too few samples after these few commands
    "edgectl logs slam-robot1 --previous --tail 20": 1,  # it has run once
    "edgectl wait map-merge --for completed --timeout 2s": 1,
    "edgectl wait slam-robot1 --for gone --timeout 2s": 1,
    "edgectl drain edge1": FULL,
    "edgectl experiment run tasks/patrol/experiment.yaml": BUSY,
    "edgectl experiment run tasks/patrol/experiment.yaml -n 1 --out again": BUSY,
    "edgectl drain edge1 --yes --timeout 10m": FULL,
}
FIRST = ("edgectl init demo", "edgectl init .")
EARLY = ("edgectl plan --out next.plan", "edgectl show next.plan", "edgectl apply next.plan")
LATE = ("edgectl rollback", "edgectl drain", "edgectl stop")
# These only read files; each gets its own scaffold.
OF_FILES = ("edgectl import", "edgectl simulate", "edgectl experiment show", "edgectl report", "edgectl ssim")

# They change the rules of a kernel: tests/agent/test_counters.py runs these commands on computers of its own.
OF_ROOT = ("edgectl counters",)


def examples() -> list[str]:
    from importlib import import_module

    found: list[str] = []
    for name, entry in COMMANDS.items():
        function = getattr(
            import_module(f"edgectl.{entry.module}"), f"{name.replace(' ', '_').replace('-', '_')}_command"
        )
        found += [line.strip() for line in split_docstring(function)[1].splitlines()]
    found += [line for lines in GROUP_EXAMPLES.values() for line in lines if line not in found]
    early = [line for start in EARLY for line in found if line.startswith(start)]
    late = [line for start in LATE for line in found if line.startswith(start)]
    middle = [line for line in found if line not in (*FIRST, *early, *late)]
    return [*early, *middle, *late]


def starts_a_process(line: str) -> bool:
    return (
        line.startswith(BECOMING)
        or line in (*ASKING, *WATCHING, *ENDLESS, *SERVING, *SHOWING, *PUBLISHING)
        or "-w" in line.split()
    )


def run_process(line: str, site: Path, env: dict[str, str]) -> int:
    words = line.split()[1:]
    if line.startswith(BECOMING):
        with Terminal(words, site, env=env) as terminal:
            terminal.type("exit 0\n")
            return terminal.wait()
    if line in ASKING:
        with Terminal(words, site, env=env) as terminal:
            terminal.type("yes\n")
            return terminal.wait()
    if line in WATCHING:
        with Terminal(words, site, env=env) as terminal:
            terminal.until("next in")
            terminal.type("q")
            return terminal.wait()
    if line in ENDLESS:
        return follow(words, site, env)
    if line in SERVING:
        return serve([word.replace(":9815", ":0") for word in words], site, env)
    if line in SHOWING:
        return serve([*words, "--listen", "127.0.0.1:0"], site, env)
    if line in PUBLISHING:
        return publish(words[:2], site, env)
    return watch(words, site, env)


def follow(words: list[str], site: Path, env: dict[str, str]) -> int:
    """Follow the log until it shows a line of the task."""
    process = ForkedProcess(words, cwd=site, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    with process.stdout as lines:
        assert any("alive" in lines.readline() for _ in range(3))
        process.send_signal(signal.SIGINT)
        assert process.wait(patience(30)) == 130
    return 0


def watch(words: list[str], site: Path, env: dict[str, str]) -> int:
    """Until it has shown something."""
    process = ForkedProcess(words, cwd=site, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    with process.stdout as lines:
        assert lines.readline()
        process.send_signal(signal.SIGINT)
        return process.wait(patience(30))


def serve(words: list[str], site: Path, env: dict[str, str]) -> int:
    """On a free port, until it serves."""
    process = ForkedProcess(words, cwd=site, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    with process.stderr as said:
        assert any("serving http" in said.readline() for _ in range(2))
        process.send_signal(signal.SIGINT)
        return process.wait(patience(30))


def publish(words: list[str], site: Path, env: dict[str, str]) -> int:
    """With a master and packages of the test, until it publishes."""
    setup = write_standin(site)
    with serve_master() as master:
        process = ForkedProcess(
            [*words, "--setup", str(setup)],
            cwd=site,
            env={**env, "ROS_MASTER_URI": master.uri},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        assert process.stderr is not None
        with process.stderr as said:
            assert any("publishing /diagnostics" in said.readline() for _ in range(5))
            process.send_signal(signal.SIGINT)
            return process.wait(patience(30))


@pytest.fixture
def env(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """The environment of processes, and of this one."""
    own = {
        "EDGECTL_STATE_DIR": str(tmp_path / "state"),
        "COLUMNS": "80",
        "TERM": "xterm",
        "SHELL": "/bin/bash",
    }
    for name, value in own.items():
        monkeypatch.setenv(name, value)
    return dict(os.environ)


def in_this_process(line: str, run: Run) -> int:
    """The exit code; of a pipe, that of the last command, which reads what the one before has printed."""
    said = Said(0, "", "")
    for command in line.split(" | "):
        assert command.startswith("edgectl ")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(said.out.encode())))
            said = run(*shlex.split(command)[1:])
    return said.code


def examples_of_files() -> list[str]:
    """Without those that a page of the docs has word for word: tests/docs/test_pages.py runs them."""
    pages = (page for page in DOCS.rglob("*.md") if not {"adr", "contributing"} & {*page.parts})
    on_pages = {
        command
        for page in pages
        for block in blocks(page)
        if not block.skipped
        for command, _ in block.commands
    }
    return [line for line in examples() if line.startswith(OF_FILES) and line not in on_pages]


@pytest.mark.parametrize("line", examples_of_files())
def test_every_example_of_files_runs(
    line: str, tmp_path: Path, env: dict[str, str], run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "demo"
    write_scaffold(site)
    (site / "docs").symlink_to(DOCS)
    for file in (DOCS / "examples" / "launch").iterdir():
        shutil.copy(file, site)
    monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(site / "ssh_config"))
    monkeypatch.chdir(site)
    with contextlib.ExitStack() as stack:
        if "--live" in line:
            master = stack.enter_context(serve_master())
            [inventory] = (site / "inventories").glob("*.yaml")
            ros = f'defaults:\n  ros: {{version: 1, master: "{master.uri}"}}\n'
            inventory.write_text(inventory.read_text().replace("defaults:\n", ros))
        assert in_this_process(line, run) == CODES.get(line, 0)


@pytest.mark.timeout(900)
def test_every_example_of_a_running_fleet_runs(
    tmp_path: Path, env: dict[str, str], run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "demo"
    for line, where in zip(FIRST, (tmp_path, site), strict=True):
        monkeypatch.chdir(where)
        assert in_this_process(line, run) == 0
    (site / "docs").symlink_to(DOCS)
    make_tasks_idle(site)
    give_scaffold_keys(tmp_path / "state", site)
    codes = {}
    with stopped(env, site):
        for line in examples():
            if not line.startswith((*OF_FILES, *OF_ROOT)):
                codes[line] = (
                    run_process(line, site, env) if starts_a_process(line) else in_this_process(line, run)
                )
        assert {line: code for line, code in codes.items() if code != CODES.get(line, 0)} == {}
        assert sum(map(starts_a_process, codes)) >= 10
