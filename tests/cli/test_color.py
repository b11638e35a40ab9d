# SPDX-License-Identifier: Apache-2.0
"""--color, which stands above the variables of the environment, wherever it stands on the line."""

from pathlib import Path

import pytest

from tests.cli.conftest import Run

PLAN = ("plan", "--snapshot", "snap.json")


@pytest.fixture(autouse=True)
def variables(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command sets is taken back."""
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.setenv(name, "1")
        monkeypatch.delenv(name)


@pytest.mark.parametrize(
    ("words", "variable", "coloured"),
    [
        (PLAN, "", False),
        (("--color", "always", *PLAN), "", True),
        ((*PLAN, "--color=always"), "NO_COLOR", True),
        ((*PLAN, "--color", "never"), "FORCE_COLOR", False),
        ((*PLAN, "--color", "auto"), "FORCE_COLOR", True),
        ((*PLAN, "-o", "json", "--color", "always"), "", False),
    ],
)
def test_when_output_in_a_pipe_is_coloured(
    run: Run,
    site: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    variable: str,
    *,
    coloured: bool,
) -> None:
    if variable:
        monkeypatch.setenv(variable, "1")
    said = run(*words)
    assert said.code == 0
    assert ("\x1b[" in said.out) is coloured


def test_another_word_is_refused(run: Run, site: Path) -> None:
    said = run("--color", "sometimes", *PLAN)
    assert said.code == 64
    assert "'auto', 'always', 'never'" in said.err
