# SPDX-License-Identifier: Apache-2.0
"""The paramiko transport leaves nothing behind, executes no foreign code, and retries on busy servers."""

import os
import resource
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from edgectl.errors import ConnectError, HostError
from edgectl.transport import ssh
from edgectl.transport.host_keys import HostKeyVerifier
from edgectl.transport.sockets import TunnelLine, connect_tcp, watchdog
from edgectl.transport.ssh import SshTransport
from edgectl.transport.ssh_auth import LoginStrategy
from edgectl.transport.ssh_client import prepare_jump_client
from edgectl.transport.ssh_config import SshConfigResolver
from tests.pace import patience
from tests.relay import count_callers, run_mute_server
from tests.sshd import Lab, make_key, running_lab


def count_open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def wait_until_released(threads: int, files: int) -> bool:
    """Wait until threads and files are back to their initial number."""
    deadline = time.monotonic() + patience(30)
    while (threading.active_count() > threads or count_open_files() > files) and time.monotonic() < deadline:
        time.sleep(0.01)
    return threading.active_count() <= threads and count_open_files() <= files


def test_what_is_said_to_a_channel_after_its_end_does_not_end_the_connection(
    lab: Lab, tmp_path: Path
) -> None:
    """As of two threads of which one has made a message, and the other ends the channel before it is sent: OpenSSH
    takes that for an attack on a channel that does not exist.
    """
    with SshTransport().connect(lab.host("edge1"), timeout=patience(10)) as session:
        for turn in range(3):
            channel = session.transport.open_session()
            gate = tmp_path / str(turn)
            channel.exec_command(f"until [ -e {gate} ]; do sleep 0.02; done; echo {turn}")
            with channel.lock:
                late = channel._send_eof()  # type: ignore[attr-defined]
            gate.touch()
            assert channel.makefile().read() == f"{turn}\n".encode()
            assert channel.closed or channel.status_event.wait(patience(10))
            channel.close()
            session.transport._send_user_message(late)  # type: ignore[attr-defined]
            with pytest.raises(OSError, match="closed"):
                channel.sendall(b"more")
            assert session.run("echo still", b"", timeout=patience(20)).stdout == b"still\n"


def test_nothing_is_left_open(lab: Lab, tmp_path: Path) -> None:
    make_key(tmp_path / "stranger")
    transport = SshTransport()
    transport.connect(lab.host("edge1"), timeout=patience(10)).close()
    threads, files = threading.active_count(), count_open_files()
    for _ in range(5):
        with transport.connect(lab.host("edge1", proxy_jump="robot1"), timeout=patience(10)) as session:
            session.run("true", b"", timeout=patience(20))
    with run_mute_server() as port:
        for host in (
            lab.host("edge1", port=1),
            lab.host("edge1", host="127.0.0.1", port=port),
            lab.host("edge1", proxy_jump="edge9"),
        ):
            with pytest.raises(HostError):
                transport.connect(host, timeout=1)
    lab.known_hosts.write_text("")
    with pytest.raises(HostError):
        SshTransport().connect(lab.host("edge2"), timeout=patience(20))
    lab.write_files(key=tmp_path / "stranger")
    with pytest.raises(HostError):
        SshTransport().connect(lab.host("edge2"), timeout=patience(20))
    assert wait_until_released(threads, files), [thread.name for thread in threading.enumerate()]


def test_closing_is_quick_and_can_be_repeated(lab: Lab) -> None:
    session = SshTransport().connect(lab.host("edge1"), timeout=patience(10))
    start = time.monotonic()
    session.close()
    session.close()
    assert time.monotonic() - start < 9, "paramiko waits for its thread for 10 s"
    with pytest.raises(ConnectError):
        session.run("true", b"", timeout=patience(20))


def test_closing_wakes_who_waits(lab: Lab) -> None:
    session = SshTransport().connect(lab.host("edge1"), timeout=patience(10))
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(session.run, "exec sleep 20", b"", timeout=patience(20))
        time.sleep(0.2)
        session.close()
        with pytest.raises(ConnectError):
            waiting.result(timeout=patience(20))


