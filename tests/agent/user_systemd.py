# SPDX-License-Identifier: Apache-2.0
"""A private systemd --user without a systemd as PID 1, in a mount namespace with its own /run and control groups.

Where the tests are not root, or systemd is not installed, a stub replaces systemd-run: it starts the command as ``--scope`` does
and leaves control groups alone.
"""

import itertools
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.pace import patience

MANAGER = Path("/lib/systemd/systemd")
CONTROLLERS = Path("/sys/fs/cgroup")
V1 = CONTROLLERS / "systemd" / "cgroup.procs"
_numbers = itertools.count(1)

# Moves itself into its own control groups first: a systemd --user takes over the whole group in which it is started.
_HOLD = """
set -e
PATH=$PATH:/usr/sbin:/sbin
for group in $GROUPS_; do echo $$ > $group/cgroup.procs; done
own=$(grep :name=systemd: /proc/self/cgroup || grep ^0:: /proc/self/cgroup || true)
case "$GROUPS_:$own" in
    :*) ;;
    *:/) echo "refused: still in the root group ($own)" >&2; exit 1;;
esac
exec unshare $UNSHARE --mount --propagation private sh -ec '
    mount -t tmpfs tmpfs /run
    mkdir -p /run/systemd/system /run/user/$UID_
    chmod 700 /run/user/$UID_
    mount -t tmpfs tmpfs /var/lib
    mkdir -p /var/lib/systemd/linger
    touch /var/lib/systemd/linger/$USER_
    mkdir -p /run/systemd/journal
    "$PYTHON" -c "$LISTEN" /run/systemd/journal/socket "$JOURNAL" &
    until [ -e /run/systemd/journal/socket ]; do sleep 0.05; done
    for hierarchy in $READ_ONLY; do mount -o bind $hierarchy $hierarchy; mount -o remount,bind,ro $hierarchy; done
    exec setpriv --pdeathsig KILL "$@"
' sh "$@"
"""
_SOCKET = "import os,socket,sys,time;s=socket.socket(socket.AF_UNIX);os.mkdir(sys.argv[1]);s.bind(sys.argv[1]+'/private');time.sleep(3600)"
# Replaces the journal: appends every message to a file. Ends with the process that started it.
_LISTEN = """
import ctypes, os, socket, sys
ctypes.CDLL(None).prctl(1, 9)
end = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
end.bind(sys.argv[1])
with open(sys.argv[2], 'ab', buffering=0) as journal:
    while os.getppid() > 1:
        journal.write(end.recv(1 << 20) + b'\\n')
"""
_FAKE = """#!/bin/sh
# Stub of systemd-run --user --scope: becomes the command, as the original does.
[ "$1" = --version ] && { echo "systemd 255 (a stand-in)"; exit 0; }
printf '%s\\n' "$@" > "$(dirname "$0")/argv"
[ -e "$(dirname "$0")/refuse" ] && { echo "Failed to start transient scope unit: no" >&2; exit 1; }
while [ "$1" != -- ]; do shift; done
shift
exec "$@"
"""


@dataclass(frozen=True)
class UserSystemd:
    """``python`` runs an interpreter in the namespace of this systemd; ``real`` is false for the stub, which writes its arguments to ``argv``."""

    python: Path
    real: bool
    pid: int
    folder: Path

    @property
    def argv(self) -> list[str]:
        return (self.folder / "argv").read_text().splitlines()

    def units(self) -> list[str]:
        """The task scopes known to systemd."""
        return self.systemctl("list-units", "--all", "--plain", "--no-legend", "edgectl-*").splitlines()

    def systemctl(self, *words: str) -> str:
        """Output of ``systemctl --user``."""
        inside = [
            "nsenter",
            f"--mount=/proc/{self.pid}/ns/mnt",
            "env",
            f"XDG_RUNTIME_DIR=/run/user/{os.geteuid()}",
        ]
        return subprocess.run(
            [*inside, "systemctl", "--user", *words],
            capture_output=True,
            text=True,
            check=True,
            timeout=patience(20),
        ).stdout

    @property
    def run(self) -> Path:
        """Its /run, which contains the transient units."""
        return Path(f"/proc/{self.pid}/root/run")


