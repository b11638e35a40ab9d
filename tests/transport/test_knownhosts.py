# SPDX-License-Identifier: Apache-2.0
"""The known_hosts reader compared with ssh on the same lines."""

import base64
import hmac
import subprocess
import time
from pathlib import Path

import pytest

from edgectl.errors import HostError, HostKeyError
from edgectl.model.inventory import Connection, Host, Role
from edgectl.transport.known_hosts import (
    HostKey,
    HostKeyVerdict,
    KnownHosts,
    append_line,
    build_known_hosts_name,
    hash_host_name,
)
from edgectl.transport.trust import fetch_host_key, list_ssh_hosts, trust_host_key
from tests.sshd import Lab, make_key


def parse_key(line: str) -> HostKey:
    kind, encoded = line.split()[:2]
    return HostKey(kind, base64.b64decode(encoded))


def generate_key(path: Path, kind: str) -> str:
    subprocess.run(["ssh-keygen", "-q", "-t", kind, "-N", "", "-f", str(path)], check=True)
    return " ".join(path.with_suffix(".pub").read_text().split()[:2])


# {name}: the server's entry, {key}: its key, {other}: another of the same type, {ecdsa}: one of another type,
# {hashed}: its hashed name.
LINES = {
    "nothing": ("", HostKeyVerdict.UNKNOWN),
    "plain": ("{name} {key}", HostKeyVerdict.KNOWN),
    "with comment and blanks": ("  {name}\t{key} root@edge1 laptop", HostKeyVerdict.KNOWN),
    "hashed": ("{hashed} {key}", HostKeyVerdict.KNOWN),
    "hashed, other key": ("{hashed} {other}", HostKeyVerdict.CHANGED),
    "comma list": ("edge9,{name},10.0.0.9 {key}", HostKeyVerdict.KNOWN),
    "pattern": ("[127.*]:* {key}", HostKeyVerdict.KNOWN),
    "pattern of one": ("[{almost}]:* {key}", HostKeyVerdict.KNOWN),
    "negated pattern": ("[127.*]:*,!{name} {key}", HostKeyVerdict.UNKNOWN),
    "name without port": ("{bare} {key}", HostKeyVerdict.KNOWN),
    "name without port, other key": ("{bare} {other}", HostKeyVerdict.UNKNOWN),
    "same type, other key": ("{name} {other}", HostKeyVerdict.CHANGED),
    "other type only": ("{name} {ecdsa}", HostKeyVerdict.CHANGED),
    "two keys of one type": ("{name} {other}\n{name} {key}", HostKeyVerdict.KNOWN),
    "two types": ("{name} {ecdsa}\n{name} {key}", HostKeyVerdict.KNOWN),
    "plain other, hashed right": ("{name} {other}\n{hashed} {key}", HostKeyVerdict.KNOWN),
    "revoked": ("{name} {key}\n@revoked {name} {key}", HostKeyVerdict.REVOKED),
    "revoked everywhere": ("@revoked * {key}\n{name} {key}", HostKeyVerdict.REVOKED),
    "revoked by hashed name": ("{name} {key}\n@revoked {hashed} {key}", HostKeyVerdict.REVOKED),
    "revoked other key": ("{name} {key}\n@revoked {name} {other}", HostKeyVerdict.KNOWN),
    "revoked elsewhere": ("{name} {key}\n@revoked example.com {key}", HostKeyVerdict.KNOWN),
    "revoked alone": ("@revoked {name} {key}", HostKeyVerdict.REVOKED),
    "authority alone": ("@cert-authority * {key}", HostKeyVerdict.UNKNOWN),
    "authority beside a key": ("@cert-authority * {other}\n{name} {key}", HostKeyVerdict.KNOWN),
    "comment": ("# {name} {key}", HostKeyVerdict.UNKNOWN),
    "broken lines around": (
        "garbage\n\n{name}\n{name} ssh-ed25519 AAAA\n@nonsense {name} {other}\n{name} {key}",
        HostKeyVerdict.KNOWN,
    ),
    "type that is not the key's": ("{name} ssh-rsa {encoded}", HostKeyVerdict.UNKNOWN),
    "broken hash": ("|1|zz|yy {key}\n|2|a|b {key}", HostKeyVerdict.UNKNOWN),
}


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    directory = tmp_path_factory.mktemp("keys")
    return {
        "other": generate_key(directory / "other", "ed25519"),
        "ecdsa": generate_key(directory / "ecdsa", "ecdsa"),
    }


