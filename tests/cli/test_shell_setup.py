# SPDX-License-Identifier: Apache-2.0
"""Completion and manual pages as a user installs them: in the real bash, zsh and fish, by the real man."""

import os
import pty
import re
import select
import subprocess
import time
from pathlib import Path

import pytest

from edgectl.cli.app import COMMANDS
from edgectl.cli.man_pages import build_man_pages
from edgectl.views.man_page import ManPage, render_man_page
from tests.docs.blocks import environment
from tests.pace import patience


def environment_of(home: Path, **more: str) -> dict[str, str]:
    env = {name: value for name, value in environment(home / "state").items() if not name.startswith("XDG_")}
    return {**env, "HOME": str(home), "TERM": "dumb", "PS1": "", "MANPAGER": "cat", "MANWIDTH": "80", **more}


def install(shell: str, home: Path) -> str:
    env = environment_of(home, SHELL=f"/usr/bin/{shell}")
    done = subprocess.run(
        ["edgectl", "completion", "--install"], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


def press_tab(argv: list[str], line: str, wanted: str, env: dict[str, str]) -> str:
    """What a shell on a terminal shows after ``line`` and Tab, up to ``wanted``."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.execvpe(argv[0], argv, env)
    shown, deadline = "", time.monotonic() + patience(60)
    try:
        time.sleep(0.3)
        os.write(terminal, f"{line}\t".encode())
        while wanted not in shown and time.monotonic() < deadline:
            if select.select([terminal], [], [], 0.5)[0]:
                shown += os.read(terminal, 4096).decode(errors="replace")
    finally:
        os.kill(pid, 9)
        os.waitpid(pid, 0)
        os.close(terminal)
    return shown


def test_bash(tmp_path: Path) -> None:
    """The file is where bash-completion looks for it; here it is sourced, as that does at the first Tab."""
    said = install("bash", tmp_path)
    file = tmp_path / ".local/share/bash-completion/completions/edgectl"
    assert str(file) in said
    rc = tmp_path / "rc"
    rc.write_text(f"PS1='$ '\nsource {file}\n")
    shown = press_tab(
        ["bash", "--rcfile", str(rc), "-i"], "edgectl unco", "uncordon", environment_of(tmp_path)
    )
    assert "uncordon" in shown


def test_zsh(tmp_path: Path) -> None:
    """A new zsh, with the line that was added to its .zshrc; a second installation adds no second one."""
    install("zsh", tmp_path)
    install("zsh", tmp_path)
    assert (tmp_path / ".zshrc").read_text().count("fpath=") == 1
    env = environment_of(tmp_path, ZDOTDIR=str(tmp_path))
    shown = press_tab(["zsh", "-i"], "edgectl unco", "uncordon", env)
    assert "uncordon" in shown


def test_fish(tmp_path: Path) -> None:
    install("fish", tmp_path)
    done = subprocess.run(
        ["fish", "-c", "complete -C 'edgectl unco'"],
        env=environment_of(tmp_path),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.splitlines()[0].split()[0] == "uncordon", done.stderr


def test_man(tmp_path: Path) -> None:
    install("bash", tmp_path)
    env = environment_of(tmp_path, MANPATH=str(tmp_path / ".local/share/man"))
    done = subprocess.run(["man", "edgectl-plan"], env=env, capture_output=True, text=True, check=False)
    text = " ".join(re.sub(r".\x08", "", done.stdout).split())
    assert done.returncode == 0, done.stderr
    assert "edgectl-plan - Rank hosts for each task and show the changes" in text
    assert "edgectl plan --out next.plan" in text
    assert "--snapshot FILE" in text


def test_no_page_is_wrong_roff() -> None:
    pages = build_man_pages()
    wanted = {f"edgectl-{name.replace(' ', '-')}.1" for name in COMMANDS}
    assert wanted < pages.keys()
    done = subprocess.run(
        ["groff", "-man", "-Tutf8", "-ww", "-z"],
        input="".join(pages.values()),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_text_that_roff_would_obey() -> None:
    page = ManPage(
        words="x",
        summary="a.",
        usage="x",
        text="'quoted' and\n\n.so /etc/passwd \\(co",
        options=[("-a", ".b")],
    )
    text = render_man_page(page, "1", [])
    assert "\n\\&'quoted' and\n" in text
    assert "\n\\&.so /etc/passwd \\e(co\n" in text


@pytest.mark.parametrize(("shell", "more"), [("/bin/tcsh", "tcsh"), ("", "of $SHELL, which is not set")])
def test_other_shells(shell: str, more: str, tmp_path: Path) -> None:
    env = environment_of(tmp_path, SHELL=shell)
    done = subprocess.run(["edgectl", "completion"], env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.splitlines()[0]) == (
        64,
        f"error: no completion for the shell {more}",
    )
