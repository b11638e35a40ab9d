# SPDX-License-Identifier: Apache-2.0
"""The files for other people's CI: their commands run on a scaffold, and the image is built where a builder is."""

import json
import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft7Validator

from edgectl.scaffold.write import write_scaffold
from tests.docs.blocks import environment
from tests.views.fixtures import ROOT, SNAPSHOT

CI = ROOT / ".ci"


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    write_scaffold(tmp_path / "repo" / "fleet")
    (tmp_path / "repo" / "fleet" / "lab.json").write_bytes(SNAPSHOT.read_bytes())
    return tmp_path / "repo" / "fleet"


def run(script: str, here: Path, state: Path, **more: str) -> subprocess.CompletedProcess[str]:
    env = {**environment(state), "CI": "true", **more}
    return subprocess.run(
        ["bash", "-eo", "pipefail", "-c", script],
        cwd=here,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_action_validates_and_plans(fleet: Path, tmp_path: Path) -> None:
    action = yaml.safe_load((CI / "action.yml").read_text())
    steps = {step["name"]: step for step in action["runs"]["steps"]}
    assert list(steps) == ["Install", "Validate", "Plan"]
    assert all(step["shell"] == "bash" for step in steps.values())
    assert "${{" not in "".join(step["run"] for step in steps.values()), (
        "inputs reach a shell as variables only"
    )
    assert run(steps["Validate"]["run"], fleet, tmp_path / "state").returncode == 0
    more = {
        "SNAPSHOT": "lab.json",
        "RUNNER_TEMP": str(tmp_path),
        "GITHUB_STEP_SUMMARY": str(tmp_path / "summary"),
        "GITHUB_OUTPUT": str(tmp_path / "output"),
    }
    done = run(steps["Plan"]["run"], fleet, tmp_path / "state", **more)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "output").read_text() == f"file={tmp_path}/plan.md\n"
    assert (tmp_path / "summary").read_text() == (tmp_path / "plan.md").read_text() != ""
    (fleet / "tasks" / "demo.yaml").write_text("version: 1\ntasks: {slam: {comand: x}}\n")
    broken = run(steps["Validate"]["run"], fleet, tmp_path / "state")
    assert (broken.returncode, "::error file=tasks/demo.yaml" in broken.stdout) == (64, True)


def test_the_template_of_gitlab_reports_mistakes(fleet: Path, tmp_path: Path) -> None:
    template = yaml.safe_load((CI / "gitlab.yml").read_text())
    assert {template[job]["extends"] for job in ("edgectl-validate", "edgectl-plan")} == {".edgectl"}
    more = {"CI_PROJECT_DIR": str(tmp_path), "EDGECTL_DIRECTORY": str(fleet), "EDGECTL_SNAPSHOT": "lab.json"}
    for job in ("edgectl-validate", "edgectl-plan"):
        done = run("\n".join(template[job]["script"]), tmp_path, tmp_path / "state", **more)
        assert done.returncode == 0, done.stderr
    report = tmp_path / template["edgectl-validate"]["artifacts"]["reports"]["codequality"]
    assert json.loads(report.read_text()) == []
    assert (
        (tmp_path / template["edgectl-plan"]["artifacts"]["paths"][0])
        .read_text()
        .startswith("<!-- edgectl-plan -->")
    )
    counts = json.loads(
        (tmp_path / template["edgectl-plan"]["artifacts"]["reports"]["terraform"]).read_text()
    )
    assert counts.keys() == {"create", "update", "delete"}
    assert sum(counts.values()) > 0
    (fleet / "tasks" / "demo.yaml").write_text("version: 1\ntasks: {slam: {comand: x}}\n")
    assert (
        run(
            "\n".join(template["edgectl-validate"]["script"]), tmp_path, tmp_path / "state", **more
        ).returncode
        == 64
    )
    (first, *_) = json.loads(report.read_text())
    assert (first["location"]["path"], first["location"]["lines"]["begin"]) == ("tasks/demo.yaml", 2)


