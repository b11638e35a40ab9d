# SPDX-License-Identifier: Apache-2.0
"""Systemd scopes (``runtime: systemd``): the same supervisor in a scope of the user's systemd, which provides
a control group with limits.

A scope and not a service: systemd-run creates it around itself and then becomes the command, so descriptors,
environment and session are inherited, and nothing of the task is written into a unit. Lingering is never
enabled from here. ``root`` is for tests.
"""

import os
import stat

from ..link.errors import RefusalError
from ..link.fast_json import Document

_HINT = "use runtime: auto or process"


class Scope:
    """Way into a scope: ``argv`` before the command and ``env``.

    Without a scope ``argv`` is empty and ``why`` is the reason.
    """

    __slots__ = ("argv", "env", "why")

    def __init__(self, argv: "list[str]", env: "dict[str, str]", why: str) -> None:
        self.argv, self.env, self.why = argv, env, why


def choose_scope(runtime: str, host: str, task: str, limits: "Document | None", root: str = "") -> Scope:
    """Choose the scope of a task, or none with the reason.

    Raises RefusalError where the spec requires systemd and it is not possible.
    """
    if runtime == "process":
        return Scope([], {}, "runtime process sets no control group")
    why, hint = find_obstacle(root)
    if why and runtime == "systemd":
        raise RefusalError("no-systemd", "runtime systemd is not available: " + why, hint)
    if why:
        return Scope([], {}, why)
    env = dict(os.environ, XDG_RUNTIME_DIR=find_runtime_dir(root))
    return Scope(_build_scope_argv(host, task, build_properties(limits)), env, "")


def find_obstacle(root: str = "") -> "tuple[str, str]":
    """Find (the obstacle to keeping a task in systemd, its remedy); empty where there is none."""
    user = get_user_name()
    if not find_systemd_run():
        return "systemd-run is not installed", _HINT
    if not find_runtime_dir(root):
        return "no systemd --user is running for %s" % user, "see: systemctl status user@%d; or %s" % (
            os.geteuid(),
            _HINT,
        )
    if not is_lingering(user, root):
        return "lingering is off for %s" % user, "on the host, as root: loginctl enable-linger %s; or %s" % (
            user,
            _HINT,
        )
    return "", ""


def get_user_name() -> str:
    """Name of this user; the uid where it has no name."""
    import pwd

    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def is_lingering(user: str, root: str = "") -> bool:
    """Whether the user's systemd survives the end of the last login."""
    return os.path.exists("%s/var/lib/systemd/linger/%s" % (root, user))


def find_systemd_run() -> str:
    """Find the path of systemd-run; empty where there is none."""
    folders = os.environ.get("PATH", "").split(":") + ["/usr/bin", "/bin"]
    paths = [os.path.join(folder, "systemd-run") for folder in folders if folder.startswith("/")]
    return next((path for path in paths if os.access(path, os.X_OK)), "")


def find_runtime_dir(root: str = "") -> str:
    """Find XDG_RUNTIME_DIR where systemd --user listens in it, else empty.

    A login without PAM does not set the variable.
    """
    for folder in (os.environ.get("XDG_RUNTIME_DIR", ""), "%s/run/user/%d" % (root, os.geteuid())):
        try:
            info = os.stat(folder + "/systemd/private")
        except OSError:
            continue
        if folder and stat.S_ISSOCK(info.st_mode) and info.st_uid == os.geteuid():
            return folder
    return ""


def build_properties(limits: "Document | None") -> "dict[str, str]":
    """Build the settings of the unit: CPU in whole percent of a core (accepted by every systemd), memory in
    bytes.
    """
    found = {}
    cpu, memory = (limits or {}).get("cpu"), (limits or {}).get("memory")
    if cpu:
        found["CPUQuota"] = "%d%%" % compute_cpu_percent(cpu)
    if memory:
        found["MemoryMax"] = "%d" % int(memory)
    return found


def compute_cpu_percent(cores: float) -> int:
    """Compute ``cores`` in percent, rounded up."""
    return max(1, -int(-round(float(cores) * 100, 6) // 1))


def _build_scope_argv(host: str, task: str, settings: "dict[str, str]") -> "list[str]":
    """Build the argument vector of systemd-run.

    Names are checked and numbers formatted: it contains no text of the user.
    """
    argv = [
        find_systemd_run(),
        "--user",
        # Not --quiet: it would not say why the scope could not be started.
        "--scope",
        "--collect",
        "--unit=edgectl-%s-%s-%s" % (host, task, os.urandom(4).hex()),
    ]
    if "MemoryMax" in settings and read_systemd_version(argv[0]) >= 253:
        # Otherwise systemd ends the whole scope, supervisor and log included, when one process is killed for
        # its memory.
        settings = dict(settings, OOMPolicy="continue")
    for name, value in sorted(settings.items()):
        argv += ["-p", "%s=%s" % (name, value)]
    return argv + ["--"]


def read_systemd_version(systemd_run: str) -> int:
    """Read the number in ``systemd 252 (252.38-1)``; 0 where it cannot be read."""
    import subprocess

    try:
        words = subprocess.check_output(
            [systemd_run, "--version"], timeout=10, stderr=subprocess.DEVNULL
        ).split()
        return int(words[1])
    except (OSError, subprocess.SubprocessError, ValueError, IndexError):
        return 0


def describe_limits(limits: "Document | None", why: str, root: str = "") -> str:
    """Describe the state of the limits, read from our own control group: ``enforced``, ``not enforced: why``,
    or empty without limits.
    """
    stated = {name: value for name, value in (limits or {}).items() if value}
    if not stated:
        return ""
    if why:
        return "not enforced: " + why
    from ..measure import cgroup

    allowed = {
        "cpu": compute_cpu_percent(stated.get("cpu") or 0) / 100.0,
        "memory": int(stated.get("memory") or 0),
    }
    found = {"cpu": cgroup.find_cpu_limit(root), "memory": cgroup.find_memory_limit(root)}
    missing = []
    for name in sorted(stated):
        limit = found[name]
        if limit is None or limit.value > allowed[name] + 1e-9:
            missing.append(name)
    if not missing:
        return "enforced"
    reason = "accepted by systemd, but missing in the control group"
    return "not enforced: %s: %s%s" % (
        " and ".join(missing),
        reason,
        "" if cgroup.is_v2(root) else " (control groups v1)",
    )
