"""Whether a task would survive the end of the login: systemd may be told to kill what users leave behind. ``root`` is for tests."""

import os

from .errors import RefusalError

_FOLDERS = ("/etc/systemd", "/run/systemd", "/usr/local/lib/systemd", "/usr/lib/systemd", "/lib/systemd")


def check_survival(root: str = "") -> None:
    """Refuse to start what the end of this login would kill. Raises RefusalError."""
    if os.geteuid() == 0 and not root:
        return
    import pwd

    user = pwd.getpwuid(os.geteuid()).pw_name
    if kills_users_processes(root) and not os.path.exists("%s/var/lib/systemd/linger/%s" % (root, user)):
        message = "this host kills what %s leaves behind at logout (KillUserProcesses=yes)" % user
        raise RefusalError(
            "killed-at-logout", message, "on the host, as root: loginctl enable-linger %s" % user
        )


def kills_users_processes(root: str = "") -> bool:
    """Whether what a user leaves running is killed; the default is no."""
    return setting("KillUserProcesses", False, root)


def removes_ipc(root: str = "") -> bool:
    """Whether a user's shared memory is removed with the last login; the default is yes. Never that of root and system users."""
    return setting("RemoveIPC", True, root)


def is_present(root: str = "") -> bool:
    """Whether systemd runs here, and logind with it."""
    return os.path.isdir(root + "/run/systemd/system") and os.path.isdir(root + "/run/systemd/seats")


def setting(wanted: str, default: bool, root: str = "") -> bool:
    """What logind.conf and its drop-ins say last."""
    said = default
    for path in _files(root):
        for line in _lines(path):
            name, _, value = line.partition("=")
            if name.strip() == wanted and value.strip():
                said = value.strip().lower() in ("yes", "true", "1", "on", "y", "t")
    return said


def _files(root: str) -> list:
    """The one logind.conf that counts, then every drop-in by name; of the same name /etc counts before /run before /usr."""
    mains = [root + folder + "/logind.conf" for folder in _FOLDERS]
    drop_ins = {}
    for folder in reversed(_FOLDERS):
        path = root + folder + "/logind.conf.d"
        names = os.listdir(path) if os.path.isdir(path) else []
        drop_ins.update((name, os.path.join(path, name)) for name in names if name.endswith(".conf"))
    return [path for path in mains if os.path.exists(path)][:1] + [
        drop_ins[name] for name in sorted(drop_ins)
    ]


def _lines(path: str) -> list:
    try:
        with open(path, "rb") as file:
            return file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return []
