# SPDX-License-Identifier: Apache-2.0
"""Keys, agents and passwords of the paramiko transport."""

import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import paramiko
import pytest

from edgectl.errors import AuthError
from edgectl.model.inventory import Host, Role
from edgectl.transport.known_hosts import HostKey
from edgectl.transport.ssh import SshTransport
from edgectl.transport.ssh_auth import Keyring, SshAgentClient
from edgectl.transport.ssh_config import SshConfigResolver
from tests.pace import patience
from tests.relay import count_callers
from tests.sshd import Lab, make_key


def is_listening(path: Path) -> bool:
    """Return whether a server listens at a socket; the socket's file exists a moment before."""
    with socket.socket(socket.AF_UNIX) as line:
        return line.connect_ex(str(path)) == 0


@contextmanager
def run_agent(directory: Path, *keys: Path) -> Iterator[str]:
    """Run a real ssh-agent with ``keys``."""
    path = directory / "agent.sock"
    process = subprocess.Popen(["ssh-agent", "-D", "-a", str(path)], stdout=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + patience(30)
        while not is_listening(path):
            assert time.monotonic() < deadline, "the agent did not start"
            time.sleep(0.01)
        subprocess.run(["ssh-add", "-q", *keys], env=os.environ | {"SSH_AUTH_SOCK": str(path)}, check=True)
        yield str(path)
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


def use_agent(lab: Lab, path: str, *lines: str) -> None:
    """Write the lab's ssh_config with an agent, and without keys unless ``lines`` name one."""
    lab.write_files(key=Path("none"))
    text = (
        lab.ssh_config.read_text()
        .replace("IdentityAgent none", f"IdentityAgent {path}")
        .replace("  IdentitiesOnly yes\n", "")
    )
    lab.ssh_config.write_text(text.replace("  IdentityFile none\n", "".join(f"  {line}\n" for line in lines)))


def can_log_in(host: Host, transport: SshTransport | None = None) -> bool:
    with (transport or SshTransport()).connect(host, timeout=patience(10)) as session:
        return session.run("echo in", b"", timeout=patience(20)).stdout == b"in\n"


def test_key_of_the_agent(lab: Lab, tmp_path: Path) -> None:
    with run_agent(tmp_path, lab.user_key) as path:
        use_agent(lab, path)
        assert can_log_in(lab.host("edge1"))


def test_agent_key_is_found_by_its_public_half(lab: Lab, tmp_path: Path) -> None:
    """The file is unreadable for us (protected by a passphrase, for example), but the agent holds the key,
    among too many others.
    """
    strangers = [tmp_path / f"stranger{n}" for n in range(8)]
    for stranger in strangers:
        make_key(stranger)
    locked = tmp_path / "locked"
    locked.write_text("not readable")
    Path(f"{locked}.pub").write_text(Path(f"{lab.user_key}.pub").read_text())
    with run_agent(tmp_path, *strangers, lab.user_key) as path:
        use_agent(lab, path, f"IdentityFile {locked}", "IdentitiesOnly yes")
        assert can_log_in(lab.host("edge1"))
        assert "Failed publickey" not in lab["edge1"].log.split("Connection from")[-1]
        use_agent(lab, path)
        with pytest.raises(AuthError, match="closed the connection after"):
            can_log_in(lab.host("edge1"))


def test_a_mute_agent_is_waited_for_three_seconds(lab: Lab, tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as mute:
        mute.bind(str(tmp_path / "mute"))
        mute.listen(5)
        use_agent(lab, str(tmp_path / "mute"), f"IdentityFile {lab.user_key}")
        transport = SshTransport()
        assert can_log_in(lab.host("edge1"), transport)
        assert can_log_in(lab.host("edge2"), transport)
        assert can_log_in(lab.host("robot1"), transport)
        assert count_callers(mute) == 1, "waited for once, not by each login"


def test_agents_that_are_none(tmp_path: Path) -> None:
    assert SshAgentClient(str(tmp_path / "missing")).keys() == []
    ours, theirs = socket.socketpair()
    ours.close()
    theirs.close()
    with socket.socket(socket.AF_UNIX) as odd:
        odd.bind(str(tmp_path / "odd"))
        odd.listen(1)

        def answer() -> None:
            line, _ = odd.accept()
            with line:
                line.recv(100)
                line.sendall(b"\xff\xff\xff\xff garbage")

        thread = threading.Thread(target=answer)
        thread.start()
        assert SshAgentClient(str(tmp_path / "odd")).keys() == []
        thread.join()


@pytest.mark.parametrize("kind", ["rsa", "ecdsa", "ed25519"])
def test_kinds_of_user_keys(lab: Lab, tmp_path: Path, kind: str) -> None:
    key = tmp_path / "key"
    subprocess.run(["ssh-keygen", "-q", "-t", kind, "-N", "", "-f", key], check=True)
    before = lab.authorized_keys.read_text()
    lab.authorized_keys.write_text(before + key.with_suffix(".pub").read_text())
    try:
        lab.write_files(key=key)
        assert can_log_in(lab.host("edge1"))
    finally:
        lab.authorized_keys.write_text(before)


def test_user_certificate(lab: Lab, tmp_path: Path) -> None:
    """A key that is accepted only with its certificate."""
    key, authority = tmp_path / "key", tmp_path / "authority"
    make_key(key)
    public = make_key(authority)
    user = SshConfigResolver().resolve(lab.host("edge1")).user
    subprocess.run(
        ["ssh-keygen", "-q", "-s", authority, "-I", "test", "-n", user, "-V", "-1h:+1h", f"{key}.pub"],
        check=True,
    )
    before = lab.authorized_keys.read_text()
    lab.authorized_keys.write_text(f"{before}cert-authority {public}\n")
    try:
        lab.write_files(key=key)
        assert can_log_in(lab.host("edge1"))
    finally:
        lab.authorized_keys.write_text(before)


def test_keys_are_parsed_once(lab: Lab) -> None:
    keyring, resolved = Keyring(), SshConfigResolver().resolve(lab.host("edge1"))
    assert keyring.keys_for(resolved)[0] is keyring.keys_for(resolved)[0]


def test_files_that_are_no_keys(lab: Lab, tmp_path: Path) -> None:
    (tmp_path / "odd").write_text("hello")
    (tmp_path / "directory").mkdir()
    subprocess.run(
        ["ssh-keygen", "-q", "-t", "ed25519", "-N", "passphrase", "-f", tmp_path / "locked"], check=True
    )
    lab.write_files(
        *(f"IdentityFile {tmp_path}/{name}" for name in ("odd", "directory", "locked", "missing"))
    )
    assert can_log_in(lab.host("edge1"))


# -- passwords ---------------------------------------------------------------------------------------------------------------------------


class PasswordOnly(paramiko.ServerInterface):
    """Accepts the password "sesame" only, and, like many hosts, only after rejecting keys."""

    def __init__(self, tried: list[str]) -> None:
        self.tried = tried

    def get_allowed_auths(self, username: str) -> str:
        return "publickey,password"

    def check_auth_publickey(self, username: str, key: paramiko.PKey) -> int:
        return paramiko.common.AUTH_FAILED

    def check_auth_password(self, username: str, password: str) -> int:
        self.tried.append(password)
        return paramiko.common.AUTH_SUCCESSFUL if password == "sesame" else paramiko.common.AUTH_FAILED

    def check_channel_request(self, kind: str, chanid: int) -> int:
        return paramiko.common.OPEN_SUCCEEDED

    def check_channel_exec_request(self, channel: paramiko.Channel, command: bytes) -> bool:
        threading.Thread(target=self._answer, args=(channel,)).start()
        return True

    def _answer(self, channel: paramiko.Channel) -> None:
        while channel.recv(
            1024
        ):  # up to the end of the input: paramiko's server confirms the request only after this thread has started
            pass
        channel.sendall(b"in\n")
        channel.send_exit_status(0)
        channel.close()


@contextmanager
def run_password_server(lab: Lab) -> Iterator[tuple[int, list[str]]]:
    """Run a server that requires a password; yields its port and the passwords that it received."""
    tried: list[str] = []
    key = paramiko.Ed25519Key.from_private_key_file(str(lab["edge1"].directory / "host_key"))
    transports: list[paramiko.Transport] = []
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        try:
            while True:
                line, _ = listener.accept()
                transport = paramiko.Transport(line)
                transport.add_server_key(key)
                transports.append(transport)
                transport.start_server(server=PasswordOnly(tried), event=threading.Event())
        except OSError:
            return

    thread = threading.Thread(target=serve)
    thread.start()
    port = listener.getsockname()[1]
    lab.known_hosts.write_text(f"[127.0.0.1]:{port} {HostKey(key.get_name(), key.asbytes()).text}\n")
    try:
        yield port, tried
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join(5)
        for transport in transports:
            transport.close()


def test_a_password_is_asked_for_after_the_keys_and_once(lab: Lab) -> None:
    asked: list[str] = []

    def ask(prompt: str) -> str:
        asked.append(prompt)
        return "sesame"

    with run_password_server(lab) as (port, tried):
        host = Host(name="edge1", role=Role.EDGE, host="127.0.0.1", port=port, user="jetson")
        transport = SshTransport(ask_password=ask)
        assert can_log_in(host, transport)
        assert can_log_in(host, transport)
    assert asked == ["jetson@127.0.0.1's password: "]
    assert tried == ["sesame", "sesame"]


def test_a_host_that_takes_keys_only_asks_for_no_password(lab: Lab, tmp_path: Path) -> None:
    make_key(tmp_path / "stranger")
    lab.write_files(key=tmp_path / "stranger")
    with pytest.raises(AuthError, match=r"1 key\(s\) refused"):
        can_log_in(lab.host("edge1"), SshTransport(ask_password=pytest.fail))


def test_without_somebody_to_ask_nothing_is_asked(lab: Lab) -> None:
    with run_password_server(lab) as (port, tried):
        with pytest.raises(AuthError):
            can_log_in(Host(name="edge1", role=Role.EDGE, host="127.0.0.1", port=port))
        assert tried == []


def test_a_wrong_password_is_offered_once(lab: Lab) -> None:
    with run_password_server(lab) as (port, tried):
        host = Host(name="edge1", role=Role.EDGE, host="127.0.0.1", port=port)
        transport = SshTransport(ask_password=lambda _: "wrong")
        for _ in range(2):
            with pytest.raises(AuthError):
                can_log_in(host, transport)
        assert tried == ["wrong"]


@pytest.mark.parametrize(
    ("command", "good"),
    [
        (("echo", "sesame"), True),
        (("printf", "sesame\\nmore"), True),
        (("false",), False),
        (("true",), False),
        (("no-such-program",), False),
    ],
)
def test_password_command(lab: Lab, command: tuple[str, ...], good: bool) -> None:
    with run_password_server(lab) as (port, tried):
        host = Host(name="edge1", role=Role.EDGE, host="127.0.0.1", port=port, password_command=command)
        if good:
            assert can_log_in(host)
            assert tried == ["sesame"]
        else:
            with pytest.raises(AuthError, match="password_command"):
                can_log_in(host)
