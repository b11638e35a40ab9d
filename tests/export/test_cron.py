"""Crontab lines: the right schedule, and a command that runs as under cron, with any paths."""

import dataclasses
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.errors import UsageError
from edgectl.export.cron import format_cron_command, format_cron_schedule, format_crontab, quote_for_cron
from edgectl.export.job import ScheduledJob, format_interval
from tests import forkserver
from tests.compiled_agent import give_agent_and_keys
from tests.e2e.bench import a_mark, list_sleepers, wait_for_sleepers
from tests.pace import patience

JOB = ScheduledJob(
    name="lab", program=("/opt/edgectl/bin/edgectl",), inventories=("/srv/lab/lab.yaml",), tasks=("/srv/lab/tasks",), directory="/srv/lab", user="ana"
)  # fmt: skip
AWKWARD = 'it\'s 100% $HOME "a b" & co; #1'


def read_as_cron(line: str, *, keeps_backslash: bool) -> str:
    """Return the command of a crontab line as cron reads it: up to the first bare percent sign; a backslash
    before a percent sign is removed, or not.
    """
    text, rest = "", line.split(" ", 5)[5]
    while rest:
        head, rest = rest[:1], rest[1:]
        if head == "%":
            return text
        if head == "\\" and rest.startswith("%"):
            text += "\\%" if keeps_backslash else "%"
            rest = rest[1:]
        else:
            text += head
    return text


@pytest.mark.parametrize(
    ("every_s", "fields"),
    [
        (60, "* * * * *"), (120, "*/2 * * * *"), (300, "*/5 * * * *"), (1800, "*/30 * * * *"), (3600, "0 * * * *"),
        (21600, "0 */6 * * *"), (86400, "0 0 * * *"),
    ],
)  # fmt: skip
def test_intervals_that_cron_can_say(every_s: float, fields: str) -> None:
    assert format_cron_schedule(every_s) == fields


@pytest.mark.parametrize("every_s", [1, 59, 60.5, 90, 420, 5400, 18000, 172800])
def test_intervals_that_cron_cannot_say(every_s: float) -> None:
    with pytest.raises(UsageError, match=r"cron cannot express every"):
        format_cron_schedule(every_s)


def test_intervals_in_words() -> None:
    assert [format_interval(s) for s in (10, 60, 300, 5400, 86400, 1.5)] == [
        "10s",
        "1m",
        "5m",
        "1h30m",
        "1d",
        "1.5s",
    ]


def test_the_line() -> None:
    *comments, line = format_crontab(JOB).splitlines()
    assert all(comment.startswith("#") for comment in comments)
    assert line == (
        "*/5 * * * * cd /srv/lab && /opt/edgectl/bin/edgectl apply --yes --quiet -i /srv/lab/lab.yaml -t /srv/lab/tasks"
    )


@pytest.mark.parametrize("word", [AWKWARD, "%", "a%b", "%d/%m", "plain", "", "100%"])
@pytest.mark.parametrize("keeps_backslash", [False, True])
def test_every_word_reaches_the_program_unchanged(word: str, keeps_backslash: bool) -> None:
    line = read_as_cron(
        f"* * * * * printf %s {quote_for_cron(word)}".replace("%s ", r"\%s ", 1),
        keeps_backslash=keeps_backslash,
    )
    assert subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=True).stdout == word


@pytest.mark.parametrize("path", ["/srv/a\nb", "/srv/a\\b", "/srv/a ", "/srv/a\x1bb"])
def test_what_cron_cannot_hold_is_refused(path: str) -> None:
    from dataclasses import replace

    with pytest.raises(UsageError, match="cannot be quoted"):
        format_cron_command(replace(JOB, inventories=(path,)))
    with pytest.raises(UsageError, match="cron takes at most 998"):
        format_cron_command(replace(JOB, inventories=("/" + "x" * 990,)))


INVENTORY = (
    "version: 1\nedges:\n  edge1: {host: 127.0.0.1, connection: local, capacity: {cpu: 1, memory: 1Gi}}\n"
)
TASKS = 'version: 1\ntasks:\n  idle: {{command: "exec sleep {}", demand: {{cpu: 0.1, memory: 10Mi}}, stop: {{grace: 2s}}}}\n'


@pytest.fixture
def site(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A fleet in a directory with an awkward name, and the mark of its task's process."""
    here, mark = tmp_path / AWKWARD, a_mark()
    here.mkdir()
    (here / "lab.yaml").write_text(INVENTORY)
    (here / "tasks.yaml").write_text(TASKS.format(mark))
    give_agent_and_keys(here / "state", here / "lab.yaml")
    yield here, mark
    run_edgectl(here, "stop", "--all", "--yes")
    assert list_sleepers(mark) == []


def run_edgectl(here: Path, *words: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "EDGECTL_STATE_DIR": str(here / "state")}
    return forkserver.run_edgectl(*words, "-i", "lab.yaml", "-t", "tasks.yaml", cwd=here, env=env)


def test_the_line_runs_as_cron_runs_it(site: tuple[Path, str], isolated: Path) -> None:
    """A minimal environment, no terminal, the home directory: the first run reports its changes, the second
    prints nothing.
    """
    here, mark = site
    said = run_edgectl(here, "export", "cron", "--every", "10m")
    assert (said.returncode, said.stderr) == (0, "")
    line = read_as_cron(said.stdout.splitlines()[-1], keeps_backslash=False)
    env = shutil.which("env")
    assert env
    poor = [
        env,
        "-i",
        f"HOME={isolated}",
        "LOGNAME=ana",
        "PATH=/usr/bin:/bin",
        "SHELL=/bin/sh",
        "/bin/sh",
        "-c",
        line,
    ]
    runs = [
        subprocess.run(
            poor,
            cwd=isolated,
            capture_output=True,
            text=True,
            check=False,
            timeout=patience(60),
            stdin=subprocess.DEVNULL,
        )
        for _ in range(2)
    ]
    assert (runs[0].returncode, runs[0].stderr) == (0, "")
    assert "Applied 1 of 1" in runs[0].stdout
    assert len(wait_for_sleepers(mark, 1)) == 1
    assert (runs[1].returncode, runs[1].stdout, runs[1].stderr) == (0, "", "")
    assert (here / "state").is_dir(), "the line takes the state directory along"


def test_an_interval_that_a_self_fence_does_not_survive_is_refused() -> None:
    with pytest.raises(UsageError, match=r"self_fence 1m would stop themselves \(needed: 2 x 10m\)"):
        format_crontab(dataclasses.replace(JOB, every_s=600.0, self_fence_s=60.0))
    assert "*/10" in format_crontab(dataclasses.replace(JOB, every_s=600.0, self_fence_s=1200.0))
