# SPDX-License-Identifier: Apache-2.0
"""Every exception of paramiko is mapped to an error of edgectl."""

import importlib
import inspect
import pkgutil
import socket

import paramiko
import pytest

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.transport import openssh, ssh_errors

# Never raised out of paramiko, or of parts of it that edgectl does not use.
INTERNAL = {"NeedRekeyException", "BERException", "InvalidHostKey", "SFTPError", "WindowsError"}


def list_paramiko_exceptions() -> set[type[BaseException]]:
    found = set()
    for module in pkgutil.iter_modules(paramiko.__path__):
        if module.name in ("_winapi", "win_openssh", "win_pageant"):
            continue
        members = vars(importlib.import_module(f"paramiko.{module.name}")).values()
        found |= {
            m
            for m in members
            if inspect.isclass(m) and issubclass(m, BaseException) and m.__module__.startswith("paramiko")
        }
    return found


def test_the_table_is_complete() -> None:
    mapped = {kind for kind, _, _ in ssh_errors.SSH_ERRORS}
    missing = {kind.__name__ for kind in list_paramiko_exceptions() - mapped} - INTERNAL
    assert not missing, f"give them a row in ssh_errors.TABLE: {missing}"


def test_the_most_specific_row_comes_first() -> None:
    kinds = [kind for kind, _, _ in ssh_errors.SSH_ERRORS]
    for place, kind in enumerate(kinds):
        assert not any(issubclass(kind, earlier) for earlier in kinds[:place]), kind


@pytest.mark.parametrize(
    ("error", "kind", "words"),
    [
        (paramiko.AuthenticationException("3 key(s) refused"), AuthError, "login refused (3 key(s) refused)"),
        (paramiko.BadAuthenticationType("x", ["password"]), AuthError, "the host does not allow"),
        (paramiko.ChannelException(2, "Connect failed"), ConnectError, "the host refused to open a channel"),
        (paramiko.SSHException("Incompatible version"), ConnectError, "SSH failed (Incompatible version)"),
        (ConnectionRefusedError(111, "Connection refused"), ConnectError, "connection refused"),
        (
            ConnectionResetError(104, "Connection reset by peer"),
            ConnectError,
            "connection lost (Connection reset by peer)",
        ),
        (
            socket.gaierror(-2, "Name or service not known"),
            ConnectError,
            "name unknown (Name or service not known)",
        ),
        (TimeoutError(), DeadlineError, "no answer in time"),
        (EOFError(), ConnectError, "connection closed by the host"),
        (OSError(113, "No route to host"), ConnectError, "connection failed (No route to host)"),
        (paramiko.SSHException("two\nlines \x1b[2J"), ConnectError, "SSH failed (two)"),
        (ValueError("odd"), ConnectError, "unexpected ValueError: odd"),
    ],
)
def test_rows(error: Exception, kind: type[HostError], words: str) -> None:
    ours = ssh_errors.translate_ssh_error(error, "edge1")
    assert type(ours) is kind
    assert ours.message.startswith(words)
    assert (ours.host, "\n" in ours.message) == ("edge1", False)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (socket.gaierror(-2, "unknown"), "Could not resolve hostname edge9"),
        (ConnectionRefusedError(111, "refused"), "port 22: Connection refused"),
    ],
)
def test_a_hint_names_what_can_be_wrong_in_both_transports(error: Exception, said: str) -> None:
    """A host that refuses is on, and one whose name is unknown was not asked at all."""
    ours = ssh_errors.translate_ssh_error(error, "edge9")
    assert ours.hint == openssh.translate_openssh_error(said.encode(), "edge9").hint
    assert "host: " in ours.hint
    assert "switched on" not in ours.hint


def test_our_own_errors_pass() -> None:
    error = HostKeyError("changed", hint="look")
    assert ssh_errors.translate_ssh_error(error, "edge1") is error
    assert error.host == "edge1"


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ("ssh: connect to host 10.0.0.1 port 22: Connection refused\r\n", ConnectError),
        ("ssh: connect to host 10.0.0.1 port 22: Connection timed out\r\n", ConnectError),
        ("ssh: connect to host 10.0.0.1 port 22: No route to host\r\n", ConnectError),
        ("ssh: Could not resolve hostname edge9: Name or service not known\r\n", ConnectError),
        (
            "Connection timed out during banner exchange\r\nConnection to 10.0.0.1 port 22 timed out\r\n",
            DeadlineError,
        ),
        ("Permission denied (publickey,password).\r\n", AuthError),
        ("Received disconnect from 10.0.0.1 port 22:2: Too many authentication failures\r\n", AuthError),
        (
            "No ED25519 host key is known for [10.0.0.1]:22 and you have requested strict checking.\r\nHost key verification failed.\r\n",
            HostKeyError,
        ),
        (
            "@ WARNING: REMOTE HOST IDENTIFICATION HAS CHANGED! @\r\nHost key verification failed.\r\n",
            HostKeyError,
        ),
        ("@ WARNING: REVOKED HOST KEY DETECTED! @\r\nHost key verification failed.\r\n", HostKeyError),
        ("client_loop: send disconnect: Broken pipe\r\n", ConnectError),
        ("", ConnectError),
    ],
)
def test_what_ssh_says(said: str, kind: type[HostError]) -> None:
    error = openssh.translate_openssh_error(said.encode(), "edge1")
    assert type(error) is kind
    assert (error.host, "\n" in error.message, bool(error.hint)) == ("edge1", False, True)
