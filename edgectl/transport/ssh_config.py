# SPDX-License-Identifier: Apache-2.0
"""The user's ssh_config for a host, resolved by OpenSSH itself (``ssh -G``) with Include and Match.

The files are found as OpenSSH finds them. The environment variable EDGECTL_SSH_CONFIG names another file
(given to ``ssh -F``); it is the only override, for tests and for tools that keep a configuration of their
own.
"""

import getpass
import hashlib
import os
import pwd
import re
import shutil
import socket
import subprocess
import threading
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.errors import ConnectError
from edgectl.model.inventory import Host, Role
from edgectl.transport.ssh_config_cache import SshConfigCache, Values, compute_config_digest

CONFIG_OVERRIDE_VARIABLE = "EDGECTL_SSH_CONFIG"
SYSTEM_CONFIG = Path("/etc/ssh/ssh_config")
# A line of ssh_config that is neither blank, a comment, ``Host *``, nor a keyword without effect here.
MEANINGFUL_LINE = re.compile(r"(?mi)^[ \t]*(?!#|$|host\s+\*\s*$|sendenv\b|hashknownhosts\b|gssapi|\s)")
# What is used of the reply of ``ssh -G``.
_KEYWORDS = {
    *("hostname", "user", "port", "connecttimeout", "sendenv"),
    *("identityfile", "certificatefile", "identitiesonly", "identityagent"),
    *("proxyjump", "proxycommand", "hostkeyalias", "revokedhostkeys", "kexalgorithms"),
    *("userknownhostsfile", "globalknownhostsfile", "hashknownhosts"),
}
DEFAULT_KEYS = ("~/.ssh/id_rsa", "~/.ssh/id_ecdsa", "~/.ssh/id_ed25519")


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedHost:
    """Everything needed to open a connection, inventory and ssh_config merged; inventory wins.

    ``name`` is the inventory's, ``given`` the address or alias written there, ``hostname`` and ``port`` the
    real target. ``identity_agent`` is the agent's socket, or empty for none. ``known_hosts`` are the user's
    files (the first one is added to), ``revoked_keys`` is the file of RevokedHostKeys, or empty. ``send_env``
    has the patterns of SendEnv, ``key_exchanges`` the names of KexAlgorithms; none where nothing is known.
    """

    name: str
    given: str
    hostname: str
    port: int = 22
    user: str
    identity_files: tuple[str, ...] = ()
    certificate_files: tuple[str, ...] = ()
    identities_only: bool = False
    identity_agent: str = ""
    proxy_jump: str = ""
    proxy_command: str = ""
    known_hosts: tuple[Path, ...] = ()
    global_known_hosts: tuple[Path, ...] = ()
    revoked_keys: str = ""
    host_key_alias: str = ""
    hash_known_hosts: bool = False
    connect_timeout: float | None = None
    send_env: tuple[str, ...] = ()
    key_exchanges: tuple[str, ...] = ()


def get_home_dir() -> str:
    """The home that OpenSSH uses: the account's, not $HOME."""
    try:
        return pwd.getpwuid(os.getuid()).pw_dir
    except KeyError:
        return os.environ.get("HOME", "/")


def list_config_files() -> dict[Path, Path]:
    """The files that ``ssh`` begins to read, there or not, each with the folder of what it includes."""
    override = os.environ.get(CONFIG_OVERRIDE_VARIABLE)
    user_folder = Path(get_home_dir()) / ".ssh"
    if override:
        return {Path(override): user_folder}
    return {user_folder / "config": user_folder, SYSTEM_CONFIG: SYSTEM_CONFIG.parent}


