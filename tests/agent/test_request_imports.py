# SPDX-License-Identifier: Apache-2.0
"""What a request loads and reads on a host: counted, because a time would depend on the machine."""

import re
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link import boot, protocol, stub
from edgectl.agent.measure.counters import Rates
from edgectl.agent.measure.probe import _compute_crc32
from edgectl.agent.measure.task_meter import TaskMeter, Traffic
from edgectl.agent.supervise import state_dir
from edgectl.errors import RefusedError
from edgectl.transport import agent_client
from tests.agent.conftest import AgentHost, a_spec
from tests.pace import patience

LINKS = [{"robot": "robot1", "address": "127.16.98.1"}]
LEASE = {"holder": "ana", "session": "s1", "epoch": 1}
# What each request may load besides what Python itself does: modules of the standard library, of ``os`` only its
# part in C, and a number of the agent's own.
ALWAYS = {"gc", "_blake2", "_json"}
# What module os has in os.path.
PATHS = {"stat", "_stat", "posixpath", "genericpath"}
TASKS = {"zlib", "fcntl"}
REQUESTS: dict[str, tuple[dict[str, Any], set[str], int]] = {
    "status": ({"task": None}, set(), 15),
    "logs": ({"task": "slam", "tail": 10}, {"select", *PATHS}, 17),
    "lease": ({"action": "renew", "lease": LEASE}, TASKS | PATHS, 14),
    "stop": ({"task": "slam", "instance": None, "generation": None, "stop": None}, TASKS | PATHS, 24),
    "wait": ({"task": "slam", "instance": "i1", "timeout_s": 0.0}, set(), 15),
    "probe": ({"window_s": 0.0}, set(), 19),
    "probe of a link": ({"window_s": 0.0, "links": LINKS}, {"_socket", "select", "errno"}, 25),
    "start": (
        {
            "task": "done",
            "instance": "i1",
            "generation": 1,
            "spec": a_spec("exec sleep 600", runtime="process"),
        },
        {"select", *TASKS, *PATHS},
        37,
    ),
}


# Reports each module of the agent whose code runs: the boot program makes most of them without an import.
REPORTING = (
    "import sys; sys.addaudithook(lambda event, given: event == 'exec' and getattr(given[0], 'co_filename', '')"
    ".startswith('edgectl_agent/') and sys.stderr.write('runs: %s\\n' % given[0].co_filename))"
)


def list_modules(text: str) -> set[str]:
    """The modules in the report of ``-X importtime``, and those of the agent whose code ran."""
    imported = set(re.findall(r"^import time:.*\|\s*(\S+)$", text, re.MULTILINE)) - {"package"}
    ran = {name.replace("/", ".") for name in re.findall(r"^runs: (\S+)\.py$", text, re.MULTILINE)}
    return imported | ran


def report_modules(host: AgentHost, folder: Path) -> Path:
    """Let the agent of ``host`` report its modules to a file, at each request anew."""
    report, python = folder / "imports", folder / "python3"
    python.write_text(
        f'#!/bin/sh\nexec {sys.executable} -X importtime -I -S -c "{REPORTING}\n$4" 2>{report}\n'
    )
    python.chmod(0o700)
    host.session.python = str(python)
    return report


@pytest.fixture
def bare() -> set[str]:
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-I", "-S", "-c", "import sys, _signal"],
        capture_output=True,
        text=True,
        check=True,
    )
    return list_modules(done.stderr)


@pytest.mark.parametrize("name", REQUESTS)
def test_request_loads_no_more_than_it_needs(
    host: AgentHost, tmp_path: Path, bare: set[str], name: str
) -> None:
    (fields, allowed, own), op = REQUESTS[name], name.split()[0]
    report = report_modules(host, tmp_path)
    # The first request of an operation may have to compile its code, which takes more modules.
    for number in range(2):
        try:
            host.ask(op, **{**fields, **({"task": f"done{number}"} if op == "start" else {})})
        except RefusedError:
            assert op == protocol.OP_LEASE, "nobody holds the fleet"
    loaded = list_modules(report.read_text()) - bare
    mine = {name for name in loaded if name.startswith("edgectl_agent")}
    assert mine, "the report of the request is there"
    assert loaded - mine - ALWAYS <= allowed
    assert len(mine) <= own, sorted(mine)


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="other versions have code of other sizes")
def test_code_of_a_request_does_not_grow_unseen(host: AgentHost) -> None:
    """All of it is read and hashed at each request, where only what is run is unmarshalled."""
    host.ask("status", task=None)
    host.ask("probe", window_s=0.0)
    sizes = {path.name.split(".")[0]: path.stat().st_size for path in host.state.rglob("*.code")}
    assert sizes["status"] < 118_000
    assert sizes["probe"] < 133_000
    host.ask("probe", window_s=0.0, links=LINKS)
    (code,) = host.state.rglob("probe.*.code")
    assert code.stat().st_size < 211_000


