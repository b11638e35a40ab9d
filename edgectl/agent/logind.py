"""Whether a task would survive the end of the login: systemd may be told to kill what users leave behind. ``root`` is for tests."""

import os

from .errors import RefusalError


def check_survival(root: str = "") -> None:
    """Refuse to start what the end of this login would kill. Raises RefusalError."""
    if os.geteuid() == 0 and not root:
        return
    import pwd

    user = pwd.getpwuid(os.geteuid()).pw_name
    if kills_users_processes(root) and not os.path.exists("%s/var/lib/systemd/linger/%s" % (root, user)):
        message = "this host kills what %s leaves behind at logout (KillUserProcesses=yes)" % user
        raise RefusalError("killed-at-logout", message, "on the host, as root: loginctl enable-linger %s" % user)


def kills_users_processes(root: str = "") -> bool:
    """What logind.conf and its drop-ins say last; the default is no."""
    folder = root + "/etc/systemd/logind.conf"
    drop_ins = sorted(os.listdir(folder + ".d")) if os.path.isdir(folder + ".d") else []
    said = False
    for path in [folder] + ["%s.d/%s" % (folder, name) for name in drop_ins if name.endswith(".conf")]:
        for line in _lines(path):
            name, _, value = line.partition("=")
            if name.strip() == "KillUserProcesses":
                said = value.strip().lower() in ("yes", "true", "1", "on")
    return said


def _lines(path: str) -> list:
    try:
        with open(path, "rb") as file:
            return file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return []
