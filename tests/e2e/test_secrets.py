# SPDX-License-Identifier: Apache-2.0
"""No secret leaks: canary values stand in every place of a secret, and every output of a task's life is
searched for them in all usual encodings.
"""

import base64
import json
import os
import re
import shlex
import subprocess
import sys
import threading
import urllib.parse
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

import pytest

from edgectl.state.paths import get_state_root
from tests.compiled_agent import give_agent_and_keys
from tests.e2e.bench import a_mark, list_sleepers, wait_for_sleepers
from tests.forkserver import EDGECTL, ForkedProcess
from tests.pace import patience
from tests.sshd import Lab
from tests.transport.test_ssh_auth import run_password_server

# Characters that the encodings write differently.
NAMES = ("task", "host", "task-command", "host-command", "password")
CANARIES = {name: f'C4nary+{name}/"ö\\ x&=%7' for name in NAMES}
DRIVER = """
import sys
import edgectl.executor.phases as phases
from edgectl.cli.main import main
def broken(*_args, **_named):
    raise RuntimeError("a bug")
phases._wait_until_ready = broken
sys.exit(main())
"""


def encode_secret(secret: str) -> dict[str, bytes]:
    """Return the secret as it may be written: plain, and in the usual encodings, base64 at each of its three
    alignments.
    """
    raw = secret.encode()
    found = {
        "plain": raw,
        "hex": raw.hex().encode(),
        "HEX": raw.hex().upper().encode(),
        "latin": secret.encode("latin-1"),
    }
    for pad in range(3):
        coded = base64.b64encode(b"\0" * pad + raw).rstrip(b"=")
        found[f"base64+{pad}"] = coded[-(-pad * 4 // 3) + (1 if pad else 0) : -1]
        found[f"base64url+{pad}"] = found[f"base64+{pad}"].translate(bytes.maketrans(b"+/", b"-_"))
    for safe in ("", "/"):
        found[f"url{safe}"] = urllib.parse.quote(secret, safe=safe).encode()
        found[f"form{safe}"] = urllib.parse.quote_plus(secret, safe=safe).encode()
    for ascii_only in (True, False):
        found[f"json{ascii_only}"] = json.dumps(secret, ensure_ascii=ascii_only)[1:-1].encode()
        found[f"json-json{ascii_only}"] = json.dumps(json.dumps(secret, ensure_ascii=ascii_only))[
            3:-3
        ].encode()
    found["repr"] = repr(secret)[1:-1].encode()
    found["shell"] = shlex.quote(secret).encode()
    return found


FORMS = {
    f"{name} as {form}": text
    for name, secret in CANARIES.items()
    for form, text in encode_secret(secret).items()
}


ANY = re.compile(b"|".join(re.escape(text) for text in FORMS.values()))


def find_forms(data: bytes) -> list[str]:
    return [what for what, text in FORMS.items() if text in data] if ANY.search(data) else []


def test_the_search_finds_every_form() -> None:
    """Without this test a blind search would pass."""
    for name, secret in CANARIES.items():
        raw = secret.encode()
        for prefix in (b"", b"x", b"xy", b"xyz"):
            assert any(name in hit for hit in find_forms(base64.b64encode(prefix + raw + b"tail")))
        for text in (
            raw,
            raw.hex().encode(),
            json.dumps({"k": secret}).encode(),
            urllib.parse.quote(secret).encode(),
        ):
            assert any(name in hit for hit in find_forms(b"before" + text + b"after"))


class SecretStage:
    """A fleet over SSH and on this machine, with a canary in every place of a secret."""

    def __init__(self, directory: Path, lab: Lab, port: int) -> None:
        self.directory, self.lab, self.mark = directory / "fleet", lab, a_mark()
        self.vault = directory / "vault"
        self.outputs: list[bytes] = []
        self.seen: set[str] = set()
        self.directory.mkdir()
        self.vault.mkdir()
        for name in ("task-command", "host-command"):
            (self.vault / name).write_text(
                f"# from the vault\n{name.upper().replace('-', '_')}={CANARIES[name]}\n"
            )
        (self.vault / "password").write_text(CANARIES["password"] + "\n")
        self._write_inventory(port)
        self.write_tasks()

    def _write_inventory(self, port: int) -> None:
        env = {
            "env": {"HOST": {"value": CANARIES["host"], "secret": True}},
            "env_command": ["cat", str(self.vault / "host-command")],
        }
        slice_ = {"capacity": {"cpu": 2, "memory": "1Gi"}}
        locked = {
            "host": "127.0.0.1",
            "port": port,
            "user": "nobody",
            "password_command": ["cat", str(self.vault / "password")],
        }
        edges = {
            "edge1": {"host": "edge1", **slice_},
            "edge2": {"connection": "local", **slice_},
            "locked": locked,
        }
        text = json.dumps({"version": 1, "defaults": env, "edges": edges}, ensure_ascii=False)
        (self.directory / "inventory.yaml").write_text(text)

    def write_tasks(self, **fields: object) -> None:
        task = {
            "command": f"sleep {self.mark}",
            "env": {"TASK": {"value": CANARIES["task"], "secret": True}},
            "env_command": ["cat", str(self.vault / "task-command")],
            "demand": {"cpu": 0.5, "memory": "10Mi"},
            "hosts": {"never": ["locked"]},
            "stop": {"grace": "2s"},
            "ready": "true",
            "done_when": "false",
            "handoff": {
                "safe_when": {"command": "env", "on": "host"},
                "hold": {"command": "env; true", "on": "host"},
            },
        }
        text = json.dumps({"version": 1, "tasks": {"uplink": {**task, **fields}}}, ensure_ascii=False)
        (self.directory / "tasks.yaml").write_text(text)

    def run(self, *words: str, program: str = EDGECTL) -> int:
        files = ("-i", "inventory.yaml", "-t", "tasks.yaml")
        with TemporaryFile() as out, watch_processes(self):
            process = ForkedProcess(
                [*words, *files], program=program, cwd=self.directory, stdout=out, stderr=out
            )
            try:
                code = process.wait(patience(60))
            finally:
                process.end()
            out.seek(0)
            self.outputs.append(out.read())
        return code

    def run_started(self, *words: str) -> int:
        """Run a process of its own, whose command line and environment are searched too."""
        command = [sys.executable, "-m", "edgectl", *words, "-i", "inventory.yaml", "-t", "tasks.yaml"]
        with watch_processes(self):
            done = subprocess.run(
                command,
                cwd=self.directory,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                check=False,
                timeout=patience(60),
                stdin=subprocess.DEVNULL,
            )
        self.outputs.append(done.stdout)
        return done.returncode

    def searched(self) -> Iterator[Path]:
        """Return every file that this test, the manager or the hosts wrote, except the sources of the
        canaries.
        """
        sources = {self.directory / "inventory.yaml", self.directory / "tasks.yaml", *self.vault.iterdir()}
        roots = (
            self.directory.parent,
            Path(os.environ["HOME"]),
            self.lab.directory,
            Path(f"/dev/shm/edgectl-{os.geteuid()}"),
        )
        for root in roots:
            for path in root.rglob("*") if root.exists() else ():
                if path not in sources and path.is_file() and not path.is_symlink():
                    yield path


@contextmanager
def watch_processes(stage: SecretStage) -> Iterator[None]:
    """Sample the command line of every new process, and the environment of each that is no task.

    Processes from before the stage cannot receive a secret.
    """
    over, others = threading.Event(), {process.name for process in Path("/proc").glob("[0-9]*")} - stage.seen

    def look() -> None:
        while not over.wait(0.05):
            for process in Path("/proc").glob("[0-9]*"):
                if process.name in others:
                    continue
                stage.seen.add(process.name)
                with suppress(OSError):
                    stage.outputs += (
                        [found] if find_forms(found := (process / "cmdline").read_bytes()) else []
                    )
                    environment = (process / "environ").read_bytes()
                    if find_forms(environment) and b"EDGECTL_TASK=uplink\0" not in environment:
                        stage.outputs.append(environment)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.fixture
def stage(tmp_path: Path, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> Iterator[SecretStage]:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    monkeypatch.setenv("EDGECTL_DEBUG", "1")
    with run_password_server(lab) as (port, tried):
        lab.known_hosts.write_text(lab.known_hosts.read_text() + lab["edge1"].known_hosts_line)
        made = SecretStage(tmp_path, lab, port)
        give_agent_and_keys(get_state_root(), made.directory / "inventory.yaml")
        yield made
        made.write_tasks()
        assert made.run("stop", "--all", "--yes") in (0, 4)
        assert list_sleepers(made.mark) == []
        assert set(tried) == {CANARIES["password"]}


def read_task_environment(stage: SecretStage) -> dict[str, str]:
    (pid,) = wait_for_sleepers(stage.mark, 1)
    pairs = (line.partition("=") for line in Path(f"/proc/{pid}/environ").read_bytes().decode().split("\0"))
    return {name: value for name, _, value in pairs}


def test_a_secret_is_nowhere_but_in_the_environment_of_the_task(stage: SecretStage) -> None:
    lenient = "--allow-unreachable"
    assert stage.run("plan", lenient, "--out", "saved.plan") == 0
    assert stage.run("plan", lenient, "-o", "json") == 0
    assert stage.run("probe", lenient, "--out", "saved.snapshot") == 0
    for form in ("table", "json", "yaml"):
        assert stage.run("apply", "--dry-run", "-o", form) == 0
        assert b"***" in stage.outputs[-1]
    assert stage.run_started("apply", lenient, "saved.plan") == 0
    expected = {
        "TASK": "task",
        "HOST": "host",
        "TASK_COMMAND": "task-command",
        "HOST_COMMAND": "host-command",
    }
    environment = read_task_environment(stage)
    assert {name: environment.get(name) for name in expected} == {
        name: CANARIES[canary] for name, canary in expected.items()
    }
    assert stage.run("status", lenient, "-o", "json") == 0
    assert stage.run("logs", "uplink") == 0
    # a move, with hooks that print their environment
    where = environment["EDGECTL_HOST"]
    stage.write_tasks(hosts={"never": ["locked", where]})
    assert stage.run("apply", "--yes", lenient, "-o", "json") == 0, stage.outputs[-1].decode()
    assert read_task_environment(stage)["EDGECTL_HOST"] != where
    # changes are reported, a bug prints its traceback after the request was sent, and commands fail
    stage.write_tasks(env={"TASK": {"value": CANARIES["task"], "secret": True}, "MORE": "x"}, workdir="/")
    assert stage.run("plan", lenient) == 0
    assert b"env and workdir changed" in stage.outputs[-1]
    assert stage.run("apply", "--yes", lenient, program=DRIVER) == 1
    assert b"Traceback" in stage.outputs[-1]
    stage.write_tasks(workdir="/nowhere")
    assert stage.run("apply", "--yes", lenient) == 4
    stage.write_tasks(env_command=["sh", "-c", f"cat {stage.vault}/*; exit 3"])
    assert stage.run("apply", "--yes", lenient) == 4
    assert b"env_command of task uplink failed with exit code 3" in stage.outputs[-1]
    stage.write_tasks(env={"TASK": {"value": CANARIES["task"], "secret": "yes"}})
    assert stage.run("validate") == 64
    found = {path: hit for path in stage.searched() if (hit := find_forms(path.read_bytes()))}
    assert found == {}
    assert [find_forms(text) for text in stage.outputs if find_forms(text)] == []
    written = {path.name for path in stage.searched()}
    assert {"journal.jsonl", "memory.json", "saved.plan", "saved.snapshot", "instance", "status"} <= written
