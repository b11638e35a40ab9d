# SPDX-License-Identifier: Apache-2.0
"""Run every command block of the README and the docs, in order, in a scaffold per page.

Blocks that consist of edgectl commands run in this process. All others, and every block of the README and of the CI
page, run in a shell.
"""

import json
import re
import subprocess
import textwrap
import tomllib
from pathlib import Path

import pytest
import yaml

from edgectl.config.load import load_inventory_and_tasks
from edgectl.model.check import OnUnhealthy
from edgectl.model.task import NeedRestart
from edgectl.scaffold.write import write_scaffold
from tests.cli.inprocess import edgectl
from tests.compiled_agent import give_scaffold_keys
from tests.docs.blocks import Block, blocks, environment, make_tasks_idle, stopped
from tests.pace import patience
from tests.views.fixtures import ROOT, SNAPSHOT

PAGES = [
    ROOT / "README.md",
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if "adr" not in path.parts),
]
AS_WRITTEN = ("README.md", "ci.md")
# As make_tasks_idle does, for a fleet that a page makes.
IDLE = "sed -i 's/--cpu [0-9.]*/--cpu 0/' tasks/demo.yaml"
# The commands of these pages need the page's patch; test_contributing.py runs them in a patched copy.
PATCHED = ROOT / "docs" / "contributing"
WITH_COMMANDS = [
    page for page in PAGES if page.parent != PATCHED and any(not block.skipped for block in blocks(page))
]


def test_pages_are_found() -> None:
    names = {page.name for page in WITH_COMMANDS}
    assert {"README.md", "ci.md"} <= names
    # Those that need a real ROS run in tests/ros.
    exempt = [block for page in PAGES for block in blocks(page) if block.skipped]
    skipped = [block for block in exempt if "runs it" not in block.skipped]
    assert len(skipped) <= 6, "few blocks may be exempt"


@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.name)
def test_every_block_runs(page: Path, tmp_path: Path) -> None:
    site, env = tmp_path / "site", environment(tmp_path / "state")
    write_scaffold(site)
    make_tasks_idle(site)
    give_scaffold_keys(tmp_path / "state", site)
    (site / "docs").symlink_to(ROOT / "docs")
    here = site
    with stopped(env, site):
        for block in blocks(page):
            if not block.skipped:
                here = run(block, here, tmp_path / "cwd", env, page)


def run(block: Block, here: Path, note: Path, env: dict[str, str], page: Path) -> Path:
    """Run one block; the directory in which it ends, where the next begins."""
    where = f"{page.name}:{block.line}"
    if block.plain and page.name not in AS_WRITTEN:
        shown = [edgectl(words[1:], here, env) for words in block.plain]
        assert [each.code for each in shown] == [0] * len(shown), f"{where}: {shown}"
        if block.exact:
            assert [each.out for each in shown] == [output for _, output in block.commands], where
        return here
    return in_a_shell(block, here, note, env, where)


def in_a_shell(block: Block, here: Path, note: Path, env: dict[str, str], where: str) -> Path:
    lines = [f"{command}\n{IDLE}" if "edgectl init" in command else command for command, _ in block.commands]
    script = "set -e\n" + "\n".join(lines) + f"\npwd > '{note}'\n"
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=here,
        env=env,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=patience(300),
        check=False,
    )
    assert done.returncode == 0, f"{where}: {done.stdout}{done.stderr}"
    if block.exact:
        assert done.stdout == "".join(output for _, output in block.commands), where
    return Path(note.read_text().strip())


def jobs() -> list[tuple[str, list[str]]]:
    """The shell lines of each CI job of docs/ci.md."""
    found = []
    for text in re.findall(
        r"^```yaml\n(.*?)^```$", (ROOT / "docs" / "ci.md").read_text(), re.MULTILINE | re.DOTALL
    ):
        document = yaml.safe_load(text)
        if "jobs" in document:
            found.append(
                ("github", [step["run"] for step in document["jobs"]["plan"]["steps"] if "run" in step])
            )
        elif "fleet" in document:
            found.append(("gitlab", list(document["fleet"]["script"])))
    return found


