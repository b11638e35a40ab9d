# SPDX-License-Identifier: Apache-2.0
"""ssh_config as OpenSSH reads it, since OpenSSH evaluates it."""

import getpass
import os
import time
from pathlib import Path

import pytest

from edgectl.errors import ConnectError
from edgectl.model.inventory import Host, Role
from edgectl.transport.ssh_config import (
    ResolvedHost,
    SshConfigResolver,
    expand_tilde,
    expand_tokens,
    get_home_dir,
    parse_jump_host,
)
from tests.pace import patience


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "config"
    monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(path))
    return path


def a_host(address: str = "edge1", **values: object) -> Host:
    return Host(**({"name": "edge1", "role": Role.EDGE, "host": address} | values))  # type: ignore[arg-type]


def resolve_host(address: str = "edge1", **values: object) -> ResolvedHost:
    return SshConfigResolver().resolve(a_host(address, **values))


def test_aliases_and_defaults(config: Path) -> None:
    config.write_text(
        "Host edge1\n  HostName 10.0.0.1\n  User jetson\n  Port 2222\nHost *\n  IdentityFile ~/.ssh/lab\n"
    )
    found = resolve_host()
    assert (found.hostname, found.user, found.port) == ("10.0.0.1", "jetson", 2222)
    assert found.identity_files == (f"{get_home_dir()}/.ssh/lab",)
    assert resolve_host("10.9.9.9").user == getpass.getuser()
    assert resolve_host("10.9.9.9").port == 22


def test_the_inventory_wins(config: Path) -> None:
    config.write_text(
        "Host edge1\n  User jetson\n  Port 2222\n  ProxyJump gate\n  IdentityFile /keys/other\n"
    )
    found = resolve_host(user="me", port=99, proxy_jump="none", identity_file="~/keys/lab %h")
    assert (found.user, found.port, found.proxy_jump) == ("me", 99, "")
    assert found.identity_files[0].startswith(f"{get_home_dir()}/keys/lab ")
    assert found.identities_only


def test_include_and_match(config: Path, tmp_path: Path) -> None:
    """Directives that paramiko ignores or misreads."""
    (tmp_path / "more").write_text("Host edge1\n  Port 4022\n")
    config.write_text(
        f'Include {tmp_path}/more\nMatch host nobody\n  Port 1\nMatch host edge1 exec "true"\n  User matched\nMatch tagged nothing\n  User wrong\n'
    )
    if "tagged" in config.read_text():  # older clients do not know the criterion, and refuse the file
        config.write_text(config.read_text().replace("Match tagged nothing\n  User wrong\n", ""))
    found = resolve_host()
    assert (found.port, found.user) == (4022, "matched")


def test_files_of_known_hosts(config: Path, tmp_path: Path) -> None:
    config.write_text(
        f"UserKnownHostsFile {tmp_path}/one {tmp_path}/two\nGlobalKnownHostsFile none\nHashKnownHosts yes\nHostKeyAlias gate\n"
    )
    found = resolve_host()
    assert found.known_hosts == (tmp_path / "one", tmp_path / "two")
    assert (found.global_known_hosts, found.hash_known_hosts, found.host_key_alias) == ((), True, "gate")
    config.write_text("Host x\n")
    assert resolve_host().known_hosts[0] == Path(get_home_dir()) / ".ssh/known_hosts"


def test_proxies_and_tokens(config: Path) -> None:
    config.write_text("Host edge1\n  HostName 10.0.0.1\n  ProxyCommand nc -x %r %h %p %n %%\n")
    assert resolve_host(user="me", port=7).proxy_command == "nc -x me 10.0.0.1 7 edge1 %"
    assert resolve_host(proxy_jump="a,b").proxy_jump == "a,b"
    config.write_text("Host edge1\n  ProxyJump gate\n  IdentityFile /k/%h-%d\n  CertificateFile ${HOME}/c\n")
    found = resolve_host()
    assert (found.proxy_jump, found.proxy_command) == ("gate", "")
    assert found.identity_files == (f"/k/edge1-{get_home_dir()}",)
    assert found.certificate_files == (os.environ["HOME"] + "/c",)