def get_user_name() -> str:
    """The name of the caller; the uid where it has none, as in containers."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())


def build_ssh_options(host: Host) -> list[str]:
    """Arguments of ``ssh`` that state what the inventory says about ``host``; they win over every file.

    Raises:
        ConnectError: the address could be taken for an option.
    """
    if (
        not host.host
        or host.host.startswith("-")
        or any(char.isspace() or not char.isprintable() for char in host.host)
    ):
        raise ConnectError(
            f"{host.host!r} is no host name", hint="correct host: in the inventory", host=host.name
        )
    arguments = ["-F", path] if (path := os.environ.get(CONFIG_OVERRIDE_VARIABLE)) else []
    if host.port is not None:
        arguments += ["-o", f"Port={host.port}"]
    if host.user is not None:
        arguments += ["-o", f"User={host.user}"]
    if host.proxy_jump is not None:
        arguments += ["-o", f"ProxyJump={host.proxy_jump}"]
    if host.identity_file is not None:
        arguments += ["-o", "IdentitiesOnly=yes", "-o", f'IdentityFile="{expand_tilde(host.identity_file)}"']
    return arguments


def expand_tilde(path: str) -> str:
    """``~`` and ``~/`` at the start stand for the account's home."""
    return get_home_dir() + path[1:] if path == "~" or path.startswith("~/") else path


def parse_jump_host(jump: str) -> Host:
    """The last hop of ``[user@]host[:port],..`` as a host, itself reached through the hops before it."""
    before, _, last = jump.rpartition(",")
    last = last.strip().removeprefix("ssh://").rstrip("/")
    user, _, place = last.rpartition("@")
    address, colon, port = place.rpartition(":")
    if not colon or (":" in address and not address.endswith("]")):
        address, port = place, ""
    address = address.strip("[]")
    number = int(port) if port.isdigit() else None
    return Host(
        name=address, role=Role.EDGE, host=address, user=user or None, port=number, proxy_jump=before or None
    )


class SshConfigResolver:
    """Resolves hosts, each once per run. Safe to use from several threads."""

    def __init__(self, cache: Path | None = None) -> None:
        """``cache``: the file with the replies of earlier runs; None always asks."""
        self._known: dict[tuple[object, ...], ResolvedHost] = {}
        self._lock = threading.Lock()
        self._ssh = shutil.which("ssh")
        self._cache = (
            SshConfigCache(cache, partial(_compute_digest, self._ssh)) if cache and self._ssh else None
        )

    def resolve(self, host: Host, *, timeout: float = 10.0) -> ResolvedHost:
        """Merge inventory and ssh_config for ``host``.

        Raises:
            ConnectError: no usable name, a broken ssh_config, or no answer within ``timeout`` seconds.
        """
        key = (host.name, host.host, host.port, host.user, host.proxy_jump, host.identity_file)
        with self._lock:
            if key in self._known:
                return self._known[key]
        resolved = _merge_host_config(
            host, self._get_values(host, timeout) if self._ssh else _build_config_without_ssh(host)
        )
        with self._lock:
            self._known[key] = resolved
        return resolved

    def _get_values(self, host: Host, timeout: float) -> Values:
        arguments = [*build_ssh_options(host), "-G", "--", host.host]
        ask = partial(_ask_ssh, [self._ssh or "ssh", *arguments], host, timeout)
        return ask() if self._cache is None else self._cache.get(arguments, ask)


def _compute_digest(ssh: str) -> str | None:
    return compute_config_digest(ssh, list_config_files(), Path(get_home_dir()), _KEYWORDS)


def _ask_ssh(command: Sequence[str], host: Host, timeout: float) -> dict[str, list[str]]:
    try:
        asked = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ConnectError(
            f"ssh -G {host.host} did not end within {timeout:g} s",
            hint="a Match exec in ssh_config hangs",
            host=host.name,
        ) from error
    if asked.returncode != 0:
        lines = [
            line
            for line in asked.stderr.decode(errors="replace").splitlines()
            if not line.startswith("Pseudo-terminal")
        ]
        raise ConnectError(
            f"ssh_config: {lines[0] if lines else 'refused'}",
            hint=f"try: ssh -G {host.host}",
            host=host.name,
        )
    return parse_ssh_config(asked.stdout.decode(errors="replace"))


def parse_ssh_config(text: str) -> dict[str, list[str]]:
    """Of the output of ``ssh -G`` what is used: keyword to its values, in order."""
    values: dict[str, list[str]] = {}
    for line in text.splitlines():
        keyword, _, value = line.partition(" ")
        if keyword.lower() in _KEYWORDS:
            values.setdefault(keyword.lower(), []).append(value)
    return values