@pytest.mark.parametrize(("name", "lines"), jobs(), ids=["github", "gitlab"])
def test_the_commands_of_each_job_run(name: str, lines: list[str], tmp_path: Path) -> None:
    write_scaffold(tmp_path / "repo")
    (tmp_path / "repo" / "snapshots").mkdir()
    (tmp_path / "repo" / "snapshots" / "lab.json").write_bytes(SNAPSHOT.read_bytes())
    ours = [line for line in lines if line.startswith("edgectl ")]
    assert len(ours) == {"github": 2, "gitlab": 3}[name]
    env = {
        **environment(tmp_path / "state"),
        "CI": "true",
        "GITHUB_ACTIONS": "true" if name == "github" else "",
    }
    for line in ours:
        done = subprocess.run(
            ["bash", "-ec", line], cwd=tmp_path / "repo", env=env, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "repo" / "plan.md").read_text().startswith("<!-- edgectl-plan -->\n**Plan: ")
    if name == "gitlab":
        assert json.loads((tmp_path / "repo" / "quality.json").read_text()) == []
        counts = json.loads((tmp_path / "repo" / "plan.json").read_text())
        assert counts.keys() == {"create", "update", "delete"}
    assert not (tmp_path / "state").exists(), "a plan from a snapshot leaves nothing behind"


def test_the_hook_of_pre_commit_runs_in_a_fleet(tmp_path: Path) -> None:
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    assert f"hooks: [{{id: {hook['id']}}}]" in (ROOT / "docs" / "ci.md").read_text()
    write_scaffold(tmp_path)
    files = [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.yaml")]
    assert {
        re.search(hook["files"], name) is not None for name in files if name.startswith(("inv", "tasks"))
    } == {True}
    done = subprocess.run(
        ["bash", "-ec", hook["entry"]], cwd=tmp_path, env=environment(tmp_path / "state"), check=False
    )
    assert done.returncode == 0


def test_links_between_pages_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_readme_fits_its_limits() -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    assert len(lines) <= 120
    assert [line for line in lines if len(line) > 110] == []


def test_the_paper_table_names_real_modules() -> None:
    for path in re.findall(r"`(edgectl/[\w/.]+)`", (ROOT / "docs" / "concepts" / "decision.md").read_text()):
        assert (ROOT / path).exists(), path


def test_the_files_of_the_readme_are_valid(tmp_path: Path) -> None:
    found = re.findall(
        r"^ +```yaml\n(.*?)^ +```$", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL
    )
    for name, text in zip(("lab.yaml", "tasks.yaml"), found, strict=True):
        (tmp_path / name).write_text(textwrap.dedent(text))
    inventory, tasks, _ = load_inventory_and_tasks(tmp_path / "lab.yaml", [tmp_path / "tasks.yaml"])
    assert list(inventory.hosts) == ["edge1", "edge2", "robot1"]
    assert list(tasks.tasks) == ["navigation-robot1", "slam-robot1"]


def test_the_bringup_of_the_ros_page_is_valid(tmp_path: Path) -> None:
    """Its two files, as they stand there; without a word of warning."""
    text = (ROOT / "docs" / "ros.md").read_text()
    for block, name in re.findall(r"^```yaml\n(# (\S+)\n.*?)^```$", text, re.MULTILINE | re.DOTALL):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(block)
    done = edgectl(["validate"], tmp_path, environment(tmp_path / "state"))
    assert (done.code, done.out, done.err) == (0, "ok: 2 edges, 1 robot, 3 tasks\n", "")
    _, tasks, _ = load_inventory_and_tasks(
        tmp_path / "inventories" / "lab.yaml", [tmp_path / "tasks" / "bringup.yaml"]
    )
    slam = tasks.tasks["slam-robot1"]
    assert slam.command == "rosrun gmapping slam_gmapping __name:=robot1_slam scan:=/robot1/scan"
    assert slam.alive is not None
    assert slam.alive.check.describe() == "node /robot1_slam is alive, a message on /robot1/map within 2 s"
    assert slam.alive.on_unhealthy is OnUnhealthy.RESTART
    assert [(need.task, need.restart) for need in slam.needs] == [("roscore", NeedRestart.WITH)]


def test_every_dependency_has_its_reason() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [
        package
        for name, packages in project["optional-dependencies"].items()
        if name != "dev"
        for package in packages
    ]
    declared = [re.split(r"[<>=]", package)[0] for package in (*project["dependencies"], *extras)]
    page = (ROOT / "docs" / "dependencies.md").read_text()
    assert len(declared) >= 9
    assert all(re.search(rf"\b{name}\b", page) for name in declared)
