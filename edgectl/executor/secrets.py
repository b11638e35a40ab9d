# SPDX-License-Identifier: Apache-2.0
"""The environment of a start with its secrets in clear, made right before its request and never stored."""

import re
import subprocess
from collections.abc import Mapping

from edgectl.errors import HostError
from edgectl.model.inventory import Host
from edgectl.model.task import Task
from edgectl.rules.environment import merge_environment, reveal_secrets

ENV_COMMAND_TIMEOUT_S = 10.0
_VARIABLE_LINE = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)=(.*)")


def resolve_environment(task: Task, host: Host, hosts: Mapping[str, Host]) -> dict[str, str]:
    """Variables of ``task`` on ``host``, with the output of both ``env_command``; run here, without a shell.

    Raises:
        HostError: one of them failed; the message holds nothing of what it printed.
    """
    of_host = run_env_command(host.env_command, f"host {host.name}") if host.env_command else {}
    of_task = run_env_command(task.env_command, f"task {task.name}") if task.env_command else {}
    return reveal_secrets(merge_environment(task, host, hosts, host_more=of_host, task_more=of_task))


def run_env_command(command: tuple[str, ...], whose: str) -> dict[str, str]:
    """The lines NAME=value that a command prints; blank lines and comments (``#``) are ignored.

    Raises:
        HostError: it cannot be run, fails, takes longer than ``ENV_COMMAND_TIMEOUT_S`` or prints something
            else.
    """
    try:
        ran = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=ENV_COMMAND_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        raise _build_env_command_error(whose, f"did not end within {ENV_COMMAND_TIMEOUT_S:g} s") from None
    except OSError as error:
        raise _build_env_command_error(whose, f"cannot be run: {error.strerror}") from None
    if ran.returncode != 0:
        raise _build_env_command_error(whose, f"failed with exit code {ran.returncode}")
    return _parse_variables(ran.stdout, whose)


def _parse_variables(output: bytes, whose: str) -> dict[str, str]:
    found = {}
    for number, line in enumerate(output.decode(errors="replace").split("\n"), 1):
        if not line.strip() or line.startswith("#"):
            continue
        match = _VARIABLE_LINE.fullmatch(line.removesuffix("\r"))
        if match is None or "\0" in line or "\ufffd" in line:
            raise _build_env_command_error(whose, f"printed a line {number} that is not NAME=value")
        found[match[1]] = match[2]
    return found


def _build_env_command_error(whose: str, why: str) -> HostError:
    return HostError(
        f"env_command of {whose} {why}", hint="run it by hand; it must print lines NAME=value and exit with 0"
    )
