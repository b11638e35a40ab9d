# SPDX-License-Identifier: Apache-2.0
"""Errors of paramiko and the sockets -> errors of edgectl, in one table."""

import socket

import paramiko
from paramiko.auth_strategy import AuthFailure
from paramiko.buffered_pipe import PipeTimeout
from paramiko.pkey import UnknownKeyType
from paramiko.ssh_exception import (
    BadAuthenticationType,
    ConfigParseError,
    CouldNotCanonicalize,
    IncompatiblePeer,
    MessageOrderError,
    NoValidConnectionsError,
    PartialAuthentication,
    PasswordRequiredException,
    UnableToAuthenticate,
)

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.transport.sockets import REFUSED_HINT, UNKNOWN_NAME_HINT

# Most specific first: the first entry that fits an exception names its kind and its words.
SSH_ERRORS: tuple[tuple[type[BaseException], type[HostError], str], ...] = (
    (paramiko.BadHostKeyException, HostKeyError, "host key is not the one in known_hosts"),
    (PasswordRequiredException, AuthError, "a key file needs a passphrase"),
    (BadAuthenticationType, AuthError, "the host does not allow this way to log in"),
    (PartialAuthentication, AuthError, "the host asks for more than a key"),
    (UnableToAuthenticate, AuthError, "login refused"),
    (AuthFailure, AuthError, "login refused"),
    (paramiko.AuthenticationException, AuthError, "login refused"),
    (UnknownKeyType, AuthError, "a key of an unknown type"),
    (paramiko.ChannelException, ConnectError, "the host refused to open a channel"),
    (paramiko.ProxyCommandFailure, ConnectError, "the ProxyCommand failed"),
    (IncompatiblePeer, ConnectError, "no algorithm in common"),
    (MessageOrderError, ConnectError, "the host broke the SSH protocol"),
    (CouldNotCanonicalize, ConnectError, "name cannot be canonicalised"),
    (ConfigParseError, ConnectError, "ssh_config cannot be read"),
    (NoValidConnectionsError, ConnectError, "no address answers"),
    (PipeTimeout, DeadlineError, "no answer in time"),
    (paramiko.SSHException, ConnectError, "SSH failed"),
    (socket.gaierror, ConnectError, "name unknown"),
    (ConnectionRefusedError, ConnectError, "connection refused"),
    (TimeoutError, DeadlineError, "no answer in time"),
    (EOFError, ConnectError, "connection closed by the host"),
    (ConnectionError, ConnectError, "connection lost"),
    (OSError, ConnectError, "connection failed"),
)
SSH_ERROR_HINTS: dict[type[HostError], str] = {
    AuthError: "try ssh by hand; set identity_file: in the inventory; "
    "a key with a passphrase must be in the ssh-agent",
    ConnectError: "check that it is switched on and that its address is correct",
    DeadlineError: "the host is reachable but does not answer: overloaded, frozen or behind a lossy link",
}
# Where the cause says more than our error does.
_CAUSE_HINTS: dict[type[BaseException], str] = {
    socket.gaierror: UNKNOWN_NAME_HINT,
    ConnectionRefusedError: REFUSED_HINT,
}


def translate_ssh_error(error: BaseException, name: str) -> HostError:
    """Our error for ``error`` on host ``name``; errors of ours pass through."""
    if isinstance(error, HostError):
        error.host = error.host or name
        return error
    for kind, ours, words in SSH_ERRORS:
        if isinstance(error, kind):
            said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            detail = "".join(char for char in said.strip().split("\n")[0] if char.isprintable())[:200]
            message = f"{words} ({detail})" if detail and detail.lower() not in words else words
            hint = _CAUSE_HINTS.get(kind) or SSH_ERROR_HINTS.get(ours, "")
            return ours(message, hint=hint, host=name)
    return ConnectError(f"unexpected {type(error).__name__}: {error}", host=name)
