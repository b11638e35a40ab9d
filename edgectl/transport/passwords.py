# SPDX-License-Identifier: Apache-2.0
"""Passwords of hosts that accept no key: from ``password_command`` or a prompt, once per run."""

import subprocess
import threading
from collections.abc import Callable

from edgectl.errors import AuthError
from edgectl.model.inventory import Host

PASSWORD_COMMAND_TIMEOUT_S = 30.0


class PasswordStore:
    """Passwords by host, one prompt at a time. Safe to use from several threads."""

    def __init__(self, ask: Callable[[str], str] | None = None) -> None:
        """``ask`` takes a prompt and returns the input; None where no prompt is possible."""
        self._ask = ask
        self._known: dict[str, str | None] = {}
        self._lock = threading.Lock()

    def get(self, host: Host, login: str) -> str | None:
        """The password for ``host``, None if there is none. ``login`` ("me@edge1"): for the prompt.

        Raises:
            AuthError: ``password_command`` fails.
        """
        with self._lock:
            if host.name not in self._known:
                self._known[host.name] = self._obtain(host, login)
            return self._known[host.name]

    def reject(self, host: Host) -> None:
        """Forget a password that the host refused; none is offered to it again."""
        with self._lock:
            self._known[host.name] = None

    def _obtain(self, host: Host, login: str) -> str | None:
        if host.password_command:
            return run_password_command(host)
        return self._ask(f"{login}'s password: ") if self._ask is not None else None


def run_password_command(host: Host) -> str:
    """First line that ``password_command`` prints.

    Raises:
        AuthError: it fails, prints nothing or does not end.
    """
    return run_password_program(host.password_command, host.name)


def run_password_program(command: tuple[str, ...], host: str = "") -> str:
    """First line that ``command`` prints; ``host`` is named by the error.

    Raises:
        AuthError: it fails, prints nothing or does not end.
    """
    try:
        ran = subprocess.run(
            list(command),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=PASSWORD_COMMAND_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise AuthError(
            f"password_command failed: {type(error).__name__}", hint="run it by hand", host=host
        ) from error
    lines = ran.stdout.decode(errors="replace").splitlines()
    if ran.returncode != 0 or not lines:
        raise AuthError(
            f"password_command printed no password (exit code {ran.returncode})",
            hint="run it by hand",
            host=host,
        )
    return lines[0]
