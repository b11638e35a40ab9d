# SPDX-License-Identifier: Apache-2.0
"""Command lines of a login by hand, with port, key and jump host as the inventory states them."""

import shlex
from collections.abc import Iterable

from edgectl.model.inventory import Connection, Host


def format_ssh_command(host: Host, *options: str) -> str:
    """``ssh`` to the host, to be followed by a command; empty for this machine, where none is needed."""
    if host.connection is Connection.LOCAL:
        return ""
    jump = ["-J", host.proxy_jump] if host.proxy_jump else []
    return _join_words(["ssh", *options, *_list_options(host), *jump, _format_target(host)])


def format_copy_id_command(host: Host) -> str:
    """``ssh-copy-id`` to the host."""
    jump = ["-o", f"ProxyJump={host.proxy_jump}"] if host.proxy_jump else []
    return _join_words(["ssh-copy-id", *_list_options(host), *jump, _format_target(host)])


def _join_words(words: Iterable[str]) -> str:
    """The words quoted for a shell, which still expands a leading ``~/``."""
    return " ".join(
        "~/" + shlex.quote(word.removeprefix("~/")) if word.startswith("~/") else shlex.quote(word)
        for word in words
    )


def _format_target(host: Host) -> str:
    return f"{host.user}@{host.host}" if host.user else host.host


def _list_options(host: Host) -> list[str]:
    port = ["-p", str(host.port)] if host.port else []
    return [*port, *(["-i", host.identity_file] if host.identity_file else [])]
