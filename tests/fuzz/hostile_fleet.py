# SPDX-License-Identifier: Apache-2.0
"""Commands against a fleet of which one host answers every request with odd values.

The honest host beside it must not notice: its task is placed, stays alone, and is stopped when asked.
"""

import json
import os
import random
import shutil
from functools import partial
from pathlib import Path

import pytest

from edgectl.errors import ConnectError, HostError
from edgectl.transport.fake import FakeTransport, Handler
from tests.cli.inprocess import Said, edgectl
from tests.executor.fake_fleet import FakeFleet, FakeHost, Request
from tests.fuzz.mutate import change_json_value
from tests.gateway.test_facts import DOCUMENT as FACTS

EVIL, HONEST = "edge1", "edge2"
INVENTORY = """\
version: 1
edges:
  edge1: {host: edge1.lab, labels: {gpu: "yes"}}
  edge2: {host: edge2.lab}
robots:
  robot1: {host: robot1.lab}
"""
DEMAND = "demand: {cpu: 0.1, memory: 1Mi, throughput: 0}"
READY = 'ready: {command: "true", timeout: 50ms}'
TASKS = f"""\
version: 1
tasks:
  bad: {{command: sleep 100, hosts: {{pin: edge1}}, {DEMAND}, {READY}}}
  good: {{command: sleep 100, hosts: {{pin: edge2}}, {DEMAND}, ready: {{command: "true", timeout: 5s}}}}
  free: {{command: sleep 100, {DEMAND}, robots: [robot1], {READY}}}
"""
PROFILER = {"state": "running", "pid": 5, "age_s": 60.0, "every_s": 2.0, "period_s": 2.0, "samples": 30}
OTHER_REPLIES: dict[str, Request] = {
    "doctor": dict(FACTS),
    "profiler-status": {
        **PROFILER,
        "used_cores": 0.01,
        "used_bytes": 1e7,
        "ttl_s": 600.0,
        "ttl_left_s": 500.0,
    },
    "profiler-start": {"state": "started", "pid": 5},
}
LISTS = ("table", "wide", "json", "jsonl", "yaml", "csv", "name")
ITEMS = ("table", "json", "jsonl", "yaml", "csv")
# Each with every form that it has; --lock-timeout: the liar may say that another manager has the fleet.
COMMANDS: tuple[tuple[str, ...], ...] = (
    *((*words, "-o", form) for words in (("probe",), ("status",)) for form in LISTS[:1] + LISTS[2:]),
    *(("get", kind, "-o", form) for kind in ("edges", "robots", "tasks", "links") for form in LISTS),
    *(("plan", "-o", form) for form in (*LISTS, "markdown")),
    *(
        (*words, "-o", form)
        for words in (
            ("describe", "edge", EVIL),
            ("describe", "robot", "robot1"),
            ("describe", "task", "bad"),
            ("doctor",),
            ("events",),
            ("profile", "bad"),
            ("profilers", "status"),
        )
        for form in ITEMS
    ),
    *(
        (*words, "-o", form)
        for words in (("top", "hosts"), ("top", "tasks"), ("explain", "bad"))
        for form in (*ITEMS, "wide")
    ),
    *(("graph", "-o", form) for form in ("mermaid", "dot", "json")),
    *(
        ("watch", "--cycles", "1", "-o", form, *apply)
        for form in ("table", "jsonl")
        for apply in ((), ("--apply",))
    ),
    *(("export", "csv", name) for name in ("hosts", "links", "tasks", "metrics", "handoffs", "events")),
    *(
        (*words, "--yes", "--lock-timeout", "0", "-o", form)
        for words in (("apply",), ("restart", "bad"), ("drain", EVIL, "--timeout", "1s"))
        for form in ("table", "json", "yaml")
    ),
    ("logs", "bad"),
    ("logs", "bad", "-f"),
    ("export", "prometheus"),
    ("history", "-o", "json"),
    ("profilers", "start"),
    ("stop", "bad", "--yes"),
)


