# SPDX-License-Identifier: Apache-2.0
"""``on_event`` as a user writes and tries it: mistakes in the file, ``events test``, and the recipes for it."""

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from tests.cli.inprocess import Said, edgectl
from tests.docs.blocks import environment
from tests.views.fixtures import ROOT

NOTIFY = ROOT / "docs" / "examples" / "notify.py"
DOCUMENT = {
    "format_version": 1,
    "kind": "event",
    "fleet": "lab-1",
    "test": False,
    "omitted": 3,
    "items": [
        {"id": 4, "at": "2026-11-21T08:00:00Z", "kind": "host-lost", "host": "zeta", "task": None, "message": "no route"},
        {"id": 5, "at": "2026-11-21T08:00:01Z", "kind": "task-failed", "host": "axe", "task": "slam", "message": "exit\r\nBcc: all@lab"},
    ],
}  # fmt: skip


def try_hooks(tmp_path: Path, hooks: str, *words: str) -> Said:
    (tmp_path / "lab.yaml").write_text(
        f"version: 1\nfleet: lab-1\nedges:\n  zeta: {{host: 127.0.0.1}}\n  axe: {{host: 127.0.0.2}}\non_event:\n{hooks}"
    )
    (tmp_path / "tasks.yaml").write_text("version: 1\ntasks: {}\n")
    env = environment(tmp_path / "state")
    return edgectl([*words, "-i", "lab.yaml", "-t", "tasks.yaml"], tmp_path, env)


def test_each_program_is_tried(tmp_path: Path) -> None:
    out = tmp_path / "said"
    hooks = (
        f'- command: [sh, -c, "cat > {out}"]\n- {{command: [sh, -c, "echo no server; exit 3"], kinds: all}}\n'
    )
    said = try_hooks(tmp_path, hooks, "events", "test", "-o", "json")
    assert said.code == 1
    assert [(row["command"], row["outcome"], row["message"]) for row in json.loads(said.out)["items"]] == [
        ("sh", "done", ""),
        ("sh", "failed", "failed with exit code 3: no server"),
    ]
    assert json.loads(out.read_text())["items"][0]["kind"] == "host-lost"
    out.unlink()
    dry = try_hooks(tmp_path, hooks, "events", "test", "--dry-run")
    assert (dry.code, dry.out.splitlines()) == (0, ["sh run (dry run)"] * 2)
    document = json.loads(try_hooks(tmp_path, hooks, "events", "test", "--dry-run", "-o", "json").out)
    assert [row["outcome"] for row in document["items"]] == ["skipped"] * 2
    assert not out.exists()
    assert try_hooks(tmp_path, hooks, "events", "test").out.splitlines()[0].split() == [
        "COMMAND",
        "OUTCOME",
        "TOOK",
        "MESSAGE",
    ]
    none = try_hooks(tmp_path, hooks.splitlines()[0] + "\n", "events", "test", "--kind", "roamed")
    assert (none.code, none.err.splitlines()[0]) == (64, "error: no program of on_event receives this event")


@pytest.mark.parametrize(
    ("hook", "message", "hint"),
    [
        ("- command: mail -s dead ana", "must be a list of arguments", 'write ["mail", "-s", "dead", "ana"]'),
        ("- {kinds: all}", "needs either command or notifier", 'write command: ["python3", "notify.py"]'),
        ("- {command: [a], notifier: b}", "needs either command or notifier", "remove one of the two"),
        ("- {command: [a], kinds: [task-died]}", "unknown word 'task-died'", ""),
        ("- {command: [a], timeout: 5m}", "must be 60 or less, not 5m", ""),
        ("- {command: [a], every: 2h}", "must be 3600 or less, not 2h", ""),
        ("- {command: [a], timeout: 0}", "must be above 0", ""),
        ("- {command: [a], options: {x: y}}", "options are for a notifier", "write them into the command"),
        ("- [a]", "an entry of on_event must be a mapping", ""),
        ("- {cmd: [a]}", "unknown key cmd in an entry of on_event", "did you mean command?"),
    ],
)
def test_mistakes(tmp_path: Path, hook: str, message: str, hint: str) -> None:
    said = try_hooks(tmp_path, hook + "\n", "validate")
    assert said.code == 64
    assert message in said.err
    assert hint in said.err
    assert "lab.yaml:7:" in said.err


@pytest.fixture
def server() -> Iterator[tuple[str, list[tuple[str, bytes]]]]:
    """A web server on loopback, and what was sent to it."""
    received: list[tuple[str, bytes]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            received.append((self.path, self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(500 if self.path == "/down" else 200)
            self.end_headers()

        def log_message(self, *args: object) -> None:
            """Say nothing."""

    with HTTPServer(("127.0.0.1", 0), Handler) as listening:
        thread = threading.Thread(target=listening.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.server_port}", received
        finally:
            listening.shutdown()
            thread.join()


def notify(*words: str, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    data = json.dumps(DOCUMENT)
    return subprocess.run(
        [sys.executable, str(NOTIFY), *words],
        input=data,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_recipes_of_slack_and_ntfy(server: tuple[str, list[tuple[str, bytes]]], tmp_path: Path) -> None:
    url, received = server
    (tmp_path / "url").write_text(f"{url}/hook\n")
    assert notify("slack", f"@{tmp_path / 'url'}").returncode == 0
    assert notify("ntfy", f"{url}/our-lab").returncode == 0
    (one, slack), (two, ntfy) = received
    assert (one, two) == ("/hook", "/our-lab")
    text = json.loads(slack)["text"].splitlines()
    assert text[:2] == ["*edgectl lab-1*", "(3 older events are left out)"]
    assert text[2] == "2026-11-21T08:00:00Z host-lost zeta no route"
    assert ntfy.decode().splitlines() == text[1:]
    assert notify("ntfy", f"{url}/down").returncode != 0
    assert notify("ntfy", "file:///etc/passwd").stderr.strip() == "file:///.. is no address of a web server"
    assert notify("pigeon", "home").returncode == 1


def test_the_recipe_of_mail(tmp_path: Path) -> None:
    """No line of an event becomes a header."""
    program = tmp_path / "sendmail"
    program.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/words\ncat > {tmp_path}/mail\n')
    program.chmod(0o755)
    done = notify("mail", "ana@lab.example", env={"PATH": f"{tmp_path}:/usr/bin:/bin"})
    assert done.returncode == 0, done.stderr
    head, _, body = (tmp_path / "mail").read_text().partition("\n\n")
    assert "To: ana@lab.example" in head
    assert "Subject: edgectl lab-1: 2026-11-21T08:00:01Z task-failed slam on axe" in head.replace("\n ", " ")
    assert "Bcc:" not in [line.split()[0] for line in head.splitlines()]
    assert "host-lost zeta no route" in body
