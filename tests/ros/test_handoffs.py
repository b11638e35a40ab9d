# SPDX-License-Identifier: Apache-2.0
"""Warm moves of a ROS 2 lifecycle node between computers in namespaces, as a subscriber hears them."""

import re
import subprocess
import sys

import pytest

from tests.handoffs.__main__ import find_missing
from tests.pace import patience
from tests.views.fixtures import ROOT

pytestmark = pytest.mark.skipif(bool(find_missing("ros2")), reason=find_missing("ros2"))
MOVES = 4


def test_a_lifecycle_node_moves_and_never_two_are_active() -> None:
    """In a process of its own: it joins another network for good."""
    words = ["--node", "ros2", "--moves", str(MOVES)]
    done = subprocess.run(
        [sys.executable, "-m", "tests.handoffs", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=patience(240.0),
        check=False,
    )
    assert done.returncode == 0, done
    assert "0 times two active, 0 times two heard" in done.stdout
    gap = re.search(r"^gap at the subscriber: .* most ([\d.]+) ms$", done.stdout, re.MULTILINE)
    # A cold start takes 1.4 s until its first message.
    assert gap is not None, done.stdout
    assert float(gap[1]) < patience(700.0), done.stdout
