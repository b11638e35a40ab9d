# SPDX-License-Identifier: Apache-2.0
"""init, validate, completion: files only."""

import json
import os
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from edgectl.cli.schema import EDITED_KINDS
from edgectl.config.load import load_inventory_and_tasks
from edgectl.scaffold.write import SCAFFOLD_FILES
from tests.cli.conftest import Run
from tests.forkserver import run_edgectl
from tests.pace import patience
from tests.views.fixtures import ROOT


def test_init_writes_a_fleet_that_validates(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a b' $c: #d"
    said = run("init", str(target))
    assert said.code == 0
    schemas = [f".edgectl/schemas/{kind}.json" for kind in EDITED_KINDS]
    assert all((target / name).is_file() for name in [*SCAFFOLD_FILES, *schemas])
    patrol = [name for name in SCAFFOLD_FILES if name.startswith("tasks/patrol/")]
    assert [line.removeprefix(f"wrote {target}/") for line in said.out.splitlines()] == [
        *SCAFFOLD_FILES[:5],
        f"tasks/patrol/ ({len(patrol)} files)",
        f".edgectl/schemas/ ({len(schemas)} files)",
    ]
    assert said.err == f"next: cd {shlex.quote(str(target))} && edgectl plan\n"
    first_line = (target / "tasks" / "patrol" / "tasks.yaml").read_text().split("\n")[0]
    named = first_line.removeprefix("# yaml-language-server: $schema=")
    assert (target / "tasks" / "patrol" / named).resolve() == (
        target / ".edgectl/schemas/tasks.json"
    ).resolve()
    inventory, tasks, warnings = load_inventory_and_tasks(
        target / "inventories" / "local.yaml", [target / "tasks" / "demo.yaml"]
    )
    assert (len(inventory.edges), len(inventory.robots), len(tasks.tasks), warnings) == (3, 3, 10, ())
    prelude = next(iter(inventory.hosts.values())).prelude
    assert subprocess.run(
        ["sh", "-c", prelude + "\npwd -P"], capture_output=True, text=True, check=True
    ).stdout.strip() == str(target.resolve())
    monkeypatch.chdir(target)
    assert run("validate").out == "ok: 3 edges, 3 robots, 10 tasks\n"


def test_init_never_overwrites(run: Run, tmp_path: Path) -> None:
    (tmp_path / "tasks").mkdir()
    (tmp_path / "tasks" / "demo.yaml").write_text("mine")
    (tmp_path / "tasks" / "patrol").mkdir()
    (tmp_path / "tasks" / "patrol" / "world.py").write_text("mine, too")
    said = run("init", str(tmp_path))
    assert f"kept  {tmp_path / 'tasks' / 'demo.yaml'}\n" in said.out
    assert f"kept  {tmp_path / 'tasks' / 'patrol' / 'world.py'}\n" in said.out
    assert f"wrote {tmp_path / 'tasks' / 'patrol'}/ (20 files)\n" in said.out
    assert len(said.out.splitlines()) < 24, "a screen, with the next command below"
    assert (tmp_path / "tasks" / "demo.yaml").read_text() == "mine"


def test_init_where_nothing_can_be_written(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    said = run("init", str(tmp_path / "file" / "below"))
    assert said.code == 1
    assert said.err.startswith("error: cannot write ")


def test_a_wheel_holds_the_files_themselves(tmp_path: Path) -> None:
    """The scaffold consists of links in the repository; an installed edgectl must not need the repository."""
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--disable-pip-version-check",
        "--wheel-dir",
        str(tmp_path),
        str(ROOT),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=patience(110))
    with zipfile.ZipFile(next(tmp_path.glob("*.whl"))) as wheel:
        for name in SCAFFOLD_FILES[2:]:
            assert wheel.read(f"edgectl/scaffold/{name}") == (ROOT / name).read_bytes()
        assert "edgectl/scaffold/edgectl.yaml" in wheel.namelist()
        assert any(name.startswith("edgectl/agent/") for name in wheel.namelist())
        assert "edgectl/experiments/report/page.html" in wheel.namelist()


def test_validate_shows_every_mistake_in_each_form(run: Run, site: Path) -> None:
    inventory = site / "inventories" / "local.yaml"
    inventory.write_text(inventory.read_text().replace("capacity", "capasity"))
    said = run("validate")
    assert (said.code, said.out) == (64, "")
    assert said.err.count("did you mean capacity?") == 6
    assert said.err.count("^^^^^^^^") == 6
    problems = json.loads(run("validate", "-o", "json").out)["problems"]
    assert [(problem["line"], problem["hint"]) for problem in problems][:1] == [(9, "did you mean capacity?")]
    github = run("validate", "-o", "github")
    assert github.code == 64
    assert github.out.splitlines()[0].startswith("::error file=inventories/local.yaml,line=9,col=")
    gitlab = run("validate", "-o", "gitlab")
    first = json.loads(gitlab.out)[0]
    assert (gitlab.code, first["severity"], first["description"].endswith("did you mean capacity?)")) == (
        64,
        "major",
        True,
    )
    assert first["location"] == {"path": "inventories/local.yaml", "lines": {"begin": 9}}


def test_validate_of_good_files(run: Run, site: Path) -> None:
    assert run("validate", "-o", "github") == (0, "", "")
    assert run("validate", "-o", "gitlab") == (0, "[]\n", "")
    assert json.loads(run("validate", "-o", "json").out)["item"]["edge_names"] == ["edge1", "edge2", "edge3"]


COMPLETIONS = {
    "edgectl pl": ["plan"],
    "edgectl cordon edge": ["edge1", "edge2", "edge3"],
    "edgectl plan --target nav": ["navigation-robot1", "navigation-robot2", "navigation-robot3"],
    "edgectl logs map": ["map-merge"],
    "edgectl stop det": ["detection", "detection-robot1", "detection-robot2", "detection-robot3"],
    "edgectl explain det": ["detection-robot1", "detection-robot2", "detection-robot3"],
    "edgectl plan --without robot": ["robot1", "robot2", "robot3"],
    "edgectl apply --dry": ["--dry-run"],
    "edgectl plan --weights c": ["cpu"],
    "edgectl plan -l kind=service,robot=robot": [
        "kind=service,robot=robot1",
        "kind=service,robot=robot2",
        "kind=service,robot=robot3",
    ],
    "edgectl get tasks -l kind=": ["kind=service"],
    "edgectl get edges -l kind=": ["kind=edge", "kind=robot"],
    "edgectl get hosts -l kind=robot,host=edge": [f"kind=robot,host=edge{number}" for number in (1, 2, 3)],
    "edgectl rollback ": [],
}


@pytest.mark.parametrize("line", COMPLETIONS)
def test_tab_offers_names_from_the_files(site: Path, line: str) -> None:
    words = line.split(" ")
    env = {
        **os.environ,
        "_EDGECTL_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }
    done = run_edgectl(env=env)
    assert sorted(done.stdout.split()) == COMPLETIONS[line], done.stderr


def test_tab_is_quiet_where_there_are_no_files(tmp_path: Path) -> None:
    env = {
        **os.environ,
        "_EDGECTL_COMPLETE": "complete_bash",
        "COMP_WORDS": "edgectl cordon e",
        "COMP_CWORD": "2",
    }
    done = run_edgectl(env=env, cwd=tmp_path)
    assert (done.stdout.strip(), done.stderr) == ("", "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts(run: Run, shell: str) -> None:
    said = run("completion", shell)
    assert said.code == 0
    assert "_EDGECTL_COMPLETE" in said.out
