# SPDX-License-Identifier: Apache-2.0
"""Files of users: what others planted is neither followed nor believed, and nothing is written for all to read."""

import os
import re
import stat
from pathlib import Path

import pytest

from edgectl.cli.user_files import save_file
from edgectl.config.problems import Problems
from edgectl.config.source import describe_exposure, read_source
from edgectl.errors import FileError
from tests.cli.conftest import Run

OTHER = 54321
PLAN = ("plan", "--snapshot", "snap.json", "--out", "next.plan")
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def give_away(path: Path) -> None:
    """As another user would have made it."""
    os.chown(path, OTHER, OTHER, follow_symlinks=False)


def test_a_link_planted_beside_the_file_is_not_written_through(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("keep me")
    victim.chmod(0o600)
    (tmp_path / ".metrics.prom.partial").symlink_to(victim)
    save_file(tmp_path / "metrics.prom", "page", mode=0o644)
    assert (victim.read_text(), mode(victim)) == ("keep me", 0o600)
    assert ((tmp_path / "metrics.prom").read_text(), mode(tmp_path / "metrics.prom")) == ("page", 0o644)


@needs_root
@pytest.mark.parametrize("target", ["victim", "/dev/null"])
def test_a_link_of_another_user_is_refused(tmp_path: Path, target: str) -> None:
    (tmp_path / "victim").write_text("keep me")
    link = tmp_path / "next.plan"
    link.symlink_to(target)
    save_file(tmp_path / "other.plan", "fine")
    give_away(link)
    with pytest.raises(FileError, match=f"it is a link that belongs to user {OTHER}"):
        save_file(link, "plan")
    assert (tmp_path / "victim").read_text() == "keep me"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["next.plan", "other.plan", "victim"]


def test_circles_of_links_end(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(FileError, match="symbolic links"):
        save_file(tmp_path / "a", "text")


def test_what_edgectl_writes_is_private_whatever_the_umask(run: Run, site: Path) -> None:
    before = os.umask(0)
    try:
        assert run(*PLAN).code == 0
        assert run("export", "csv", "events", "--out", "events.csv").code == 0
        assert run("export", "systemd", "--user", "--every", "90s", "--out", "units").code == 0
    finally:
        os.umask(before)
    assert (mode(site / "next.plan"), mode(site / "events.csv")) == (0o600, 0o600)
    assert {mode(unit) for unit in (site / "units").iterdir()} == {0o644}, (
        "the system manager warns of others"
    )


@pytest.mark.parametrize("name", ["inventories/local.yaml", "tasks/demo.yaml", "next.plan"])
def test_a_file_that_everybody_may_write_is_refused(run: Run, site: Path, name: str) -> None:
    assert run(*PLAN).code == 0
    (site / name).chmod(0o666)
    words = ("apply", "next.plan", "--dry-run")
    said = run(*words)
    assert (said.code, said.out) == (64, "")
    assert said.err == (
        f"error[EC104]: {name}: every user may change it (mode 0666)\n"
        f"hint: chmod go-w {name}; or use it nevertheless: --insecure-files\n"
    )
    assert "EC104" in run("validate").err or name == "next.plan"


def test_nothing_is_refused_where_no_host_is_asked_or_it_is_wished(
    run: Run, site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (site / "tasks/demo.yaml").chmod(0o666)
    assert run(*PLAN).err.startswith("saved next.plan; apply it with: edgectl apply next.plan\n")
    assert run("status").code == 64
    assert "insecure" in run("history").err
    monkeypatch.setenv("EDGECTL_INSECURE_FILES", "0")
    assert run("history").code == 64
    assert run("history", "--insecure-files").code == 0
    monkeypatch.setenv("EDGECTL_INSECURE_FILES", "1")
    assert run("history").code == 0


@needs_root
def test_files_of_another_user_are_refused_but_not_those_of_whom_sudo_serves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "tasks.yaml"
    path.write_text("version: 1\n")
    give_away(path)
    problems = Problems()
    assert read_source(path, problems) is not None
    assert [warning.message for warning in problems.warnings] == [f"user {OTHER} owns it and may change it"]
    monkeypatch.setenv("SUDO_UID", str(OTHER))
    assert describe_exposure(path, path.stat()) is None


def test_a_group_may_write_if_it_is_the_callers_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the umask is 002, each user has a group of the same name."""
    path = tmp_path / "tasks.yaml"
    path.touch()
    path.chmod(0o664)
    own = os.stat_result((*path.stat()[:5], _own_group(), *path.stat()[6:10]))
    assert describe_exposure(path, own) is None
    shared = os.stat_result((*path.stat()[:5], _own_group() + 4242, *path.stat()[6:10]))
    assert describe_exposure(path, shared) is not None


def _own_group() -> int:
    import pwd

    return pwd.getpwuid(os.geteuid()).pw_gid


@pytest.mark.parametrize("name", ["tasks.yaml", "snap.json"])
def test_a_hundred_thousand_faults_are_told_in_a_page(run: Run, site: Path, name: str) -> None:
    """And the exposure of a file is told nevertheless, because it decides what is done with it."""
    many = range(40_000)
    text = {
        "tasks.yaml": "version: 1\nversion: 1\n" + "a: 1\n" * len(many),
        "snap.json": "{" + ", ".join('"a": 1' for _ in many) + "}",
    }[name]
    (site / name).write_text(text)
    (site / name).chmod(0o666)
    words = ("validate", "-t", name) if name == "tasks.yaml" else ("plan", "--snapshot", name)
    told = run(*words)
    assert told.code == 64
    assert len(told.out + told.err) < 60_000
    assert re.search(r"and [0-9]+ more", told.out + told.err)
    if name == "tasks.yaml":
        assert "every user may change it" in told.out + told.err


def test_an_experiment_that_others_may_write_is_not_run(run: Run, site: Path) -> None:
    """It names the files of the fleet, and what is done on the hosts."""
    spec = site / "tasks" / "spec.yaml"
    text = "version: 1\nname: x\nschemes: {policies: [local]}\nuntil: []\nlimit: 1s\n"
    spec.write_text(text)
    spec.chmod(0o666)
    told = run(
        "experiment", "run", "tasks/spec.yaml", "-i", "inventories/local.yaml", "-t", "tasks/demo.yaml"
    )
    assert told.code == 64
    assert "every user may change it" in told.err, told
