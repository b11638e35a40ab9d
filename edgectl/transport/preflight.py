# SPDX-License-Identifier: Apache-2.0
"""Requirements of SSH on this machine: readable known_hosts files and an ssh program."""

import shutil
from pathlib import Path

from edgectl.errors import HostError
from edgectl.model.inventory import Host
from edgectl.transport.ssh_config import SshConfigResolver


def list_known_hosts_files(host: Host) -> dict[str, str]:
    """The existing known_hosts files for ``host``, each with the error on reading it, empty if readable."""
    try:
        files = SshConfigResolver().resolve(host).known_hosts
    except HostError:
        return {}
    return {str(path): _explain_read_failure(path) for path in files if path.exists()}


def _explain_read_failure(path: Path) -> str:
    try:
        path.read_bytes()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def has_ssh_program() -> bool:
    """Whether there is an ssh program."""
    return shutil.which("ssh") is not None