@pytest.mark.parametrize(
    ("line", "agent"),
    [
        ("", "/run/agent"),
        ("IdentityAgent none", ""),
        ("IdentityAgent ~/a", f"{get_home_dir()}/a"),
        ("IdentityAgent $OTHER", "/o"),
    ],
)
def test_agent(config: Path, monkeypatch: pytest.MonkeyPatch, line: str, agent: str) -> None:
    monkeypatch.setenv("SSH_AUTH_SOCK", "/run/agent")
    monkeypatch.setenv("OTHER", "/o")
    config.write_text(line + "\n")
    assert resolve_host().identity_agent == agent


@pytest.mark.parametrize("address", ["-oProxyCommand=touch /tmp/x", "", "a b", "a\nb", "-"])
def test_names_that_are_none(config: Path, address: str) -> None:
    config.write_text("")
    with pytest.raises(ConnectError, match="no host name"):
        resolve_host(address)


def test_a_broken_file_is_named(config: Path) -> None:
    config.write_text("Host edge1\n  Nonsense yes\n")
    with pytest.raises(ConnectError, match=r"(?i)bad configuration option: nonsense"):
        resolve_host()


def test_a_match_that_hangs(config: Path) -> None:
    config.write_text('Match exec "exec sleep 30"\n  Port 1\n')
    start = time.monotonic()
    with pytest.raises(ConnectError, match="did not end"):
        SshConfigResolver().resolve(a_host(), timeout=0.3)
    assert time.monotonic() - start < patience(15)


def test_each_host_is_asked_for_once(config: Path, tmp_path: Path) -> None:
    config.write_text(f'Match exec "echo x >> {tmp_path}/asked"\n  Port 7\n')
    resolver = SshConfigResolver()
    assert [resolver.resolve(a_host()).port for _ in range(5)] == [7] * 5
    assert (tmp_path / "asked").read_text() == "x\n"
    assert resolver.resolve(a_host(user="other")).user == "other"


def test_without_an_ssh_program(config: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    config.write_text("# nothing\n\nHost *\n    SendEnv LANG LC_*\n    HashKnownHosts yes\n")
    found = resolve_host(user="me", port=7, identity_file="~/k", proxy_jump="gate")
    assert (found.hostname, found.user, found.port, found.proxy_jump, found.identity_files) == (
        "edge1",
        "me",
        7,
        "gate",
        (f"{get_home_dir()}/k",),
    )
    assert found.known_hosts == (Path(get_home_dir()) / ".ssh/known_hosts",)
    for text in (
        "Include x\n",
        "Host edge1\n  Port 7\n",
        "match all\n",
        "User x\n",
        "Host *\n  ProxyJump x\n",
    ):
        config.write_text(text)
        with pytest.raises(ConnectError, match="without the ssh program"):
            resolve_host()


@pytest.mark.parametrize(
    ("jump", "expected"),
    [
        ("gate", ("gate", None, None, None)),
        ("me@gate:2222", ("gate", "me", 2222, None)),
        ("a,b@c:1,ssh://d@[::1]:22", ("::1", "d", 22, "a,b@c:1")),
        ("fe80::1", ("fe80::1", None, None, None)),
    ],
)
def test_jump_hosts(jump: str, expected: tuple[str, str | None, int | None, str | None]) -> None:
    host = parse_jump_host(jump)
    assert (host.host, host.user, host.port, host.proxy_jump) == expected


def test_tilde_and_tokens() -> None:
    assert expand_tilde("~/x") == f"{get_home_dir()}/x"
    assert expand_tilde("~other/x") == "~other/x"
    assert expand_tokens("%h %% %q", {"h": "edge1", "%": "%"}) == "edge1 % %q"