def test_the_image_is_given_all_that_a_wheel_is_made_of_and_nothing_else() -> None:
    """Neither the environments nor the history of a clone, but what the links of the package lead to."""
    lines = [line.split() for line in (CI / "Containerfile").read_text().splitlines()]
    copied = {
        name
        for words in lines
        if words[:1] == ["COPY"] and "--from=build" not in words
        for name in words[1:-1]
    }
    links = [path.resolve().relative_to(ROOT) for path in (ROOT / "edgectl").rglob("*") if path.is_symlink()]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {
        "pyproject.toml",
        ".ci/published_metadata.py",
        "README.md",
        "edgectl",
        *project["license-files"],
    }
    assert copied == needed | {path.parts[0] for path in links}
    sent = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    assert set(sent) == copied, "a builder is sent what is copied, and no environment of gigabytes"


def test_the_image_is_described_as_a_builder_reads_it() -> None:
    """tests/containers/test_image.py builds it (make containers)."""
    text = (CI / "Containerfile").read_text()
    words = [
        line.split()[0]
        for line in text.replace("\\\n", " ").splitlines()
        if line and not line.startswith("#")
    ]
    assert words.count("FROM") == 2
    assert words[-1] == "ENTRYPOINT"
    assert text.index("USER edgectl") < text.index("ENTRYPOINT"), "it does not run as root"
    said = subprocess.run(
        ["make", "-n", "image", "BUILDER=echo"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert "echo build --file .ci/Containerfile --tag edgectl" in said


def read_yaml(text: str) -> Any:
    """YAML as forges read it: ``on`` is no truth value."""
    found = yaml.safe_load(text)
    return {"on" if key is True else key: value for key, value in found.items()}


def list_forge_files() -> list[tuple[str, str, str]]:
    """Name, text and schema of each file for a forge, also of those that docs/ci.md shows."""
    files = {
        ".github/workflows/tests.yml": "github-workflows",
        ".ci/action.yml": "github-actions",
        ".ci/gitlab.yml": "gitlab-ci",
        ".ci/tests.gitlab.yml": "gitlab-ci",
    }
    found = [(name, (ROOT / name).read_text(), schema) for name, schema in files.items()]
    page = (ROOT / "docs" / "ci.md").read_text()
    for text in re.findall(r"^```yaml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
        if first := re.match(r"# \.(github/workflows|gitlab-ci)", text):
            schema = "gitlab-ci" if first[1] == "gitlab-ci" else "github-workflows"
            found.append((f"docs/ci.md: {schema}", text, schema))
    return found


FORGE_FILES = list_forge_files()


@pytest.mark.parametrize(("name", "text", "schema"), FORGE_FILES, ids=[name for name, _, _ in FORGE_FILES])
def test_a_forge_takes_the_file(name: str, text: str, schema: str) -> None:
    """By the schemas that editors know for these files; they are taken out of the package check-jsonschema."""
    rules = json.loads((ROOT / ".venv" / "share" / "schemas" / "forges" / f"{schema}.json").read_text())
    validator = Draft7Validator(rules)
    value = read_yaml(text)
    assert [error.message for error in validator.iter_errors(value)] == []
    broken = {
        "github-workflows": {"jobs": {"x": {"stepz": 1}}},
        "github-actions": {"runs": {}},
        "gitlab-ci": {"x": {"script": 1}},
    }
    assert not validator.is_valid(value | broken[schema]), "the schema refuses something"


def test_forges_run_the_fast_suite_with_each_python_and_build_the_image() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    claimed = [each.rpartition(" ")[2] for each in project["classifiers"] if re.search(r":: 3\.\d", each)]
    github = read_yaml((ROOT / ".github" / "workflows" / "tests.yml").read_text())["jobs"]
    gitlab = read_yaml((CI / "tests.gitlab.yml").read_text())
    assert github["versions"]["strategy"]["matrix"]["python"] == claimed
    assert gitlab["versions"]["parallel"]["matrix"] == [{"PYTHON_VERSION": claimed}]
    floor = project["requires-python"].removeprefix(">=")
    assert gitlab["lowest"]["image"] == f"python:{floor}-bookworm"
    commands = {name: [step["run"] for step in job["steps"] if "run" in step] for name, job in github.items()}
    assert commands["versions"] == gitlab["versions"]["script"] == ["make test-fast"]
    assert commands["lowest"] == gitlab["lowest"]["script"] == ["make lowest"]
    assert commands["image"][:2] == gitlab["container"]["script"]
    for line in [line for lines in commands.values() for line in lines if line.startswith("make ")]:
        subprocess.run([*line.split(), "-n"], cwd=ROOT, capture_output=True, check=True)