@pytest.mark.parametrize("kind", LINES)
def test_lines_mean_what_ssh_makes_of_them(lab: Lab, others: dict[str, str], kind: str) -> None:
    server = lab["edge1"]
    name = f"[{server.address}]:{server.port}"
    words = {
        "name": name,
        "bare": server.address,
        "key": server.key,
        "encoded": server.key.split()[1],
        "hashed": hash_host_name(name),
    } | others
    words["almost"] = server.address[:-1] + "?"
    lines, expected = LINES[kind]
    lab.known_hosts.write_text(lines.format(**words) + "\n")

    assert (
        KnownHosts([lab.known_hosts]).check(parse_key(server.key), server.address, server.port).verdict
        is expected
    )

    command: list[str | Path] = [
        "ssh",
        "-F",
        lab.ssh_config,
        "-o",
        "BatchMode=yes",
        "-o",
        "StrictHostKeyChecking=yes",
        "edge1",
        "true",
    ]
    ssh = subprocess.run(command, capture_output=True, text=True, check=False)
    said = {
        HostKeyVerdict.KNOWN: ssh.returncode == 0,
        HostKeyVerdict.UNKNOWN: "host key is known for" in ssh.stderr,
        HostKeyVerdict.CHANGED: "HAS CHANGED" in ssh.stderr,
        HostKeyVerdict.REVOKED: "REVOKED" in ssh.stderr,
    }
    assert [verdict for verdict, yes in said.items() if yes] == [expected], ssh.stderr


@pytest.mark.parametrize(
    ("names", "host", "port", "found"),
    [
        ("edge1", "EDGE1", 22, True),
        ("EDGE1", "edge1", 22, True),
        ("*.lab", "edge1.lab", 22, True),
        ("*.lab", "edge1.lab.example", 22, False),
        ("*.lab,!bad.lab", "bad.lab", 22, False),
        ("edge?", "edge12", 22, False),
        ("[edge1]:2222", "edge1", 2222, True),
        ("[edge1]:2222", "edge1", 22, False),
        ("edge1", "edge1", 2222, True),
        ("10.0.0.*", "10.0.0.7", 22, True),
    ],
)
def test_names(tmp_path: Path, others: dict[str, str], names: str, host: str, port: int, found: bool) -> None:
    (tmp_path / "known_hosts").write_text(f"{names} {others['other']}\n")
    known = KnownHosts([tmp_path / "known_hosts"])
    assert (known.check(parse_key(others["other"]), host, port).verdict is HostKeyVerdict.KNOWN) is found
    if port == 22:
        asked = subprocess.run(
            ["ssh-keygen", "-F", host.lower(), "-f", tmp_path / "known_hosts"],
            capture_output=True,
            check=False,
        )
        assert (asked.returncode == 0) is found


def test_alias_is_used_without_the_port(tmp_path: Path, others: dict[str, str]) -> None:
    (tmp_path / "known_hosts").write_text(f"gate {others['other']}\n")
    assert (
        KnownHosts([tmp_path / "known_hosts"])
        .check(parse_key(others["other"]), "1.2.3.4", 2222, "Gate")
        .verdict
        is HostKeyVerdict.KNOWN
    )


def test_files_add_up_and_may_be_missing(tmp_path: Path, others: dict[str, str]) -> None:
    (tmp_path / "system").write_text(f"edge1 {others['ecdsa']}\n")
    (tmp_path / "user").write_text(f"edge1 {others['other']}\n")
    known = KnownHosts([tmp_path / "user", tmp_path / "missing", tmp_path / "system"])
    assert known.check(parse_key(others["ecdsa"]), "edge1", 22).verdict is HostKeyVerdict.KNOWN
    assert known.key_types("edge1", 22) == ["ssh-ed25519", "ecdsa-sha2-nistp256"]
    assert known.key_types("[edge1]", 22) == []


