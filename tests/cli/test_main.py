# SPDX-License-Identifier: Apache-2.0
"""Exit codes, and errors in one format without tracebacks."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from edgectl.cli import offline_commands
from tests.cli.conftest import Run
from tests.forkserver import ForkedProcess
from tests.pace import patience

EDGECTL = [sys.executable, "-m", "edgectl"]


@pytest.mark.parametrize(
    "words",
    [
        ("nonsense",),
        ("help", "nonsense"),
        ("top", "task"),
        ("plan", "--nonsense"),
        ("plan", "-o", "jsn"),
        ("logs",),
        ("stop",),
        ("completion", "tcsh"),
    ],
)
def test_usage_errors_end_with_64_and_say_where_help_is(run: Run, site: Path, words: tuple[str, ...]) -> None:
    said = run(*words)
    assert said.code == 64
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert "\nhint: " in said.err
    assert len(said.err.splitlines()) == 2


def test_help_is_printed_where_no_command_is_given(run: Run) -> None:
    whole = run("--help")
    assert run() == run("help") == whole
    assert whole.code == 0
    assert run("help", "plan") == run("plan", "--help")
    assert "-W, --weights" in run("help", "plan").out
    assert run("plan", "-h") == run("help", "plan")
    waiting = " ".join(run("wait", "-h").out.split())
    for default in ("[default: ready]", "[default: 60s]", "[default: 1s]"):
        assert default in waiting


def test_a_typo_is_answered_with_the_command_that_was_meant(run: Run) -> None:
    assert run("plam").err.startswith("error: No such command 'plam'\nhint: did you mean plan")
    assert run("plan", "--ou").err.startswith("error: No such option: --ou\nhint: did you mean --out")


def test_errors_are_json_where_json_was_asked_for(run: Run, site: Path) -> None:
    for words in (
        ("plan", "--snapshot", "no.json", "-o", "json"),
        ("plan", "--nonsense", "--output=json"),
        ("nonsense", "-ojson"),
    ):
        said = run(*words)
        document = json.loads(said.err)
        assert (said.code, document["error"]["exit_code"], said.out) == (64, 64, "")


def test_the_environment_chooses_the_form_of_errors_too(
    run: Run, site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EDGECTL_OUTPUT", "json")
    assert json.loads(run("plan", "--nonsense").err)["error"]["kind"] == "usage"


def test_a_bug_is_one_line_with_a_way_to_see_more(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise ZeroDivisionError("surprise\nsecond line")

    monkeypatch.setattr(offline_commands, "version_command", broken)
    said = run("version")
    assert (said.code, said.err) == (
        1,
        "error: unexpected ZeroDivisionError: surprise\nhint: this is a bug in edgectl; EDGECTL_DEBUG=1 shows where it happened\n",
    )
    monkeypatch.setenv("EDGECTL_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        run("version")


def test_a_full_disk_is_no_bug_of_ours(site: Path) -> None:
    script = '"$@" plan --snapshot snap.json >/dev/full'
    said = subprocess.run(
        ["sh", "-c", script, "sh", *EDGECTL],
        capture_output=True,
        text=True,
        timeout=patience(120),
        check=False,
    )
    assert said.returncode == 1
    assert (
        said.stderr
        == "error: No space left on device\nhint: free some space; tasks on the hosts are not affected\n"
    )


@pytest.mark.parametrize(("closed", "code"), [("<&-", 64), (">&-", 64), ("2>&-", 64), ("<&- >&- 2>&-", 64)])
def test_closed_streams_do_no_harm(site: Path, closed: str, code: int) -> None:
    script = (
        f'"$@" plan --snapshot snap.json {closed} && "$@" trust edge1 {closed} && "$@" stop --all {closed}'
    )
    said = subprocess.run(
        ["sh", "-c", script, "sh", *EDGECTL],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=patience(60),
        check=False,
    )
    assert said.returncode == code
    assert "unexpected" not in said.stderr


def test_ctrl_c_ends_with_130_and_no_traceback(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(offline_commands, "version_command", interrupted)
    assert run("version") == (130, "", "interrupted\n")


@pytest.mark.parametrize("words", [["--help"], ["plan", "--snapshot", "snap.json", "-o", "json"]])
def test_a_reader_that_goes_away_is_no_error(site: Path, words: list[str]) -> None:
    process = subprocess.Popen([*EDGECTL, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    with process.stderr:
        assert process.stderr.read() == b""
    assert process.wait(30) == 0


def has_children(pid: int) -> bool:
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            if path.read_text():
                return True
    return False


def test_a_real_ctrl_c_during_a_probe(site: Path) -> None:
    process = ForkedProcess(
        ["probe", "--window", "20s", "--timeout", "25s"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    begun = time.monotonic()
    while not has_children(process.pid):
        assert time.monotonic() - begun < patience(30), "it asks no host"
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=patience(120))
    assert (process.returncode, out) == (130, "")
    assert "Traceback" not in err
    assert err.endswith("interrupted\n")


def test_help_stands_in_groups_and_names_exit_codes(run: Run) -> None:
    said = run("--help")
    assert said.code == 0
    for group in ("Schedule:", "Inspect:", "Operate:", "Evaluate:", "Files:", "Settings:"):
        assert f"\n{group}\n" in said.out
    assert "75 locked, stale or busy" in " ".join(said.out.split())
    assert run("-h").out == said.out


def test_the_module_is_the_command() -> None:
    done = subprocess.run([*EDGECTL, "version", "-o", "json"], capture_output=True, text=True, check=True)
    assert set(json.loads(done.stdout)) == {"format_version", "kind", "item", "warnings"}


def test_a_narrow_encoding_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text("version: 1\nedges: {caf\u00e9: {host: a}}\n", encoding="utf-8")
    env = {**os.environ, "PYTHONIOENCODING": "ascii:strict"}
    done = subprocess.run(
        [*EDGECTL, "validate", "-i", "lab.yaml", "-t", "lab.yaml"],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 64
    assert b"caf\\xe9" in done.stderr


def test_no_colour_without_a_terminal_unless_forced(
    run: Run, site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "\x1b" not in run("plan", "--snapshot", "snap.json").out
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert "\x1b[33m~" in run("plan", "--snapshot", "snap.json").out
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in run("plan", "--snapshot", "snap.json").out
    assert os.environ["FORCE_COLOR"] == "1"


def test_a_missing_choice_is_named_in_one_plain_line(run: Run, site: Path) -> None:
    said = run("export", "csv")
    assert said.code == 64
    assert "\\n" not in said.err
    assert "Missing argument 'KIND'. Choose from: hosts, links, tasks, " in said.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("init", "error: Missing argument 'DIR'\nhint: for example: edgectl init demo\n"),
        (
            "move slam",
            "error: Missing argument 'HOST'\nhint: for example: edgectl move navigation-robot1 edge2\n",
        ),
        (
            "describe robot-arm",
            "error: 'robot-arm' is no kind\nhint: name it: edgectl describe edge|robot|task robot-arm\n",
        ),
        ("status slam", "error: unexpected argument: slam\nhint: see edgectl status --help\n"),
    ],
)
def test_what_is_missing_or_too_much_is_answered_with_a_call_that_works(
    words: str, said: str, run: Run
) -> None:
    assert run(*words.split()) == (64, "", said)
