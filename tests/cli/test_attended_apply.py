# SPDX-License-Identifier: Apache-2.0
"""`apply --yes` on a terminal, where somebody attends, and without one, as from cron or in CI (ADR 180)."""

import os
import pty
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.cli.fleet_dir import enter_fleet

TASKS = """version: 1
min_dwell: 0s
tasks:
  idle: {command: "exec sleep 600", demand: {cpu: 0.5, memory: 10Mi}, stop: {grace: 2s}}
"""


def describe_edges(**base: float) -> str:
    """An inventory of slices of one core each, of which others use ``base``."""
    edges = "".join(
        f"  {name}: {{host: 127.0.0.1, capacity: {{cpu: 1, memory: 1Gi}}, base: {{cpu: {used}}}}}\n"
        for name, used in base.items()
    )
    return f"version: 1\ndefaults: {{connection: local}}\nedges:\n{edges}"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Three edges in reverse order of their names; whatever was started is stopped."""
    inventory = describe_edges(zeta=0.0, beta=0.3, alpha=0.45)
    with enter_fleet(tmp_path, inventory, TASKS, monkeypatch) as folder:
        monkeypatch.setattr("edgectl.usecases.apply.RECHECK_WINDOW_S", 0.3)
        yield folder


@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_without_a_terminal_a_load_must_last_before_a_task_moves(
    run: Run, site: Path, monkeypatch: pytest.MonkeyPatch, quiet: tuple[str, ...]
) -> None:
    monkeypatch.delenv("CI", raising=False)
    assert run("apply", "--yes").code == 0
    assert "zeta" in run("status").out
    (site / "inventories/lab.yaml").write_text(describe_edges(zeta=0.8, beta=0.3, alpha=0.45))
    assert "move: zeta short of cpu" in run("plan").out
    said = run("apply", "--yes", *quiet)
    assert (said.code, "Applied" in said.out) == (0, False)
    ours, theirs = pty.openpty()
    with open(theirs) as terminal, monkeypatch.context() as patch:  # noqa: PTH123 - a descriptor
        patch.setattr("sys.stdin", terminal)
        assert "Applied 1 of 1" in run("apply", "--yes", *quiet).out
    os.close(ours)
    assert "beta" in run("status").out
