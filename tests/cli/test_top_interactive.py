# SPDX-License-Identifier: Apache-2.0
"""top -i in a terminal of its own, over real probes."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from edgectl.cli.main import expand_shorthand
from tests.cli.conftest import Run
from tests.cli.terminal import Terminal
from tests.compiled_agent import give_scaffold_keys

# The alternate screen of the terminal, used by the view, is left at the end.
ENTERED, LEFT = "\x1b[?1049h", "\x1b[?1049l"
TOP = ["top", "-i"]


@pytest.fixture
def env(tmp_path: Path, site: Path) -> dict[str, str]:
    give_scaffold_keys(tmp_path / "state", site)
    # Names of hosts are contiguous if no colour changes within them.
    return {
        **os.environ,
        "EDGECTL_STATE_DIR": str(tmp_path / "state"),
        "COLUMNS": "80",
        "LINES": "24",
        "TERM": "xterm-256color",
    }


def test_live_until_q(site: Path, env: dict[str, str]) -> None:
    with Terminal([*TOP, "--readonly"], site, env=env, limit_s=90.0) as terminal:
        terminal.until("robot3")
        terminal.type("c")
        terminal.until("nothing is changed")
        terminal.type("?")
        terminal.until("Esc closes")
        terminal.type("q")
        terminal.type("q")
        assert terminal.wait() == 0
        assert ENTERED in terminal.seen
        assert LEFT in terminal.seen.rpartition(ENTERED)[2]
        assert "Traceback" not in terminal.seen


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_with_the_terminal_as_it_was(
    site: Path, env: dict[str, str], number: signal.Signals
) -> None:
    with Terminal(TOP, site, env=env, limit_s=90.0) as terminal:
        terminal.until("robot3")
        terminal.process.send_signal(number)
        assert terminal.wait() == 0
        assert LEFT in terminal.seen.rpartition(ENTERED)[2]


def test_ctrl_c_ends_it(site: Path, env: dict[str, str]) -> None:
    with Terminal(TOP, site, env=env, limit_s=90.0) as terminal:
        terminal.until("robot3")
        terminal.type("\x03")
        assert terminal.wait() == 0


def test_not_without_a_terminal_nor_without_the_extra(site: Path, env: dict[str, str], run: Run) -> None:
    ended = run("top", "-i")
    assert ended.code == 64
    assert "not a terminal" in ended.err
    code = "import sys; sys.modules['textual'] = None; from edgectl.cli.main import main; sys.exit(main(['top', '-i']))"
    with Terminal([], site, program=code, env=env) as terminal:
        assert terminal.wait() == 64
        assert "[tui]" in terminal.seen
        assert "Traceback" not in terminal.seen


def test_words_of_top() -> None:
    assert expand_shorthand(["top", "-i", "-i", "x.yaml"]) == ["top", "hosts", "-I", "-i", "x.yaml"]
    assert expand_shorthand(["top", "hosts", "-i", "x.yaml"]) == ["top", "hosts", "-i", "x.yaml"]
    assert expand_shorthand(["top"]) == ["top", "hosts"]
    assert expand_shorthand(["top", "-w"]) == ["top", "hosts", "-w"]
    assert expand_shorthand(["top", "--help"]) == ["top", "--help"]


def test_nothing_of_it_is_imported_before(site: Path, env: dict[str, str]) -> None:
    code = "import sys; from edgectl.cli.main import main; main(['top', 'hosts', '-h']); sys.exit('textual' in sys.modules)"
    assert (
        subprocess.run(
            [sys.executable, "-c", code], cwd=site, env=env, capture_output=True, check=False
        ).returncode
        == 0
    )


def test_a_scenario_needs_no_subcommand_of_simulate() -> None:
    assert expand_shorthand(["simulate", "x.yaml", "-n", "1"]) == ["simulate", "run", "x.yaml", "-n", "1"]
    assert expand_shorthand(["simulate", "-n", "1", "x.yaml"]) == ["simulate", "run", "-n", "1", "x.yaml"]
    for words in (
        ["simulate", "sweep", "x.yaml"],
        ["simulate", "merge", "x.yaml"],
        ["simulate", "--help"],
        ["simulate"],
    ):
        assert expand_shorthand(words) == words
