"""``make demo`` does what it says, in time, and leaves nothing behind."""

import subprocess
import sys
import time

import pytest

from tests.demo import LIMIT_S
from tests.views.fixtures import ROOT


@pytest.mark.timeout(LIMIT_S + 30)
def test_the_demo() -> None:
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "tests.demo"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert time.monotonic() - began < LIMIT_S
    assert "\n# detection-robot1 moved from " in done.stdout
    assert "# No task runs, and no process of this fleet is left.\n" in done.stdout
