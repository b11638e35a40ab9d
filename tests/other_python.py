# SPDX-License-Identifier: Apache-2.0
"""The newest other Python of this machine: edgectl installed as its image does it, and a slice of the fast suite.

``python -m tests.other_python``; a part of ``make test``. All of the fast suite, and the lowest versions: ``make versions``.
"""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.containers.image_steps import install_as_image
from tests.views.fixtures import ROOT, SNAPSHOT

TOOLS = ("pytest", "pytest-timeout", "pytest-xdist", "hypothesis", "jsonschema")
# Some twenty seconds of what needs no extra: values and their rules, steps of a plan, the history.
SLICE = ("doctor", "executor", "model", "rules", "state/test_store.py", "state/test_store_metrics.py")
ABSENT = "== no other Python here (3.12 to 3.14): the tests ran with one only"


def find_other_python() -> Path | None:
    """The newest interpreter that ``make versions`` would take."""
    said = subprocess.run(
        [ROOT / ".ci" / "pythons", "--newest"], capture_output=True, text=True, check=True
    ).stdout.strip()
    return Path(said) if said else None


def try_commands(python: Path, folder: Path) -> None:
    """Use the installed edgectl, away from the clone."""
    for words in (
        ["version"],
        ["init", "fleet"],
        ["validate"],
        ["plan", "--snapshot", str(SNAPSHOT), "--allow-unreachable"],
    ):
        here = folder / "fleet" if (folder / "fleet").exists() else folder
        done = subprocess.run(
            [python.parent / "edgectl", *words],
            cwd=here,
            env={**os.environ, "EDGECTL_STATE_DIR": str(folder / "state")},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            sys.exit(f"edgectl {words[0]} ended with {done.returncode}: {done.stderr}")


def main() -> int:
    """Exit status of the slice; 0 with a line that says so where there is no other Python."""
    # Whoever ends this ends what it runs: subprocess.run kills its child on the way out.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    other = find_other_python()
    if other is None:
        print(ABSENT)
        return 0
    with tempfile.TemporaryDirectory() as name:
        made = install_as_image(other, Path(name))
        try_commands(made, Path(name))
        pip = [sys.executable, "-m", "pip", "--python", str(made), "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "install", "--no-compile", *TOOLS], check=True)
        print(f"== {other}", flush=True)
        tests = [f"tests/{each}" for each in SLICE]
        return subprocess.run(
            [made, "-m", "tests.suite", *tests, "-m", "not slow", "-rs"], cwd=ROOT, check=False
        ).returncode


if __name__ == "__main__":
    sys.exit(main())
