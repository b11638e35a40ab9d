# SPDX-License-Identifier: Apache-2.0
"""edgectl serve on the example fleet, as a process of its own."""

import contextlib
import json
import re
import signal
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.cli.serve import load_or_make_token
from edgectl.errors import FileError, UsageError
from edgectl.web.access import is_token
from tests.cli.conftest import Run
from tests.forkserver import ForkedProcess
from tests.pace import patience


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    return tmp_path / "state"


@contextlib.contextmanager
def serve_page(site: Path, *words: str) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Run ``serve`` on a free port; yields its URL."""
    command = ["serve", "--listen", "127.0.0.1:0", "--timeout", "50s", *words]
    process = ForkedProcess(command, cwd=site, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stderr is not None
    try:
        said = process.stderr.readline()
        if "token" in said:
            said += process.stderr.readline()
        found = re.search(r"http://127\.0\.0\.1:[0-9]+/", said)
        assert found, said
        yield found[0], process
    finally:
        process.kill()
        process.communicate()


def fetch_after_probe(url: str, **headers: str) -> bytes:
    """The document, once the first event says that there is one."""
    asked = urllib.request.Request(f"{url}api/events", headers=headers)
    with urllib.request.urlopen(asked, timeout=patience(60)) as events:
        for line in events:
            if line.startswith(b"data: ") and json.loads(line.removeprefix(b"data: "))["version"]:
                break
    asked = urllib.request.Request(f"{url}api/fleet", headers=headers)
    with urllib.request.urlopen(asked, timeout=patience(60)) as answer:
        return bytes(answer.read())


def test_a_real_fleet_is_shown_as_status_shows_it_until_ctrl_c(site: Path, state: Path, run: Run) -> None:
    with serve_page(site, "--every", "10m") as (url, process):
        document = json.loads(fetch_after_probe(url))
        process.send_signal(signal.SIGINT)
        assert process.wait(patience(30)) == 0
        assert process.communicate() == ("", "")
    assert json.loads(run("history", "-o", "json").out)["items"] == [], "nothing was applied"
    status = json.loads(run("status", "-o", "json").out)
    changing = {"taken_at", "age_s"}
    rows = [{key: value for key, value in row.items() if key not in changing} for row in status["items"]]
    shown = {row["task"]: row for row in document["item"]["tasks"]}
    assert len(rows) == len(shown) == 10
    assert all(row.items() <= shown[row["task"]].items() for row in rows)
    assert [host["host"] for host in document["item"]["hosts"]] == [
        "edge1",
        "edge2",
        "edge3",
        "robot1",
        "robot2",
        "robot3",
    ]
    assert len(document["item"]["changes"]) == 10, "an apply would start them"
    assert document["item"]["moves"] == []


def test_a_token_is_made_once_never_printed_and_asked_for(site: Path, state: Path) -> None:
    with serve_page(site, "--token-file", "serve.token") as (url, process):
        token = (site / "serve.token").read_text().strip()
        assert (site / "serve.token").stat().st_mode & 0o777 == 0o600
        with pytest.raises(urllib.error.HTTPError, match="401") as caught:
            urllib.request.urlopen(f"{url}api/fleet", timeout=patience(60))
        caught.value.close()
        assert token.encode() not in fetch_after_probe(url, Authorization=f"Bearer {token}")
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate()
        assert token not in out + err
        assert process.returncode == 0
    assert load_or_make_token(site / "serve.token") == token


@pytest.mark.parametrize("where", ["0.0.0.0:0", "[::]:0", "192.0.2.1:9816", "lab.example:9816"])
def test_other_machines_are_not_served_without_a_token(site: Path, run: Run, where: str) -> None:
    ended = run("serve", "--listen", where)
    assert ended.code == 64
    assert "other machines are served only with a token" in ended.err
    assert "--token-file FILE" in ended.err
    assert f"ssh -L {where.rpartition(':')[2]}:127.0.0.1:{where.rpartition(':')[2]} MANAGER" in ended.err


def test_a_token_file_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "serve.token"
    path.write_text("short\n")
    path.chmod(0o600)
    with pytest.raises(UsageError, match="holds no token"):
        load_or_make_token(path)
    path.chmod(0o644)
    with pytest.raises(FileError, match="other users may read"):
        load_or_make_token(path)
    with pytest.raises(FileError, match="cannot read"):
        load_or_make_token(tmp_path)
    made = load_or_make_token(tmp_path / "new")
    assert is_token(made)
    assert (tmp_path / "new").read_text() == f"{made}\n"