def test_a_finding_names_the_lines_it_rests_on(tmp_path: Path, others: dict[str, str]) -> None:
    path = tmp_path / "known_hosts"
    path.write_text(f"# comment\nedge1 {others['other']}\n")
    finding = KnownHosts([path]).check(parse_key(others["ecdsa"]), "edge1", 22)
    assert finding.known == ((parse_key(others["other"]), f"{path}:2"),)


def test_fingerprint_is_the_one_that_ssh_keygen_prints(tmp_path: Path, others: dict[str, str]) -> None:
    (tmp_path / "key.pub").write_text(others["ecdsa"] + "\n")
    printed = subprocess.run(
        ["ssh-keygen", "-l", "-f", tmp_path / "key.pub"], capture_output=True, text=True, check=True
    ).stdout
    assert parse_key(others["ecdsa"]).fingerprint == printed.split()[1]


def test_appending_changes_no_line(tmp_path: Path) -> None:
    path = tmp_path / "new" / "known_hosts"
    append_line(path, "first")
    path.write_text(path.read_text() + "unfinished")
    append_line(path, "second")
    assert path.read_text() == "first\nunfinished\nsecond\n"
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.parent.stat().st_mode & 0o777 == 0o700


def test_hashed_names_are_those_of_openssh() -> None:
    _, _, salt, digest = hash_host_name("edge1").split("|")
    assert hmac.digest(base64.b64decode(salt), b"edge1", "sha1") == base64.b64decode(digest)


def test_a_file_that_cannot_be_written(tmp_path: Path, others: dict[str, str]) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(HostKeyError, match="cannot record"):
        KnownHosts([]).add(tmp_path / "file" / "known_hosts", parse_key(others["other"]), "edge1", 22)


def test_four_thousand_lines_are_read_and_searched_quickly(tmp_path: Path, others: dict[str, str]) -> None:
    """paramiko needs 5.6 s to load as many hashed lines, and more to search them."""
    path = tmp_path / "known_hosts"
    path.write_text("".join(f"{hash_host_name(f'edge{n}')} {others['other']}\n" for n in range(4096)))
    start = time.process_time()
    known = KnownHosts([path])
    assert known.check(parse_key(others["other"]), "edge4000", 22).verdict is HostKeyVerdict.KNOWN
    assert time.process_time() - start < 4.0


def test_trust(lab: Lab) -> None:
    lab.known_hosts.write_text("")
    host, server = lab.host("edge1"), lab["edge1"]
    shown = fetch_host_key(host, timeout=20)
    assert shown.key == parse_key(server.key)
    assert (shown.verdict, "not known" in str(shown.error)) == (HostKeyVerdict.UNKNOWN, True)
    assert lab.known_hosts.read_text() == ""
    assert trust_host_key(shown) == lab.known_hosts
    assert trust_host_key(shown) == lab.known_hosts
    assert lab.known_hosts.read_text() == server.known_hosts_line
    assert fetch_host_key(host, timeout=20)[2:] == (HostKeyVerdict.KNOWN, None)


def test_trust_does_not_replace_a_key(lab: Lab, tmp_path: Path) -> None:
    server, other = lab["edge1"], make_key(tmp_path / "other")
    lab.known_hosts.write_text(f"[{server.address}]:{server.port} {other}\n")
    shown = fetch_host_key(lab.host("edge1"), timeout=20)
    assert (shown.verdict, "changed" in str(shown.error)) == (HostKeyVerdict.CHANGED, True)
    with pytest.raises(HostKeyError, match="changed"):
        trust_host_key(shown)


def test_a_host_without_an_answer_has_no_key_to_record(lab: Lab) -> None:
    lab["edge1"].stop()
    shown = fetch_host_key(lab.host("edge1"), timeout=20)
    assert (shown.key, shown.verdict) == (None, None)
    with pytest.raises(HostError, match="refused"):
        trust_host_key(shown)
    lab["edge1"].restart()


def test_this_machine_has_no_host_key() -> None:
    here = Host(name="here", role=Role.EDGE, host="localhost", connection=Connection.LOCAL)
    assert list_ssh_hosts([here]) == ()


def test_lookup_names() -> None:
    assert [
        build_known_hosts_name("Edge1", 22),
        build_known_hosts_name("::1", 2222),
        build_known_hosts_name("edge1", 2222, "Gate"),
    ] == ["edge1", "[::1]:2222", "gate"]
