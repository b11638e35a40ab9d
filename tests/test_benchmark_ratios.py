# SPDX-License-Identifier: Apache-2.0
"""The table that ``make bench`` ends with: what was noted, and which goals are missed."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks import ratios
from tests.benchmarks.__main__ import OF_TWO_VERSIONS, list_benchmarks


def test_noted_ratios_stand_in_one_table_with_their_goals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted = tmp_path / "ratios"
    monkeypatch.setenv(ratios.VARIABLE, str(noted))
    ratios.note_ratio("apply", 1.31, of="the programs' own start", most=1.3)
    ratios.note_ratio("probe", 1.3, of="ssh", most=1.3)
    ratios.note_ratio("probe", 0.5, of="Fabric")
    found = ratios.read_ratios(noted)
    assert [each.met for each in found] == [False, True, True]
    assert ratios.format_table(found).splitlines()[2:] == [
        "| apply | the programs' own start | 1.31 | 1.3 | no |",
        "| probe | ssh | 1.30 | 1.3 | yes |",
        "| probe | Fabric | 0.50 |  |  |",
    ]


def test_a_benchmark_by_itself_notes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ratios.VARIABLE, raising=False)
    monkeypatch.chdir(tmp_path)
    ratios.note_ratio("probe", 0.5, of="Fabric")
    assert list(tmp_path.iterdir()) == []


def test_every_benchmark_that_can_be_run_is_run() -> None:
    here = Path(ratios.__file__).parent
    modules = {path.stem for path in here.glob("*.py")} - {"__init__", "__main__", "ratios", "test_planner"}
    assert set(list_benchmarks()) == modules - set(OF_TWO_VERSIONS)


@pytest.mark.parametrize("name", OF_TWO_VERSIONS)
def test_a_benchmark_of_two_versions_asks_for_the_other(name: str) -> None:
    command = [sys.executable, "-m", f"tests.benchmarks.{name}"]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"usage: python -m tests.benchmarks.{name} FOLDER")
