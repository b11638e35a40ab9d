"""``runtime: systemd``: the same supervisor in a scope of the user's own systemd, which gives the task a control group with limits.

A scope and not a service: systemd-run makes it around itself and then becomes the command, so descriptors, environment and session
stay ours, and nothing of the task has to be written into a unit. Lingering is never turned on from here. ``root`` is for tests.
"""

import os
import stat

from .errors import RefusalError

_HINTS = "use runtime: auto or process"


class Scope:
    """How to get into a scope: ``argv`` before the command and ``env``; where ``argv`` is empty ``why`` says why there is none."""

    __slots__ = ("argv", "env", "why")

    def __init__(self, argv: list, env: dict, why: str) -> None:
        self.argv, self.env, self.why = argv, env, why


def chosen(runtime: str, host: str, task: str, limits, root: str = "") -> Scope:
    """The scope for a task, or why it gets none. Raises RefusalError where the spec insists on systemd and there is no way."""
    if runtime == "process":
        return Scope([], {}, "runtime process sets no control group")
    why, hint = obstacle(root)
    if why and runtime == "systemd":
        raise RefusalError("no-systemd", "runtime systemd is not possible here: " + why, hint)
    if why:
        return Scope([], {}, why)
    env = dict(os.environ, XDG_RUNTIME_DIR=runtime_dir(root))
    return Scope(_argv(host, task, properties(limits)), env, "")


def obstacle(root: str = "") -> tuple:
    """(why systemd cannot keep a task here, what mends it); empty where it can."""
    user = user_name()
    if not program():
        return "there is no systemd-run", _HINTS
    if not runtime_dir(root):
        return "no systemd --user runs for %s" % user, "look at: systemctl status user@%d; or %s" % (
            os.geteuid(),
            _HINTS,
        )
    if not lingers(user, root):
        return "lingering is off for %s" % user, "on the host, as root: loginctl enable-linger %s; or %s" % (
            user,
            _HINTS,
        )
    return "", ""


def user_name() -> str:
    """The account that we run as; its number where it has no name."""
    import pwd

    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def lingers(user: str, root: str = "") -> bool:
    """Whether the user's systemd stays when the last login ends."""
    return os.path.exists("%s/var/lib/systemd/linger/%s" % (root, user))


def program() -> str:
    """The path of systemd-run, or empty."""
    folders = os.environ.get("PATH", "").split(":") + ["/usr/bin", "/bin"]
    paths = [os.path.join(folder, "systemd-run") for folder in folders if folder.startswith("/")]
    return next((path for path in paths if os.access(path, os.X_OK)), "")


def runtime_dir(root: str = "") -> str:
    """XDG_RUNTIME_DIR where our systemd --user listens in it, or empty. A login without PAM does not get the variable."""
    for folder in (os.environ.get("XDG_RUNTIME_DIR", ""), "%s/run/user/%d" % (root, os.geteuid())):
        try:
            info = os.stat(folder + "/systemd/private")
        except OSError:
            continue
        if folder and stat.S_ISSOCK(info.st_mode) and info.st_uid == os.geteuid():
            return folder
    return ""


def properties(limits) -> dict:
    """The unit's settings: CPU in whole percent of a core (what every systemd takes), memory in bytes."""
    found = {}
    cpu, memory = (limits or {}).get("cpu"), (limits or {}).get("memory")
    if cpu:
        found["CPUQuota"] = "%d%%" % cpu_percent(cpu)
    if memory:
        found["MemoryMax"] = "%d" % int(memory)
    return found


def cpu_percent(cores: float) -> int:
    """``cores`` in percent, rounded up."""
    return max(1, -int(-round(float(cores) * 100, 6) // 1))


def _argv(host: str, task: str, settings: dict) -> list:
    """Names are checked and numbers are numbers: nothing in here is the user's own text."""
    argv = [
        program(),
        "--user",
        "--scope",
        "--quiet",
        "--collect",
        "--unit=edgectl-%s-%s-%s" % (host, task, os.urandom(4).hex()),
    ]
    if "MemoryMax" in settings and version(argv[0]) >= 253:
        # Else systemd would end the whole scope, supervisor and log included, when one process is killed for its memory.
        settings = dict(settings, OOMPolicy="continue")
    for name, value in sorted(settings.items()):
        argv += ["-p", "%s=%s" % (name, value)]
    return argv + ["--"]


def version(systemd_run: str) -> int:
    """The number in ``systemd 252 (252.38-1)``; 0 where it says something else."""
    import subprocess

    try:
        words = subprocess.check_output(
            [systemd_run, "--version"], timeout=10, stderr=subprocess.DEVNULL
        ).split()
        return int(words[1])
    except (OSError, subprocess.SubprocessError, ValueError, IndexError):
        return 0


def verdict(limits, why: str, root: str = "") -> str:
    """What became of the stated limits, read back from our own control group: ``enforced``, ``not enforced: why``, or empty."""
    stated = {name: value for name, value in (limits or {}).items() if value}
    if not stated:
        return ""
    if why:
        return "not enforced: " + why
    from . import cgroup

    allowed = {"cpu": cpu_percent(stated.get("cpu") or 0) / 100.0, "memory": int(stated.get("memory") or 0)}
    found = {"cpu": cgroup.cpu_limit(root), "memory": cgroup.memory_limit(root)}
    missing = [
        name for name in sorted(stated) if found[name] is None or found[name].value > allowed[name] + 1e-9
    ]
    if not missing:
        return "enforced"
    reason = "systemd accepted it, but the control group does not have it"
    return "not enforced: %s: %s%s" % (
        " and ".join(missing),
        reason,
        "" if cgroup.is_v2(root) else " (control groups v1)",
    )
