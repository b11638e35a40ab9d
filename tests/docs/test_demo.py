# SPDX-License-Identifier: Apache-2.0
"""``make demo`` does what it says, in time, and leaves nothing behind."""

import os
import re
import subprocess
import sys
import time
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.demo import LIMIT_S
from tests.docs.recording import read_cast, record_program
from tests.docs.screens import CAST, outline_demo
from tests.views.fixtures import ROOT


def list_needed_distributions(name: str) -> set[str]:
    """``name`` and what it needs without extras, installed or not, by canonical name."""
    found, waiting = set[str](), [name]
    while waiting:
        name = canonicalize_name(waiting.pop())
        if name not in found:
            found.add(name)
            lines = [Requirement(line) for line in requires(name) or ()]
            waiting += [line.name for line in lines if not line.marker or line.marker.evaluate({"extra": ""})]
    return found


def hide_extras(folder: Path) -> dict[str, str]:
    """The environment of a user who installed no extra: ``make demo`` installs none, the tests install all."""
    needed = list_needed_distributions("edgectl-robotics")
    for module, owners in packages_distributions().items():
        if needed.isdisjoint(canonicalize_name(owner) for owner in owners) and module.isidentifier():
            error = f"No module named {module!r}"
            (folder / f"{module}.py").write_text(f"raise ModuleNotFoundError({error!r}, name={module!r})\n")
    assert (folder / "numpy.py").exists()
    assert not (folder / "yaml.py").exists()
    return {**os.environ, "PYTHONPATH": str(folder)}


@pytest.mark.timeout(LIMIT_S + 30)
def test_the_demo(tmp_path: Path) -> None:
    env = hide_extras(tmp_path)
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "tests.demo"], cwd=ROOT, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert time.monotonic() - began < LIMIT_S
    assert "\n# detection-robot1 moved from " in done.stdout
    assert "# No task runs, and no process of this fleet is left.\n" in done.stdout
    shown = outline_demo(read_cast(CAST).text)
    assert shown == outline_demo(done.stdout), "run: .venv/bin/python -m tests.docs.screens --demo"


def test_its_tables_are_as_wide_as_the_terminal(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from tests.demo import *; demo = Demo(Path(sys.argv[1]));"
        "demo.run('init', str(demo.fleet)); comment('word ' * 30); demo.run('probe')"
    )
    seen = record_program(
        [sys.executable, "-c", script, str(tmp_path)], cwd=ROOT, env=dict(os.environ), width=80
    )
    # Each picture of the progress is a line of its own; the names of files are as long as they are.
    plain = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", seen.text.replace("\r", "\n")).partition("next: ")[2]
    lines = plain.splitlines()[1:]
    assert seen.code == 0, seen.text
    assert max(map(len, lines)) <= 80
    assert [line for line in lines if line.startswith("# word word")], lines
    assert sum(line.startswith("Fleet demo-") for line in lines) == 1, (
        "edgectl knows that it is shown on a terminal"
    )