def can_be_real() -> bool:
    """Whether the tests are root and have the programs and writable control groups (v1, or v2 with controllers)."""
    if (
        os.geteuid()
        or not MANAGER.exists()
        or not shutil.which("systemd-run")
        or not os.access(CONTROLLERS, os.W_OK)
    ):
        return False
    given = CONTROLLERS / "cgroup.subtree_control"
    return {"cpu", "memory"} <= set(given.read_text().split()) if given.exists() else V1.exists()


@contextmanager
def user_systemd(folder: Path, *, real: bool, read_only: tuple[str, ...] = ()) -> Iterator[UserSystemd]:
    """Run a systemd; ``read_only``: controllers that it may not write, as on hosts where they are not delegated to users."""
    folder.mkdir()
    groups = _groups(f"edgectl-test-{os.getpid()}-{next(_numbers)}") if real else []
    uid = 0 if os.geteuid() == 0 or not real else os.geteuid()
    listener = f"/run/user/{uid}/systemd"
    command = [str(MANAGER), "--user"] if real else [sys.executable, "-c", _SOCKET, listener]
    env = {
        "PATH": os.environ["PATH"], "HOME": str(folder), "XDG_RUNTIME_DIR": f"/run/user/{uid}", "UID_": str(uid), "USER_": "root",
        "GROUPS_": " ".join(map(str, groups)), "READ_ONLY": " ".join(str(CONTROLLERS / name) for name in read_only),
        "SYSTEMD_LOG_TARGET": "journal", "PYTHON": sys.executable, "LISTEN": _LISTEN, "JOURNAL": str(folder / "journal"), "UNSHARE": "" if os.geteuid() == 0 else "--user --map-root-user",
    }  # fmt: skip
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            ["sh", "-c", _HOLD, "sh", *command], stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=env
        )
    try:
        _wait_for(lambda: Path(f"/proc/{process.pid}/root{listener}/private").exists(), (folder / "log"))
        yield UserSystemd(_wrapper(folder, process.pid, uid, fake=not real), real, process.pid, folder)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait(patience(60))
        for group in groups:
            _remove(group)


def _groups(name: str) -> list[Path]:
    """Create a group of that name in each hierarchy."""
    hierarchies = (
        [path for path in sorted(CONTROLLERS.iterdir()) if (path / "cgroup.procs").exists()]
        if V1.exists()
        else [CONTROLLERS]
    )
    groups = [hierarchy / name for hierarchy in hierarchies]
    for group in groups:
        group.mkdir()
        for setting in ("cpuset.cpus", "cpuset.mems"):
            if (group / setting).exists():
                (group / setting).write_text((group.parent / setting).read_text())
    return groups


def _wrapper(folder: Path, pid: int, uid: int, *, fake: bool) -> Path:
    """Write an interpreter that enters the namespace, without XDG_RUNTIME_DIR, as after a login without PAM."""
    if fake:
        (folder / "systemd-run").write_text(_FAKE)
        (folder / "systemd-run").chmod(0o755)
    spaces = f"--target={pid} --mount" + ("" if os.geteuid() == 0 else " --user --preserve-credentials")
    path = f"{folder}:$PATH" if fake else "$PATH"
    wrapper = folder / "python3"
    wrapper.write_text(
        f'#!/bin/sh\nexec nsenter {spaces} --wd=/ env -u XDG_RUNTIME_DIR PATH="{path}" {sys.executable} "$@"\n'
    )
    wrapper.chmod(0o755)
    assert uid == 0 or fake
    return wrapper


def _wait_for(found: object, log: Path) -> None:
    deadline = time.monotonic() + patience(60)
    while not found():  # type: ignore[operator]
        assert time.monotonic() < deadline, log.read_text()[-2000:]
        time.sleep(0.05)


def _remove(group: Path) -> None:
    """Kill the remaining processes of a test group and remove it."""
    for _ in range(50):
        for inner in sorted(group.rglob("cgroup.procs"), reverse=True):
            with suppress(OSError):
                for pid in inner.read_text().split():
                    os.kill(int(pid), signal.SIGKILL)
        for folder in sorted((path for path in group.rglob("*") if path.is_dir()), reverse=True):
            with suppress(OSError):
                folder.rmdir()
        with suppress(OSError):
            group.rmdir()
        if not group.exists():
            return
        time.sleep(0.1)
    raise AssertionError(f"{group} cannot be removed")