def test_what_a_module_imports_is_made_without_an_import(host: AgentHost, tmp_path: Path) -> None:
    """By the order that the first request has recorded; what is imported in a function is imported as ever."""
    report = report_modules(host, tmp_path)
    ran = []
    for _ in range(2):
        host.ask("probe", window_s=0.0, links=LINKS)
        ran.append(set(re.findall(r"^runs: (\S+)$", report.read_text(), re.MULTILINE)))
    # The first one had to compile.
    assert ran[0] - ran[1] == {"edgectl_agent/link/cache.py", "edgectl_agent/link/stub.py"}
    imported = set(re.findall(r"\| +(\S+)$", report.read_text(), re.MULTILINE))
    mine = {name for name in imported if name.startswith("edgectl_agent")}
    assert mine == {"edgectl_agent.measure.probe", "edgectl_agent.measure.link_meter"}
    libraries = {"_blake2", "_json", "_socket", "select"}
    assert not libraries & imported - set(sys.builtin_module_names), "their folder is not searched"


def test_what_one_probe_needed_another_does_not_unmarshal(host: AgentHost, tmp_path: Path) -> None:
    """The code of links is in the file of all probes, and a probe without links runs none of it."""
    host.ask("probe", window_s=0.0, links=LINKS)
    report = report_modules(host, tmp_path)
    host.ask("probe", window_s=0.0)
    loaded = list_modules(report.read_text())
    (code,) = host.state.rglob("probe.*.code")
    kept = boot.split_code(memoryview(code.read_bytes())[stub.SEAL_BYTES :])
    assert isinstance(kept["edgectl_agent.measure.network"], memoryview)
    assert "edgectl_agent.measure.probe" in loaded
    assert "edgectl_agent.measure.network" not in loaded


def test_the_program_that_is_compiled_at_each_request_is_short() -> None:
    programs = agent_client._read_boot_programs()
    length = int(programs.partition(b"\n")[0])
    assert length < 1_410


def test_part_of_os_becomes_the_whole_where_more_is_needed(tmp_path: Path) -> None:
    """As subprocess or makedirs need it; what was imported before has it, too."""
    program = """
part, path = os, os.path
assert "_collections_abc" not in sys.modules
import os.path, os as again
assert again is part and os.path is path
assert part.environ["NAME"] == "\\udce9" and part.path.expanduser("~") == "/nowhere"
from os import walk
import os, subprocess
os.makedirs(sys.argv[1] + "/a/b")
assert part.walk is walk is os.walk and part.environ is os.environ and part.path is os.path
assert subprocess.check_output(["/bin/echo", "x"]) == b"x\\n"
assert not hasattr(part, "no_such_name")
"""
    text = Path(boot.__file__).read_text().partition("import stat ")[0]
    environment = {b"NAME": b"\xe9", b"HOME": b"/nowhere", b"LC_ALL": b"C.UTF-8"}
    words = [sys.executable, "-I", "-S", "-c", text + program, str(tmp_path)]
    subprocess.run(words, env=environment, check=True, timeout=patience(10))
    assert (tmp_path / "a" / "b").is_dir()


@pytest.mark.parametrize("data", [b"", b"/root/.local/state/edgectl\0/dev/shm/edgectl-0", bytes(range(256))])
def test_place_of_a_host_is_the_one_of_former_versions(data: bytes) -> None:
    assert _compute_crc32(data) == zlib.crc32(data)


def test_process_table_is_read_only_for_tasks_that_may_live(host: AgentHost) -> None:
    host.start("ended", "true", kind="job")
    host.until("ended", "completed")
    state_dir.use_fleet([str(host.state)], host.fleet)
    assert "read_process_table" not in list_calls(host, {"ended": "completed"})
    host.start("slam", "exec sleep 600")
    host.until("slam", "running")
    assert "read_process_table" in list_calls(host, {"ended": "completed", "slam": "running"})


def list_calls(host: AgentHost, states: dict[str, str]) -> set[str]:
    """The functions called to measure the tasks of a host, which are in these states."""
    calls: set[str] = set()
    sys.setprofile(lambda frame, _event, _value: calls.add(frame.f_code.co_name))
    try:
        found = TaskMeter(host.name, []).measure(Traffic([], {}, {}, Rates()), 1.0)
    finally:
        sys.setprofile(None)
    assert {name: entry["state"] for name, entry in found.items()} == states
    return calls
