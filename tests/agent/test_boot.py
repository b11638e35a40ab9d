# SPDX-License-Identifier: Apache-2.0
"""Boot of the agent: sent once, cached under its hash, verified each time, run from memory."""

import ast
import graphlib
import hashlib
import os
import shutil
import stat
import subprocess
import sys
import time
import zipfile
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path

import pytest

import edgectl
from edgectl.agent.link import boot, cache, stub
from edgectl.agent.link import protocol as messages
from edgectl.errors import ReplyError
from edgectl.transport import agent_client as protocol
from edgectl.transport import enter_program
from edgectl.transport.agent_archive import build_agent_zipapp, compute_agent_hash, read_program
from edgectl.transport.base import Reply
from tests.agent.conftest import AgentHost
from tests.pace import patience

AGENT = Path(edgectl.__file__).parent / "agent"


# The first program's expression for the directory in shared memory.
SHARED = b'b"/dev/shm/edgectl-%d" % posix.geteuid()'


@pytest.fixture(scope="session")
def cached_agent() -> None:
    """None: the hosts of these tests begin without the agent."""


@pytest.fixture(autouse=True)
def memory(host: AgentHost) -> Iterator[Path]:
    """Shared memory of this test's own. In the common one a real edgectl of this user, or another test, may have
    left the agent: it would be used, and none would be sent.
    """
    own = Path(f"/dev/shm/edgectl-test-{os.getpid()}")
    expression = f'b"{own}"'.encode().ljust(len(SHARED))
    run = host.session.run

    def run_there(command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        # the first one: the agent behind the boot program keeps its hash
        return run(command, stdin.replace(SHARED, expression, 1), timeout=timeout, limit=limit)

    assert SHARED in protocol._read_boot_programs()
    assert len(expression) == len(SHARED)
    host.session.run = run_there  # type: ignore[method-assign]
    yield own
    shutil.rmtree(own, ignore_errors=True)


class Counting:
    """Counter of a call's round trips and their sizes."""

    def __init__(self, host: AgentHost) -> None:
        self.sizes: list[int] = []
        self._run = host.session.run
        host.session.run = self.run  # type: ignore[method-assign]

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        self.sizes.append(len(stdin))
        return self._run(command, stdin, timeout=timeout, limit=limit)


def kept(host: AgentHost) -> Path:
    return host.state / "agent" / f"{compute_agent_hash()}.pyz"


def test_sent_once_then_one_small_round_trip(host: AgentHost) -> None:
    trips = Counting(host)
    host.ask("status", task=None)
    host.ask("status", task=None)
    assert len(trips.sizes) == 3
    assert trips.sizes[1] > 100_000
    assert trips.sizes[0] == trips.sizes[2] < 6_300
    assert hashlib.sha256(kept(host).read_bytes()).hexdigest() == compute_agent_hash()


def test_changed_agent_is_never_run(host: AgentHost) -> None:
    host.ask("status", task=None)
    agent = kept(host).read_bytes()
    kept(host).write_bytes(agent.replace(b"def serve", b"def sevre"))
    trips = Counting(host)
    assert host.ask("status", task=None)["tasks"] == {}
    assert len(trips.sizes) == 2
    assert kept(host).read_bytes() == agent


def test_agent_behind_a_link_is_never_run(host: AgentHost, tmp_path: Path) -> None:
    host.ask("status", task=None)
    kept(host).rename(tmp_path / "elsewhere.pyz")
    kept(host).symlink_to(tmp_path / "elsewhere.pyz")
    trips = Counting(host)
    host.ask("status", task=None)
    assert len(trips.sizes) == 2
    assert not kept(host).is_symlink()


def test_directory_that_others_may_write_is_not_used(host: AgentHost, memory: Path) -> None:
    host.state.mkdir(mode=0o700)
    host.state.chmod(0o777)
    host.ask("status", task=None)
    assert not (host.state / "agent").exists()
    fallback = memory / "agent" / f"{compute_agent_hash()}.pyz"
    assert fallback.exists()
    assert stat.S_IMODE(fallback.stat().st_mode) == 0o600


def test_code_in_shared_memory_is_found_by_the_next_request(host: AgentHost, memory: Path) -> None:
    """The first program looks in the usual directory alone, and the stub there."""
    host.state.mkdir(mode=0o700)
    host.state.chmod(0o777)
    host.ask("status", task=None)
    (code,) = memory.rglob("status.*.code")
    before = code.stat()
    assert host.ask("status", task=None)["tasks"] == {}
    after = code.stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_runs_from_memory_where_nothing_can_be_kept(host: AgentHost, tmp_path: Path) -> None:
    program = (
        f"import sys; sys.path.insert(0, {str(AGENT / 'link')!r})\n"
        "import boot\n"
        "words = sys.stdin.buffer.readline().split()\n"
        "boot.boot_agent(sys.stdin.buffer, words, [b'/proc/nowhere', b'/proc/nowhere-else'], b'')\n"
    )
    packet = protocol.build_packet(
        {"op": "probe", "fleet": "lab", "host": "edge1", "window_s": 0.05},
        "m" * 32,
        10.0,
        build_agent_zipapp(),
    )
    packet = packet.removeprefix(protocol._read_boot_programs())
    done = subprocess.run(
        [sys.executable, "-I", "-c", program],
        input=packet,
        capture_output=True,
        check=False,
        cwd=tmp_path,
        timeout=patience(30),
    )
    assert b'"op": "probe"' in done.stdout, done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_agent_travels_packed(host: AgentHost) -> None:
    """A first contact over 256 kbit/s takes 7 s."""
    sizes: list[int] = []
    run = host.session.run

    def run_damaged(command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        sizes.append(len(stdin))
        sent = stdin[:-1] + b"~" if sizes[-1] > 100_000 else stdin
        return run(command, sent, timeout=timeout, limit=limit)

    host.session.run = run_damaged  # type: ignore[method-assign]
    with pytest.raises(ReplyError, match="arrived damaged"):
        host.ask("status", task=None)
    host.session.run = run  # type: ignore[method-assign]
    assert host.ask("status", task=None)["tasks"] == {}
    assert 100_000 < sizes[1] < 225_000


def find_code(host: AgentHost, operation: str = "status") -> Path:
    """The compiled code of an operation, on a host with one manager."""
    (found,) = (host.state / "agent").rglob(f"{operation}.*.code")
    return found


def read_code(host: AgentHost, operation: str) -> dict[str, object]:
    """The modules in the compiled code of an operation."""
    return dict(boot.split_code(memoryview(find_code(host, operation).read_bytes())[stub.SEAL_BYTES :]))


def test_compiled_code_is_kept_privately(host: AgentHost) -> None:
    host.ask("status", task=None)
    host.ask("probe", window_s=0.0)
    kept_code = list((host.state / "agent" / compute_agent_hash()).rglob("*.*"))
    assert {path.name.split(".")[0] for path in kept_code} == {"status", "probe"}
    assert {stat.S_IMODE(path.stat().st_mode) for path in kept_code} == {0o600}
    modules = read_code(host, "status")
    assert "edgectl_agent.supervise.status" in modules
    assert "edgectl_agent.supervise.supervisor" not in modules, "an operation loads only what it needs"


def test_nothing_is_compiled_twice(host: AgentHost) -> None:
    """Damaged programs of a request do no harm where the code of the operation is there; nothing is written."""
    host.ask("status", task=None)
    before = find_code(host).stat()
    run = host.session.run
    length, _, rest = protocol._read_boot_programs().partition(b"\n")
    packed = rest[int(length) :].partition(b"\n")[2]
    assert zlib.decompress(packed).count(b"\0") == 1, "the two others"
    damaged = packed[::-1]

    def run_damaged(command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        return run(command, stdin.replace(packed, damaged, 1), timeout=timeout, limit=limit)

    host.session.run = run_damaged  # type: ignore[method-assign]
    assert host.ask("status", task=None)["tasks"] == {}
    after = find_code(host).stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


@pytest.mark.parametrize("forged", [b"", b"0" * stub.SEAL_BYTES])
def test_compiled_code_of_a_task_does_not_run(host: AgentHost, forged: bytes) -> None:
    """A task of the same login writes its own code where the compiled agent is kept."""
    host.ask("status", task=None)
    planted = find_code(host)
    proof = host.state / "proof"
    code = compile(f"open({str(proof)!r}, 'w').write('ran')", "boot.py", "exec")
    modules = read_code(host, "status")
    planted.write_bytes(forged + cache.join_code({**modules, "edgectl_agent.link.boot": code}))
    assert host.ask("status", task=None)["tasks"] == {}
    assert not proof.exists()
    assert read_code(host, "status").keys() == modules.keys(), "compiled and sealed again"


def test_code_of_one_operation_is_not_that_of_another(host: AgentHost) -> None:
    """A seal holds for the name of its file."""
    host.ask("status", task=None)
    host.ask("probe", window_s=0.0)
    stolen = find_code(host, "probe")
    stolen.write_bytes(find_code(host).read_bytes())
    host.ask("probe", window_s=0.0)
    assert "edgectl_agent.measure.probe" in read_code(host, "probe")


def test_code_grows_by_what_later_requests_load(host: AgentHost) -> None:
    host.ask("check", command="true", prelude="", env={}, timeout_s=5.0)
    modules = read_code(host, "check")
    modules.pop("edgectl_agent.supervise.shell")
    code = cache.join_code(modules)
    seal = stub.compute_seal(protocol._PROCESS_KEY.encode(), b"check", code)
    find_code(host, "check").write_bytes(seal + code)
    host.ask("check", command="true", prelude="", env={}, timeout_s=5.0)
    assert "edgectl_agent.supervise.shell" in read_code(host, "check")


@pytest.mark.parametrize("module", ["_blake2", "none"])
def test_seal_depends_on_key_name_and_code(monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    """Also where BLAKE2 is missing, or forbidden."""
    monkeypatch.setitem(sys.modules, module, None)
    words = [(b"k" * 32, b"n", b"code"), (b"K" * 32, b"n", b"code"), (b"k" * 32, b"m", b"code")]
    seals = [stub.compute_seal(*each) for each in [*words, (b"k" * 32, b"n", b"cord")]]
    assert {len(seal) for seal in seals} == {stub.SEAL_BYTES}
    assert len(set(seals)) == 4
    assert stub.compute_seal(b"k" * 32, b"n", memoryview(b"code")) == seals[0]


def test_the_name_of_each_operation_fits_into_the_seal() -> None:
    """BLAKE2 has 16 bytes for it; a longer one would need SHA-512, whose library takes 4 ms."""
    names = [getattr(messages, name) for name in dir(messages) if name.startswith("OP_")]
    assert len(names) > 30
    assert max(map(len, names)) <= 16


def test_another_manager_does_not_trust_what_this_one_compiled(host: AgentHost) -> None:
    host.ask("status", task=None)
    mine = find_code(host)
    seal = mine.read_bytes()[: stub.SEAL_BYTES]
    protocol.use_cache_key(host.fleet, "0" * 32)
    try:
        host.ask("status", task=None)
    finally:
        protocol._CACHE_KEYS.clear()
    (theirs,) = {*(host.state / "agent").rglob("status.*.code")} - {mine}
    assert theirs.read_bytes()[: stub.SEAL_BYTES] != seal == mine.read_bytes()[: stub.SEAL_BYTES]


def test_agents_of_old_versions_are_removed(host: AgentHost) -> None:
    folder = host.state / "agent"
    folder.mkdir(parents=True, mode=0o700)
    host.state.chmod(0o700)
    for name, days in (("old.pyz", 31), ("recent.pyz", 29)):
        (folder / name).touch()
        os.utime(folder / name, (time.time() - days * 86400,) * 2)
    host.ask("status", task=None)
    assert not (folder / "old.pyz").exists()
    assert (folder / "recent.pyz").exists()


def test_first_contacts_at_the_same_time_do_no_harm(host: AgentHost) -> None:
    with ThreadPoolExecutor(8) as pool:
        replies = list(pool.map(lambda _: host.ask("status", task=None), range(16)))
    assert [reply["tasks"] for reply in replies] == [{}] * 16
    assert [path.name for path in (host.state / "agent").glob("*.pyz*")] == [kept(host).name]


def test_archive_is_a_plain_zip_and_always_the_same() -> None:
    agent = build_agent_zipapp()
    build_agent_zipapp.cache_clear()
    assert build_agent_zipapp() == agent
    with zipfile.ZipFile(BytesIO(agent)) as archive:
        names = archive.namelist()
        assert names == sorted(names)
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert {name: archive.read(name) for name in names} == boot.read_archive(agent)


def test_archive_is_the_one_that_the_standard_library_writes() -> None:
    """To the byte, in the order of the names, without the pages of code that lie beside the programs."""
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, path in sorted((path.relative_to(AGENT).as_posix(), path) for path in AGENT.rglob("*.py")):
            entry = zipfile.ZipInfo(f"edgectl_agent/{name}", date_time=(1980, 1, 1, 0, 0, 0))
            entry.create_system = 3
            entry.external_attr = 0o100600 << 16
            archive.writestr(entry, read_program(path))
    assert build_agent_zipapp() == buffer.getvalue()


def test_packages_of_the_agent_have_no_code() -> None:
    for path in AGENT.rglob("__init__.py"):
        (docstring,) = ast.parse(path.read_text()).body
        assert isinstance(docstring, ast.Expr), f"{path}: the boot program does not run it"


def list_needs(path: Path) -> set[str]:
    """The modules of the agent that one imports when its code runs."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            names = (
                [folder.with_suffix(".py")]
                if not folder.is_dir()
                else [folder / f"{each.name}.py" for each in node.names]
            )
            found |= {name.relative_to(AGENT).as_posix() for name in names}
    return found


def test_modules_of_the_agent_need_each_other_in_no_circle() -> None:
    """The boot program runs them in an order, each after those that it imports."""
    needs = {path.relative_to(AGENT).as_posix(): list_needs(path) for path in AGENT.rglob("*.py")}
    assert needs["measure/network.py"] >= {"link/protocol.py", "measure/sockets.py", "link/fast_json.py"}
    order = list(graphlib.TopologicalSorter(needs).static_order())
    assert set(order) == set(needs), "each of them is a module"


def test_a_python_that_loads_no_libraries_serves_requests(host: AgentHost) -> None:
    """One that is linked statically has no suffix of libraries, and finds all of them built in."""
    run, begin = host.session.run, "import sys,_signal;"

    def run_static(command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        assert command.count(begin) == 1
        static = command.replace(begin, f"{begin}import _imp;_imp.extension_suffixes=list;")
        return run(static, stdin, timeout=timeout, limit=limit)

    host.session.run = run_static  # type: ignore[method-assign]
    for _ in range(2):
        assert host.ask("status", task=None)["tasks"] == {}
        assert host.ask("probe", window_s=0.05)["host"] == "edge1"


def test_no_user_code_runs_on_the_host(
    host: AgentHost, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("sitecustomize.py", "usercustomize.py", "json.py", "signal.py"):
        (tmp_path / name).write_text(f"open({str(tmp_path / 'ran')!r}, 'a').write('{name}')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("PYTHONSTARTUP", str(tmp_path / "json.py"))
    monkeypatch.chdir(tmp_path)
    host.ask("probe", window_s=0.05)
    assert not (tmp_path / "ran").exists()


def test_agent_needs_no_later_python_than_3_6() -> None:
    vermin = Path(sys.executable).parent / "vermin"
    done = subprocess.run(
        [vermin, "-q", "--no-tips", "-t=3.6-", "--violations", AGENT, enter_program.__file__],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
