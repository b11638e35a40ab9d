# SPDX-License-Identifier: Apache-2.0
"""Replies of ``ssh -G`` that are kept: used as long as nothing changed on which they depend, by the real ssh."""

import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.model.inventory import Host, Role
from edgectl.transport import ssh_config
from edgectl.transport.ssh_config import ResolvedHost, SshConfigResolver

KEPT = "kept-user"


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "config"
    monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(path))
    (tmp_path / "more.d").mkdir()
    (tmp_path / "more.d" / "2.conf").write_text("Host edge*\n  Port 4022\n")
    path.write_text(f"Include {tmp_path}/more.d/*.conf\nHost edge1\n  User {KEPT}\n")
    return path


def resolve_host(cache: Path | None, address: str = "edge1", **values: object) -> ResolvedHost:
    given: dict[str, object] = {"name": address, "role": Role.EDGE, "host": address, **values}
    return SshConfigResolver(cache).resolve(Host(**given))  # type: ignore[arg-type]


def mark_replies(cache: Path) -> None:
    """Change what is kept, so that a reply shows where it came from."""
    cache.write_text(cache.read_text().replace(KEPT, "from-the-file"))


def test_a_reply_is_asked_for_once(config: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache.json"
    first = resolve_host(cache)
    assert (first.user, first.port) == (KEPT, 4022)
    assert resolve_host(cache) == first
    assert cache.stat().st_mode & 0o777 == 0o600
    mark_replies(cache)
    assert resolve_host(cache).user == "from-the-file"
    # Of another host, or with other words of the inventory, nothing is known yet; what is known stays.
    assert resolve_host(cache, "edge2").user != "from-the-file"
    assert resolve_host(cache, "edge1", port=7).user == KEPT
    assert resolve_host(cache).user == "from-the-file"


CHANGES: dict[str, Callable[[Path], object]] = {
    "a file": lambda config: config.write_text(config.read_text() + "Host *\n  ConnectTimeout 3\n"),
    "an included file": lambda config: (config.parent / "more.d" / "2.conf").write_text("Port 1\n"),
    "one more included file": lambda config: (config.parent / "more.d" / "1.conf").write_text("Port 2\n"),
    "one included file less": lambda config: (config.parent / "more.d" / "2.conf").unlink(),
    "a mode": lambda config: config.chmod(0o640),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_change_makes_all_replies_old(config: Path, tmp_path: Path, what: str) -> None:
    cache = tmp_path / "cache.json"
    resolve_host(cache)
    mark_replies(cache)
    CHANGES[what](config)
    assert resolve_host(cache) == resolve_host(None)
    mark_replies(cache)
    assert resolve_host(cache).user == "from-the-file"


def test_replies_that_were_kept_without_a_keyword_are_asked_for_anew(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an earlier edgectl kept them."""
    cache = tmp_path / "cache.json"
    with monkeypatch.context() as patch:
        patch.setattr(ssh_config, "_KEYWORDS", ssh_config._KEYWORDS - {"kexalgorithms"})
        assert resolve_host(cache).key_exchanges == ()
    assert "ecdh-sha2-nistp256" in resolve_host(cache).key_exchanges


def test_another_file_has_replies_of_its_own(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "cache.json"
    resolve_host(cache)
    mark_replies(cache)
    other = tmp_path / "other"
    other.write_text(config.read_text())
    monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(other))
    assert resolve_host(cache).user == KEPT


@pytest.mark.parametrize(
    "line",
    [
        "Match host edge1\n  Port 5",
        'Match exec "true"\n  Port 5',
        "match=all\n  Port 5",
        "CanonicalizeHostname no",
        "IdentityFile ${HOME}/key",
        'Include "more.d/*"',
        '"Port" 5',
    ],
)
def test_what_depends_on_more_than_the_files_is_asked_anew(config: Path, tmp_path: Path, line: str) -> None:
    cache = tmp_path / "cache.json"
    config.write_text(f"{line}\n{config.read_text()}")
    assert resolve_host(cache) == resolve_host(None)
    assert not cache.exists()
    (tmp_path / "more.d" / "3.conf").write_text(f"{line}\n")
    config.write_text(f"Include {tmp_path}/more.d/*.conf\n")
    resolve_host(cache)
    assert not cache.exists()


def test_the_reply_of_another_client_is_not_kept(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may have been built to read other files."""
    (tmp_path / "bin").mkdir()
    shutil.copy(shutil.which("ssh") or "", tmp_path / "bin" / "ssh")
    monkeypatch.setenv("PATH", str(tmp_path / "bin"), prepend=os.pathsep)
    assert resolve_host(tmp_path / "cache.json").user == KEPT
    assert not (tmp_path / "cache.json").exists()


def damage_digest(text: str) -> str:
    return text.replace('{"digest": "', '{"digest": "0')


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: "",
        lambda text: text[: len(text) // 2],
        lambda _: "[]",
        damage_digest,
        lambda text: json.dumps({**json.loads(text), "replies": []}),
        lambda text: json.dumps(
            {**json.loads(text), "replies": dict.fromkeys(json.loads(text)["replies"], 1)}
        ),
        lambda text: text.replace(f'["{KEPT}"]', f'"{KEPT}"'),
        lambda text: text.replace(f'["{KEPT}"]', "[5]"),
    ],
)
def test_a_damaged_file_is_as_good_as_none(
    config: Path, tmp_path: Path, damage: Callable[[str], str]
) -> None:
    cache = tmp_path / "cache.json"
    resolve_host(cache)
    cache.write_text(damage(cache.read_text()))
    assert resolve_host(cache).user == KEPT


def test_a_file_that_cannot_be_written_is_as_good_as_none(config: Path, tmp_path: Path) -> None:
    assert resolve_host(tmp_path / "nowhere" / "cache.json").user == KEPT
    (tmp_path / "cache.json").mkdir()
    assert resolve_host(tmp_path / "cache.json").user == KEPT
    assert list(tmp_path.glob("cache.json.*")) == []


def test_hosts_that_are_asked_at_once_are_all_kept(config: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache.json"
    resolver = SshConfigResolver(cache)
    names = [f"edge{number}" for number in range(12, 0, -1)]
    with ThreadPoolExecutor(12) as pool:
        list(pool.map(lambda name: resolver.resolve(Host(name=name, role=Role.EDGE, host=name)), names))
    assert len(json.loads(cache.read_text())["replies"]) == len(names)


def test_a_change_while_hosts_are_asked_is_not_kept(config: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache.json"
    resolver = SshConfigResolver(cache)
    config.write_text("Port 9\n")
    assert resolver.resolve(Host(name="edge1", role=Role.EDGE, host="edge1")).port == 9
    assert not cache.exists()


LINES = st.sampled_from(
    [
        *(
            "Host edge1",
            "Host edge*",
            "Host * !edge2",
            "Host edge2 edge1",
            "# Match host edge1",
            "",
            "\tHost\tedge2",
        ),
        *(
            "Port 9",
            "Port=10",
            "  User me",
            "HostName %h.lab",
            "IdentityFile ~/.ssh/%h",
            "ProxyJump gate",
            "Include inc/*",
        ),
        *(
            "Match host edge1",
            "SendEnv A B",
            "KexAlgorithms -ecdh-sha2-nistp256",
            "ProxyCommand nc %h %p",
            "UserKnownHostsFile /a /b",
            "Port nothing",
        ),
    ]
)


@settings(max_examples=25, deadline=None)
@given(lines=st.lists(LINES, max_size=6), included=st.lists(LINES, max_size=3))
def test_kept_replies_are_those_of_ssh(
    tmp_path_factory: pytest.TempPathFactory, lines: list[str], included: list[str]
) -> None:
    folder = tmp_path_factory.mktemp("config")
    (folder / "inc").mkdir()
    (folder / "inc" / "1").write_text("\n".join(included) + "\n")
    text = "\n".join(lines).replace("Include inc", f"Include {folder}/inc")
    (folder / "config").write_text(text + "\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGECTL_SSH_CONFIG", str(folder / "config"))
        for _ in range(2):
            for name in ("edge2", "edge1"):
                assert ask(folder / "cache.json", name) == ask(None, name)


def ask(cache: Path | None, name: str) -> ResolvedHost | str:
    try:
        return resolve_host(cache, name)
    except Exception as error:
        return str(error)