def test_no_file_of_fabric_is_executed_or_read(lab: Lab, tmp_path: Path) -> None:
    """A poisoned home and working directory, in a process of its own because Fabric reads configuration at
    import. It is imported for the jump host, and only for that.
    """
    poison = "import pathlib; pathlib.Path(__file__).with_name('canary').touch()\nuser = 'somebody-else'\nload_ssh_configs = True\n"
    home = tmp_path / "home"
    for directory in (home, home / ".ssh"):
        directory.mkdir(parents=True, exist_ok=True)
    for name in (".fabric.py", "fabric.py", "fabfile.py", ".invoke.py", "invoke.py", "tasks.py"):
        (home / name).write_text(poison)
    (home / ".fabric.yaml").write_text("user: somebody-else\n")
    (home / ".ssh/config").write_text("Host *\n  Port 1\n")
    script = (
        "import sys; sys.path = [p for p in sys.path if p not in ('', '.')]\n"
        "from edgectl.transport.ssh import SshTransport; from edgectl.model.inventory import Host, Role\n"
        "for options in ({}, {'proxy_jump': 'robot1'}):\n"
        "    host = Host(name='edge1', role=Role.EDGE, host='edge1', **options)\n"
        "    with SshTransport().connect(host, timeout=30) as session:\n"
        "        print('fabric' in sys.modules, session.run('echo in', b'', timeout=20).stdout)\n"
    )
    root = Path(__file__).parents[2]
    env = {"PATH": os.environ["PATH"], "HOME": str(home), "PYTHONPATH": str(root), **lab.environment}
    ran = subprocess.run(
        [sys.executable, "-c", script],
        cwd=home,
        env=env,
        capture_output=True,
        text=True,
        timeout=patience(60),
        check=False,
    )
    assert ran.stdout == "False b'in\\n'\nTrue b'in\\n'\n", ran.stderr
    assert not list(home.rglob("canary"))