def _build_config_without_ssh(host: Host) -> dict[str, list[str]]:
    """Without an OpenSSH client: the inventory alone. An ssh_config with relevant keywords is refused.

    Raises:
        ConnectError: such an ssh_config exists.
    """
    for path in list_config_files():
        if path.exists() and re.search(MEANINGFUL_LINE, path.read_text(errors="replace")):
            raise ConnectError(
                f"{path} cannot be understood without the ssh program",
                hint="install openssh-client",
                host=host.name,
            )
    return {"identityfile": [host.identity_file] if host.identity_file else list(DEFAULT_KEYS)}


def _merge_host_config(host: Host, values: Mapping[str, list[str]]) -> ResolvedHost:
    """Typed values of ``ssh -G``, which include the inventory's own; those of the inventory without ssh."""

    def one(keyword: str, default: str = "") -> str:
        found = values.get(keyword, [default])[0]
        return "" if found == "none" else found

    hostname = one("hostname", host.host)
    user = one("user", host.user or get_user_name())
    port = int(one("port", str(host.port or 22)))
    alias = one("hostkeyalias")
    jump = one("proxyjump", host.proxy_jump or "")
    tokens = _build_tokens(host.host, hostname, port, user, alias, jump)
    files = [name for name in values.get("identityfile", []) if name != "none"]
    known = one("userknownhostsfile", "~/.ssh/known_hosts").split()
    return ResolvedHost(
        name=host.name,
        given=host.host,
        hostname=hostname,
        port=port,
        user=user,
        identity_files=tuple(_expand_path(name, tokens) for name in files),
        certificate_files=tuple(
            _expand_path(name, tokens) for name in values.get("certificatefile", []) if name != "none"
        ),
        identities_only=host.identity_file is not None or one("identitiesonly") == "yes",
        identity_agent=_resolve_agent_socket(values.get("identityagent", ["SSH_AUTH_SOCK"])[0], tokens),
        proxy_jump=jump,
        proxy_command="" if jump else expand_tokens(one("proxycommand"), tokens),
        known_hosts=tuple(Path(_expand_path(name, tokens)) for name in known),
        global_known_hosts=tuple(Path(name) for name in one("globalknownhostsfile").split()),
        revoked_keys=_expand_path(one("revokedhostkeys"), tokens),
        host_key_alias=alias,
        hash_known_hosts=one("hashknownhosts") == "yes",
        connect_timeout=_parse_seconds(one("connecttimeout")),
        send_env=tuple(pattern for line in values.get("sendenv", []) for pattern in line.split()),
        key_exchanges=tuple(filter(None, one("kexalgorithms").split(","))),
    )


def _parse_seconds(text: str) -> float | None:
    return float(text) if text.isdigit() else None


def _resolve_agent_socket(value: str, tokens: Mapping[str, str]) -> str:
    if value == "none":
        return ""
    if value == "SSH_AUTH_SOCK":
        return os.environ.get("SSH_AUTH_SOCK", "")
    return os.environ.get(value[1:].strip("{}"), "") if value.startswith("$") else _expand_path(value, tokens)


def _expand_path(text: str, tokens: Mapping[str, str]) -> str:
    return expand_tokens(
        expand_tilde(re.sub(r"\$\{(\w+)\}", lambda match: os.environ.get(match[1], ""), text)), tokens
    )


def expand_tokens(text: str, tokens: Mapping[str, str]) -> str:
    """Replace tokens such as ``%h``; unknown ones are left as they are."""
    return re.sub(r"%(.)", lambda match: tokens.get(match[1], match[0]), text)


def _build_tokens(given: str, hostname: str, port: int, user: str, alias: str, jump: str) -> dict[str, str]:
    local = socket.gethostname()
    digest = hashlib.sha1(f"{local}{hostname}{port}{user}{jump}".encode(), usedforsecurity=False).hexdigest()
    return {
        "%": "%",
        "C": digest,
        "d": get_home_dir(),
        "h": hostname,
        "i": str(os.getuid()),
        "j": jump,
        "k": alias or given,
        "L": local.split(".")[0],
        "l": local,
        "n": given,
        "p": str(port),
        "r": user,
        "u": get_user_name(),
    }
