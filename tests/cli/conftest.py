# SPDX-License-Identifier: Apache-2.0
"""Fixtures: a scaffold as the working directory, and the command as a function."""

from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.cli.main import main
from edgectl.scaffold.write import write_scaffold
from edgectl.state.paths import get_state_root
from tests.cli.inprocess import Said
from tests.compiled_agent import give_scaffold_keys
from tests.views.fixtures import SNAPSHOT

Run = Callable[..., Said]


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scaffold with a snapshot, as the working directory."""
    write_scaffold(tmp_path / "site")
    give_scaffold_keys(get_state_root(), tmp_path / "site")
    (tmp_path / "site" / "snap.json").write_bytes(SNAPSHOT.read_bytes())
    monkeypatch.chdir(tmp_path / "site")
    return tmp_path / "site"


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the command line in this process."""

    def call(*words: str) -> Said:
        code = main(words)
        out, err = capfd.readouterr()
        return Said(int(code), out, err)

    return call