def test_nothing_is_printed_when_a_login_fails(lab: Lab, capfd: pytest.CaptureFixture[str]) -> None:
    """paramiko logs tracebacks of its thread, which Python would print."""
    with run_mute_server() as port, pytest.raises(HostError):
        SshTransport().connect(lab.host("edge1", host="127.0.0.1", port=port), timeout=0.5)
    with pytest.raises(HostError):
        SshTransport().connect(lab.host("edge1", port=1), timeout=patience(10))
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_a_busy_server_is_asked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """sshd accepts one login at a time, and drops the others before its banner until that one is done."""
    with running_lab(tmp_path / "lab", ["edge1"], extra=["MaxStartups 1"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        # The product's pauses are short; on a slow machine sshd may take longer to free the slot.
        monkeypatch.setattr(ssh, "PAUSES_S", (0.2,) * 60)
        server = lab["edge1"]
        with ThreadPoolExecutor(1) as pool:
            with socket.create_connection((server.address, server.port)) as first:
                first.recv(4)  # it occupies the only slot
                waiting = pool.submit(SshTransport().connect, lab.host("edge1"), timeout=patience(60))
                deadline = time.monotonic() + patience(30)
                while "drop connection" not in server.log:
                    assert time.monotonic() < deadline, server.log
                    time.sleep(0.05)
                assert not waiting.done()
            waiting.result(timeout=patience(60)).close()


def test_a_server_that_stays_busy_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running_lab(tmp_path / "lab", ["edge1"], extra=["MaxStartups 1"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        server = lab["edge1"]
        with socket.create_connection((server.address, server.port)) as first:
            first.recv(4)
            with pytest.raises(ConnectError, match="closes the connection before its SSH banner"):
                SshTransport().connect(lab.host("edge1"), timeout=patience(60))


def test_what_is_no_ssh_server(lab: Lab, tmp_path: Path) -> None:
    lab.write_files("Host odd\n  ProxyCommand printf 'HTTP/1.1 400 Bad Request\\r\\n\\r\\n'")
    start = time.monotonic()
    with pytest.raises(ConnectError, match="before its SSH banner"):
        SshTransport().connect(lab.host("edge1", host="odd"), timeout=patience(30))
    assert time.monotonic() - start < patience(15)


def test_a_server_that_talks_without_end(lab: Lab) -> None:
    """A proxy command that repeats one letter forever without a newline must not consume memory or time."""
    lab.write_files("Host odd\n  ProxyCommand yes | tr -d '\\n'")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.monotonic()
    with pytest.raises(ConnectError):
        SshTransport().connect(lab.host("edge1", host="odd"), timeout=patience(30))
    assert time.monotonic() - start < patience(25)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


def test_a_failed_jump_host_fails_its_hosts_at_once(lab: Lab) -> None:
    with socket.create_server(("127.0.0.1", 0), backlog=50) as mute:
        transport = SshTransport()
        for name in ("edge1", "edge2", "edge1", "edge2"):
            with pytest.raises(HostError, match=r"jump host 127\.0\.0\.1"):
                transport.connect(lab.host(name, proxy_jump=f"127.0.0.1:{mute.getsockname()[1]}"), timeout=2)
        assert count_callers(mute) == 1


def test_a_second_key_type_is_no_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server has ed25519 and RSA, known_hosts only RSA: that one is requested first, as OpenSSH does."""
    rsa = tmp_path / "rsa"
    subprocess.run(["ssh-keygen", "-q", "-t", "rsa", "-b", "2048", "-N", "", "-f", rsa], check=True)
    with running_lab(tmp_path / "lab", ["edge1"], extra=[f"HostKey {rsa}"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        server = lab["edge1"]
        lab.known_hosts.write_text(f"[{server.address}]:{server.port} {rsa.with_suffix('.pub').read_text()}")
        SshTransport().connect(lab.host("edge1"), timeout=patience(10)).close()


def test_connections_are_made_in_many_threads(lab: Lab) -> None:
    """One connection clears a Config of Fabric that another shares and reads."""
    verifier, login = HostKeyVerifier(), LoginStrategy("me", ())
    resolved = SshConfigResolver().resolve(lab.host("edge1"))
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)

    def make(_: int) -> str:
        opens: Any = prepare_jump_client(resolved, verifier, TunnelLine(None), login).open
        return str(opens.__self__.user)

    try:
        with ThreadPoolExecutor(8) as pool:
            made = list(pool.map(make, range(400)))
    finally:
        sys.setswitchinterval(interval)
    assert set(made) == {resolved.user}


def test_address(lab: Lab) -> None:
    assert SshTransport().address(lab.host("edge2")) == lab["edge2"].address


def test_a_name_is_looked_up_with_a_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, over = threading.Event(), threading.Event()

    def never(*_: object, **__: object) -> list[object]:
        asked.set()
        over.wait()
        return []

    monkeypatch.setattr("socket.getaddrinfo", never)
    try:
        with pytest.raises(OSError, match="name service"):
            connect_tcp("edge1.example", 22, timeout=0.2)
        assert asked.wait(30)
    finally:
        over.set()


def test_watchdog() -> None:
    bitten = threading.Event()
    with watchdog(0.05, bitten.set) as watch:
        bitten.wait(30)
    assert watch.expired
    with watchdog(60, bitten.clear) as watch:
        pass
    assert bitten.is_set()
    assert not watch.expired


def test_blocks_share_a_watchdog() -> None:
    with watchdog(60, list), ExitStack() as blocks:
        before = set(threading.enumerate())
        for _ in range(20):
            blocks.enter_context(watchdog(60, list))
        assert set(threading.enumerate()) <= before


def test_a_watchdog_waits_for_no_block_and_no_action() -> None:
    """Neither for one that may take longer, nor for an action that hangs."""
    bitten, over = threading.Event(), threading.Event()
    try:
        with watchdog(3600, list), watchdog(0.01, over.wait) as hanging:
            while not hanging.expired:
                over.wait(0.01)
            with watchdog(0.01, bitten.set):
                assert bitten.wait(30)
    finally:
        over.set()


def test_a_watchdog_ends_where_there_is_nothing_to_watch() -> None:
    with watchdog(0.05, list):
        pass
    left = time.monotonic() + 60
    while any(thread.name == "edgectl-watchdog" for thread in threading.enumerate()):
        assert time.monotonic() < left
        time.sleep(0.01)
    bitten = threading.Event()
    with watchdog(0.01, bitten.set):
        assert bitten.wait(30)
