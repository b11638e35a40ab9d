# SPDX-License-Identifier: Apache-2.0
"""Command lines of the user's own ``ssh`` for work by hand: ``edgectl ssh`` and ``edgectl exec``.

They have the login, the jump hosts and the checked host keys of the inventory, but may ask for a password.
"""

import base64
import json
import shlex
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path

from edgectl.model.inventory import Connection, Host
from edgectl.transport import enter_program
from edgectl.transport.agent_archive import read_program
from edgectl.transport.openssh import OpenSshTransport

# Unpacks the program and runs it. No character of it, or of its arguments, means anything to any login shell.
_BOOT = "import sys,zlib,base64;exec(zlib.decompress(base64.b64decode(sys.argv.pop(1))))"


def build_login_command(host: Host, words: Sequence[str] = (), *, tty: bool = False) -> list[str]:
    """The ``ssh`` that logs in to ``host``, or runs ``words`` there as ssh does: joined, by its shell.

    On this machine: the shell of the account, or the words themselves. ``tty``: with a terminal.

    Raises:
        ConnectError: there is no ssh program, or no host name.
    """
    if host.connection is Connection.LOCAL:
        return ["/bin/sh", "-c", " ".join(words)] if words else ["/bin/sh", "-i"]
    return [*OpenSshTransport().build_manual_command(host, tty=tty or not words), *words]


def build_enter_command(
    host: Host, task: str, pid: int, argv: Sequence[str], *, tty: bool = False
) -> list[str]:
    """The command that runs ``argv`` on ``host`` beside process ``pid`` of ``task``. No shell sees ``argv``.

    Raises:
        ConnectError: there is no ssh program, or no host name.
    """
    asked = json.dumps({"task": task, "pid": pid, "argv": list(argv)}).encode()
    program = zlib.compress(read_program(Path(enter_program.__file__)), 9)
    python = [
        sys.executable if host.connection is Connection.LOCAL else "python3",
        "-I",
        "-S",
        "-c",
        _BOOT,
        base64.b64encode(program).decode(),
        base64.b64encode(asked).decode(),
    ]
    if host.connection is Connection.LOCAL:
        return python
    return [*OpenSshTransport().build_manual_command(host, tty=tty), f"exec {shlex.join(python)}"]


def build_container_command(
    host: Host, engine: str, container: str, argv: Sequence[str], *, tty: bool = False
) -> list[str]:
    """The command that runs ``argv`` in a container on ``host``, by ``engine``. No shell sees ``argv``.

    Raises:
        ConnectError: there is no ssh program, or no host name.
    """
    words = [engine, "exec", "--interactive", *(["--tty"] if tty else []), container, *argv]
    if host.connection is Connection.LOCAL:
        return words
    return [*OpenSshTransport().build_manual_command(host, tty=tty), f"exec {shlex.join(words)}"]
