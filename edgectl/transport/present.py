"""What the ways over SSH need on this machine: files of host keys that can be read, and an ssh program."""

import shutil
from pathlib import Path

from edgectl.errors import HostError
from edgectl.model.inventory import Host
from edgectl.transport.sshconfig import Resolver


def known_hosts(host: Host) -> dict[str, str]:
    """The user's known_hosts files for ``host`` that exist, each with the reason why it cannot be read; empty where it can."""
    try:
        files = Resolver().resolve(host).known_hosts
    except HostError:
        return {}
    return {str(path): _obstacle(path) for path in files if path.exists()}


def _obstacle(path: Path) -> str:
    try:
        path.read_bytes()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def has_ssh() -> bool:
    """Whether there is an ssh program."""
    return shutil.which("ssh") is not None