def spoil_reply(chance: random.Random, reply: Request) -> Request:
    """``reply`` with some of its values exchanged; sometimes as it is, sometimes with entries of tasks that
    are not there.
    """
    changed: Request = json.loads(json.dumps(reply))
    if chance.random() < 0.3:
        entry = {"state": chance.choice(("running", "completed", "failed")), "pid": 7, "generation": 1 << 33}
        ghosts = {"good": entry, f"ghost{chance.randrange(3)}": {**entry, "managed": chance.random() < 0.7}}
        changed["tasks"] = {**changed.get("tasks", {}), **ghosts}  # type: ignore[dict-item]
    for _ in range(chance.choice((0, 1, 1, 2, 4))):
        changed = change_json_value(chance, changed)
    return changed


def _answer(host: FakeHost, request: Request) -> Request:
    """The reply of a simulated host, or a plausible one where it has no such operation."""
    try:
        return host(request)
    except AttributeError:
        return {**OTHER_REPLIES.get(str(request["op"]), {}), "host": host.name, "op": request["op"]}


def _build_liar(host: FakeHost, chance: random.Random) -> Handler:
    def answer(request: Request) -> Request:
        if chance.random() < 0.02:
            raise ConnectError("switched off")
        return spoil_reply(chance, _answer(host, request))

    return answer


class HostileSite:
    """Files of a fleet in a directory, and its hosts in memory; all of them honest until `lie`."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        directory.mkdir(parents=True, exist_ok=True)
        (directory / "fleet.yaml").write_text(INVENTORY)
        (directory / "tasks.yaml").write_text(TASKS)
        self.hosts = FakeFleet.of([EVIL, HONEST, "robot1"])
        self.handlers: dict[str, Handler | HostError] = {
            name: partial(_answer, host) for name, host in self.hosts.hosts.items()
        }
        self.transport = FakeTransport(self.handlers)
        self.environment = {
            **{name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ},
            "EDGECTL_STATE_DIR": str(directory / "state"),
            "EDGECTL_INVENTORY": "fleet.yaml",
            "EDGECTL_TASKS": "tasks.yaml",
            "COLUMNS": "200",
        }

    def lie(self, chance: random.Random) -> None:
        """From now on the replies of one host are spoilt."""
        self.transport = FakeTransport({**self.handlers, EVIL: _build_liar(self.hosts[EVIL], chance)})

    def run(self, *words: str) -> Said:
        """Run a command; what it prints must be text for a terminal, and no mistake of edgectl.

        Raises:
            AssertionError: it is not.
        """
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("edgectl.transport.fleet_transport.FleetTransport", lambda **_: self.transport)
            said = edgectl(words, self.directory, self.environment)
        assert said.code != 64 or "is on no host" in said.err, said
        for text in (said.out, said.err):
            assert "unexpected " not in text, (words, text[-500:])
            odd = [char for char in text if not (char.isprintable() or char in "\n")]
            assert not odd, (words, odd[:5])
        if said.out and "json" in words and said.code in (0, 4) and "watch" not in words:
            json.loads(said.out)
        return said


def run_against_liar(directory: Path, data: bytes) -> None:
    """Place the tasks, let the host lie, run eight commands that ``data`` chooses, stop everything.

    Raises:
        AssertionError: a command failed by a mistake of edgectl, or the honest host's task did not stay alone.
    """
    chance = random.Random(data)
    site = HostileSite(directory)
    try:
        assert site.run("apply", "--yes").code == 0
        first = site.hosts[HONEST].tasks["good"]["instance"]
        site.lie(chance)
        for words in (*chance.sample(COMMANDS, 8), ("apply", "--yes", "--quiet", "--lock-timeout", "0")):
            site.run(*words)
        assert site.hosts[HONEST].tasks["good"]["instance"] == first
        stopped = site.run("stop", "--all", "--yes", "--lock-timeout", "0")
        assert "good" not in site.hosts[HONEST].tasks or f"on {EVIL}" in stopped.err, stopped
    finally:
        shutil.rmtree(directory)
