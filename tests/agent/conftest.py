# SPDX-License-Identifier: Apache-2.0
"""A real host on this machine: the agent in a local session, with a state directory of its own; every task is ended after the test."""

import contextlib
import fcntl
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from edgectl.agent.daemon import pidfile
from edgectl.agent.measure import proc
from edgectl.agent.supervise import liveness
from edgectl.transport.agent_archive import compute_agent_hash
from edgectl.transport.agent_client import call_agent
from edgectl.transport.local import LocalSession
from tests.agent.user_systemd import UserSystemd, can_be_real, user_systemd
from tests.pace import patience

# Timeout of one request to the agent.
ANSWERS_S = patience(30.0)

Found = TypeVar("Found")


class AgentHost:
    """Client of the agent of one simulated host. ``python`` is the interpreter that runs it."""

    def __init__(self, name: str, state: Path, python: str = sys.executable) -> None:
        self.name, self.state, self.fleet = name, state, "lab"
        self.runtime = "process"
        self.session = LocalSession(name)
        self.session.python = python

    def ask(self, op: str, *, timeout: float = ANSWERS_S, **fields: Any) -> dict[str, Any]:
        return call_agent(
            self.session, {"op": op, "fleet": self.fleet, "host": self.name, **fields}, timeout=timeout
        )

    def start(
        self, task: str, command: str, *, instance: str = "i1", generation: int = 1, **spec: Any
    ) -> dict[str, Any]:
        return self.ask(
            "start",
            task=task,
            instance=instance,
            generation=generation,
            spec=a_spec(command, **{"runtime": self.runtime, **spec}),
        )

    def stop(self, task: str, **fields: Any) -> dict[str, Any]:
        return self.ask(
            "stop", **{"task": task, "instance": None, "generation": None, "stop": None, **fields}
        )

    def entry(self, task: str) -> dict[str, Any] | None:
        found: dict[str, Any] | None = self.ask("status", task=task)["tasks"].get(task)
        return found

    @property
    def home(self) -> Path:
        """The directory of this host in that of its fleet."""
        return self.state / "agent-state" / self.fleet / "hosts" / self.name

    def folder(self, task: str) -> Path:
        return self.home / "tasks" / task

    def supervisor(self, task: str) -> int:
        return int(liveness.read_instance(str(self.folder(task))).instance["supervisor"])

    def members(self, task: str) -> set[int]:
        record, table = liveness.read_instance(str(self.folder(task))), proc.read_process_table()
        return (liveness.find_processes(record, table) | liveness.find_orphans(record, table)) - {
            record.instance.get("supervisor")
        }

    def until(self, task: str, state: str, *, seconds: float = 30.0) -> dict[str, Any]:
        return eventually(
            lambda: e if (e := self.entry(task)) and e["state"] == state else None, seconds=seconds
        )

    def end(self) -> None:
        """Kill the leftovers of a failed test, supervisors first; only processes with this host's cookies."""
        for folder in (self.home / "tasks").glob("*"):
            record = liveness.read_instance(str(folder))
            for pid in (liveness.find_supervisor(record), *self.members(folder.name)):
                if pid:
                    with contextlib.suppress(ProcessLookupError):  # it ended just now
                        os.kill(pid, signal.SIGKILL)


def a_spec(command: str, **fields: Any) -> dict[str, object]:
    spec: dict[str, object] = {
        "command": command, "prelude": "", "env": {}, "workdir": None, "kind": "service", "restart": "never",
        "stop": {"signal": "TERM", "grace_s": 2.0, "preset": None}, "ready": None, "log": {"max_bytes": 100_000, "files": 2},
        "limits": {"cpu": None, "memory": None}, "runtime": "auto", "spec_hash": "h1",
    }  # fmt: skip
    return spec | fields


def eventually(found: Callable[[], Found | None], *, seconds: float = 30.0) -> Found:
    """Poll ``found`` until it returns a true value; returns that.

    Most polls start an agent: the longer it has taken, the rarer they are, so that the wait ends 3 % late at most.
    """
    began = time.monotonic()
    deadline = began + patience(seconds)
    while not (value := found()):
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(max(0.05, 0.03 * (time.monotonic() - began)))
    return value


@contextmanager
def shared_memory() -> Iterator[None]:
    """Exclusive use of the agent cache in shared memory, which is empty at the start and at the end.

    All hosts of this machine and user look for the agent there, also those of tests that run at the same time.
    """
    with Path(f"/dev/shm/edgectl-tests-{os.geteuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _forget_agents()
        try:
            yield
        finally:
            _forget_agents()


def _forget_agents() -> None:
    """Remove cached agents; other users of the cache send theirs again."""
    for path in Path(f"/dev/shm/edgectl-{os.geteuid()}/agent").glob(f"{compute_agent_hash()}*"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def is_running(pid: int) -> bool:
    seen = proc.read_process(pid)
    return seen is not None and seen.state not in "ZX"


class Profiled:
    """A host and its profiler."""

    def __init__(self, host: AgentHost) -> None:
        self.host = host

    def start(self, *, every: float = 1.0, ttl: float = 600.0, **spec: Any) -> dict[str, Any]:
        return self.host.ask("profiler-start", every_s=every, ttl_s=ttl, **spec)

    def status(self, **spec: Any) -> dict[str, Any]:
        return self.host.ask("profiler-status", **spec)

    def sampled(self, count: int) -> dict[str, Any]:
        """Its status once it has taken ``count`` samples."""
        return eventually(
            lambda: reply if (reply := self.status()).get("samples", 0) >= count else None, seconds=30
        )

    def probe(self, **fields: Any) -> dict[str, Any]:
        """A probe served by the profiler. On a busy machine a sample may be late, and then a window is measured."""
        return eventually(
            lambda: (
                found if (found := self.host.ask("probe", window_s=0.05, **fields)).get("resident") else None
            ),
            seconds=30,
        )

    @property
    def folder(self) -> Path:
        return self.host.home / "profiler"

    def holders(self) -> list[int]:
        return [pid for pid, _ in pidfile.find_holders(str(self.folder))]


@pytest.fixture(scope="session")
def cached_agent(tmp_path_factory: pytest.TempPathFactory) -> Path | None:
    """The directory of an agent that has compiled the code of the common operations."""
    state = tmp_path_factory.mktemp("cached") / "state"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGECTL_STATE_DIR", str(state))
        agent = AgentHost("edge1", state)
        agent.ask("probe", window_s=0.0)
        agent.start("once", "exec sleep 600")
        agent.stop("once")
        agent.end()
    return state / "agent"


@pytest.fixture
def host(
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    cached_agent: Path | None,
) -> Iterator[AgentHost]:
    """One host that has the agent, else with an empty state directory.

    With parameter ``systemd`` its tasks run in scopes of a systemd --user.
    """
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    agent = AgentHost("edge1", tmp_path / "state")
    if cached_agent is not None:
        agent.state.mkdir(mode=0o700)
        shutil.copytree(cached_agent, agent.state / "agent")
    if getattr(request, "param", "process") == "systemd":
        agent.runtime, agent.session.python = "systemd", str(request.getfixturevalue("systemd").python)
    yield agent
    agent.end()


@pytest.fixture
def profiled(host: AgentHost) -> Iterator[Profiled]:
    found = Profiled(host)
    yield found
    for pid in found.holders():
        os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="session")
def systemd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[UserSystemd]:
    """A systemd --user, or its stub where the tests cannot have one."""
    with user_systemd(tmp_path_factory.mktemp("systemd") / "user", real=can_be_real()) as found:
        yield found


both_runtimes = pytest.mark.parametrize("host", ["process", "systemd"], indirect=True)
