# SPDX-License-Identifier: Apache-2.0
"""Settings of systemd-logind that decide whether a task survives the end of the login.

``root`` is another tree in tests.
"""

import os

from ..link.errors import RefusalError
from .scope import get_user_name, is_lingering

_FOLDERS = ("/etc/systemd", "/run/systemd", "/usr/local/lib/systemd", "/usr/lib/systemd", "/lib/systemd")


def check_survives_logout(root: str = "") -> None:
    """Decline to start a task that the end of this login would kill. Raises RefusalError."""
    if os.geteuid() == 0 and not root:
        return
    user = get_user_name()
    if kills_users_processes(root) and not is_lingering(user, root):
        message = "this host kills the processes of %s at logout (KillUserProcesses=yes)" % user
        raise RefusalError(
            "killed-at-logout", message, "on the host, as root: loginctl enable-linger %s" % user
        )


def kills_users_processes(root: str = "") -> bool:
    """Whether the processes of a user are killed at logout; the default is no."""
    return read_setting("KillUserProcesses", False, root)


def removes_ipc(root: str = "") -> bool:
    """Whether a user's shared memory is removed with the last login; the default is yes.

    Never that of root and system users.
    """
    return read_setting("RemoveIPC", True, root)


def is_logind_present(root: str = "") -> bool:
    """Whether systemd and logind run here."""
    return os.path.isdir(root + "/run/systemd/system") and os.path.isdir(root + "/run/systemd/seats")


def read_setting(wanted: str, default: bool, root: str = "") -> bool:
    """Read the last value of a setting in logind.conf and its drop-ins."""
    value_set = default
    for path in _list_config_files(root):
        for line in _read_lines(path):
            name, _, value = line.partition("=")
            if name.strip() == wanted and value.strip():
                value_set = value.strip().lower() in ("yes", "true", "1", "on", "y", "t")
    return value_set


def _list_config_files(root: str) -> "list[str]":
    """List the effective logind.conf, then every drop-in by name.

    For one name /etc overrides /run, and /run overrides /usr.
    """
    mains = [root + folder + "/logind.conf" for folder in _FOLDERS]
    drop_ins: "dict[str, str]" = {}
    for folder in reversed(_FOLDERS):
        path = root + folder + "/logind.conf.d"
        names = os.listdir(path) if os.path.isdir(path) else []
        drop_ins.update((name, os.path.join(path, name)) for name in names if name.endswith(".conf"))
    return [path for path in mains if os.path.exists(path)][:1] + [
        drop_ins[name] for name in sorted(drop_ins)
    ]


def _read_lines(path: str) -> "list[str]":
    try:
        with open(path, "rb") as file:
            return file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return []
