# SPDX-License-Identifier: Apache-2.0
"""No hint and no page leads to ``edgectl`` of a package index, which is another author's program."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from edgectl.cli.extras import DISTRIBUTION, build_install_command
from tests.views.fixtures import ROOT

TEXT_SUFFIXES = ("", ".md", ".py", ".sh", ".toml", ".yaml", ".yml", ".patch", ".html", ".txt", ".json")
GIT = {"url": "https://git.lab/edgectl.git", "vcs_info": {"vcs": "git", "commit_id": "c0ffee"}}
TAG = {**GIT, "vcs_info": {"vcs": "git", "commit_id": "c0ffee", "requested_revision": "v1"}}
CLONE = {"url": "file:///home/ana/my%20edgectl", "dir_info": {}}
WHEEL = {"url": "file:///w/edgectl_robotics-1-py3-none-any.whl", "archive_info": {}}


@pytest.mark.parametrize(
    ("origin", "receipt", "command"),
    [
        (None, "", "{}/bin/python -m pip install 'edgectl-robotics[tui]'"),
        (None, "uv-receipt.toml", "uv tool install 'edgectl-robotics[tui]'"),
        (CLONE, "uv-receipt.toml", "uv tool install '/home/ana/my edgectl[tui]'"),
        (CLONE, "pipx_metadata.json", "pipx install --force '/home/ana/my edgectl[tui]'"),
        (
            {"url": "file:///src", "dir_info": {"editable": True}},
            "",
            "{}/bin/python -m pip install --editable '/src[tui]'",
        ),
        (
            GIT,
            "",
            "{}/bin/python -m pip install 'edgectl-robotics[tui] @ git+https://git.lab/edgectl.git@c0ffee'",
        ),
        (
            TAG,
            "uv-receipt.toml",
            "uv tool install 'edgectl-robotics[tui] @ git+https://git.lab/edgectl.git@v1'",
        ),
        (WHEEL, "", "{}/bin/python -m pip install 'edgectl-robotics[tui] @ " + WHEEL["url"] + "'"),  # type: ignore[operator]
    ],
)
def test_the_hint_names_where_edgectl_came_from(
    tmp_path: Path, origin: dict[str, Any] | None, receipt: str, command: str
) -> None:
    if receipt:
        (tmp_path / receipt).touch()
    assert build_install_command("tui", origin, tmp_path) == command.format(tmp_path)


def test_the_distribution_has_the_name_of_the_hint() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["name"] == DISTRIBUTION
    assert not misleading("\n".join(sum(project["optional-dependencies"].values(), project["dependencies"])))


def misleading(text: str) -> list[str]:
    """The lines of a text that install ``edgectl``, or name it with an extra."""
    install = r"\b(?:pip3?|pipx|uvx?|poetry|pdm|conda|mamba|easy_install)\b(?:(?!\s{2}|[|&;]).)*?"
    own = r"(?<![\w./@:+-])edgectl(?![\w./:@+-])"
    pattern = re.compile(rf"{install}\b(?:install|add|upgrade|run|tool)\b.*{own}|\buvx\s+{own}|\bedgectl\[")
    return [line for line in text.splitlines() if pattern.search(line)]


def test_what_is_misleading_is_found() -> None:
    for line in (
        "pip install edgectl",
        "    - pip install --upgrade edgectl",
        'uv tool install "edgectl[tui]"',
        "uv tool upgrade edgectl",
        "uvx edgectl plan",
        "pipx run edgectl",
        "Needs the extra edgectl[metrics].",
    ):
        assert misleading(line), line
    for line in (
        "uv tool install .",
        "pip install wheels/edgectl_robotics-0.1.0-py3-none-any.whl",
        "pip install 'edgectl-robotics[tui]'",
        "installing edgectl into .venv ...",
    ):
        assert not misleading(line), line


def test_no_page_and_no_message_leads_to_the_other_program() -> None:
    files = [
        path
        for name in ("edgectl", "docs", "tests", "tasks", "inventories", ".ci", ".")
        for path in (ROOT / name).glob("*" if name == "." else "**/*")
        if path.is_file() and path.suffix in TEXT_SUFFIXES and path.name != Path(__file__).name
    ]
    assert len(files) > 500
    found = {path: lines for path in files if (lines := misleading(path.read_text("utf-8", "replace")))}
    assert found == {}


def test_a_missing_package_is_said_with_the_command(tmp_path: Path) -> None:
    code = "import sys; sys.modules['prometheus_client'] = None\nfrom edgectl.cli.main import main\nsys.exit(main(['export', 'prometheus']))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 64
    first, hint = done.stderr.splitlines()
    assert first == "error: this needs prometheus_client, which is not installed"
    assert re.fullmatch(r"hint: \S+ -m pip install --editable '\S+\[metrics\]'", hint), hint
