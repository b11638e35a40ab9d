# SPDX-License-Identifier: Apache-2.0
"""Outer process of an emulated computer: persistent disk and power switch.

Run as root: ``host_emulator.py CONFIG.json``, then one command per line on stdin (``on``, ``off``), one JSON
answer per line on stdout. End of input ends everything: the mounts are in this process's mount namespace, and
processes of the computer end with its PID 1. The disk is an overlay over the file system of the machine, with
a tmpfs of limited size for ``/home``. Each ``on`` creates fresh pid, network, mount, uts and ipc namespaces,
a fresh /run and /tmp, and a new boot id. Standard library only; no import after the fork, since the computer
does not see the files of the tests.
"""

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import time
import uuid
from pathlib import Path
from typing import Any

NEWNS, NEWUTS, NEWIPC, NEWPID, NEWNET = 0x20000, 0x4000000, 0x8000000, 0x20000000, 0x40000000
NEWCGROUP = 0x2000000
PR_SET_PDEATHSIG = 1
LIBC = ctypes.CDLL(None, use_errno=True)
DEVICES = ("null", "zero", "full", "random", "urandom", "tty")
SYSTEMD = "/lib/systemd/systemd"
# Units of the machine's own system that have no place on a computer without devices, clock and kernel.
MASKED = [
    "apparmor.service",
    "console-getty.service",
    "cryptsetup.target",
    "dev-hugepages.mount",
    "dev-mqueue.mount",
    "e2scrub_reap.service",
    "getty.target",
    "kmod-static-nodes.service",
    "proc-sys-fs-binfmt_misc.automount",
    "ssh.service",
    "ssh.socket",
    "swap.target",
    "sys-fs-fuse-connections.mount",
    "sys-kernel-config.mount",
    "sys-kernel-debug.mount",
    "sys-kernel-tracing.mount",
    "systemd-ask-password-console.path",
    "systemd-ask-password-wall.path",
    "systemd-binfmt.service",
    "systemd-firstboot.service",
    "systemd-hwdb-update.service",
    "systemd-machine-id-commit.service",
    "systemd-modules-load.service",
    "systemd-networkd.service",
    "systemd-networkd.socket",
    "systemd-pcrphase.service",
    "systemd-pcrphase-sysinit.service",
    "systemd-pstore.service",
    "systemd-random-seed.service",
    "systemd-remount-fs.service",
    "systemd-resolved.service",
    "systemd-sysctl.service",
    "systemd-sysusers.service",
    "systemd-timesyncd.service",
    "systemd-tmpfiles-setup-dev.service",
    "systemd-udev-trigger.service",
    "systemd-udevd-control.socket",
    "systemd-udevd-kernel.socket",
    "systemd-udevd.service",
    "timers.target",
]
SSHD_UNIT = """[Unit]
After=systemd-user-sessions.service
[Service]
ExecStart={sshd} -D -e -f /etc/ssh/edgectl-faults/sshd_config
KillMode=process
Restart=always
RestartSec=50ms
StartLimitBurst=1000
"""
TARGET_UNIT = """[Unit]
Requires=basic.target
Wants=edgectl-faults-sshd.service systemd-logind.service systemd-user-sessions.service dbus.socket
After=basic.target
AllowIsolate=yes
"""


def unshare(flags: int) -> None:
    if LIBC.unshare(flags):
        raise OSError(ctypes.get_errno(), "unshare")


def mount(*words: str | Path) -> None:
    subprocess.run(["mount", *map(str, words)], check=True, stdin=subprocess.DEVNULL)


def make_disk(config: dict[str, Any]) -> Path:
    """Mount the disk; return the computer's root directory."""
    base, root = Path(config["directory"]), Path(config["directory"]) / "root"
    (base / "disk").mkdir()
    root.mkdir()
    mount("-t", "tmpfs", "-o", "size=256m", "disk", base / "disk")
    (base / "disk" / "upper").mkdir()
    (base / "disk" / "work").mkdir()
    mount(
        "-t",
        "overlay",
        "-o",
        f"lowerdir=/,upperdir={base}/disk/upper,workdir={base}/disk/work",
        "overlay",
        root,
    )
    mount("-t", "tmpfs", "-o", f"size={config['home_size']},mode=755", "home", root / "home")
    for place, source in config["shared"].items():
        (root / place.lstrip("/")).mkdir(parents=True)
        mount("--bind", source, root / place.lstrip("/"))
    for hidden in config["hidden"]:
        mount("-t", "tmpfs", "-o", "size=4k,mode=755", "hidden", root / hidden.lstrip("/"))
    return root


def make_user(root: Path, config: dict[str, Any]) -> None:
    """Create an ordinary user with a home, an authorized key and the directory of the oracle."""
    user, home = config["user"], root / "home" / config["user"]
    for name, line in (
        ("passwd", f"{user}:x:4711:4711::/home/{user}:/bin/bash\n"),
        ("group", f"{user}:x:4711:\n"),
        ("shadow", f"{user}:*:1::::::\n"),
    ):
        path = root / "etc" / name
        path.write_text(path.read_text() + line)
    (home / "oracle").mkdir(parents=True)
    home.chmod(0o700)
    for each in (home, home / "oracle"):
        os.chown(each, 4711, 4711)
    mount("--bind", config["oracle"], home / "oracle")
    mount("-t", "tmpfs", "-o", "size=16m,mode=700", "hidden", root / "root")
    (root / "root" / "oracle").symlink_to(f"/home/{user}/oracle")
    (root / "etc" / "ssh" / "edgectl-faults").mkdir()
    mount("--bind", config["ssh"], root / "etc" / "ssh" / "edgectl-faults")


def install_systemd(root: Path, config: dict[str, Any]) -> None:
    """Install what systemd starts: sshd with PAM, logind, D-Bus, and the lingering user."""
    units = root / "etc/systemd/system"
    for name in MASKED:
        (units / name).unlink(missing_ok=True)
        (units / name).symlink_to("/dev/null")
    (units / "edgectl-faults-sshd.service").write_text(SSHD_UNIT.format(sshd=config["sshd"]))
    (units / "edgectl-faults.target").write_text(TARGET_UNIT)
    (root / "etc/fstab").write_text("")
    for link in ("etc/machine-id", "var/lib/dbus/machine-id"):
        (root / link).unlink(missing_ok=True)
    (root / "etc/machine-id").write_text(f"{uuid.uuid4().hex}\n")
    (root / "etc/pam.d/sshd").write_text(
        "account required pam_unix.so\nsession required pam_unix.so\nsession required pam_systemd.so\n"
    )
    (root / "var/lib/systemd/linger").mkdir(parents=True, exist_ok=True)
    (root / "var/lib/systemd/linger" / config["user"]).touch()


def mount_cgroups(root: Path, groups: list[str]) -> None:
    """Move into the control groups of this computer, and mount them as if there were no others.

    systemd mounts every further controller that /proc/cgroups lists, for the whole machine.
    """
    for group in groups:
        Path(group, "cgroup.procs").write_text("0\n")
    unshare(NEWCGROUP)
    top = root / "sys/fs/cgroup"
    if len(groups) == 1:
        mount("-t", "cgroup2", "cgroup2", top)
        return
    mount("-t", "tmpfs", "-o", "mode=755,size=1m", "cgroup", top)
    names = [Path(group).parent.name for group in groups]
    for name in names:
        (top / name).mkdir()
        kind, option = ("cgroup2", "rw") if name == "unified" else ("cgroup", name)
        mount("-t", kind, "-o", "none,name=systemd" if name == "systemd" else option, "cgroup", top / name)
    lines = Path("/proc/cgroups").read_text().splitlines(keepends=True)
    (root / "run" / "cgroups").write_text(
        "".join(line for line in lines if line.split()[0] in ("#subsys_name", *names))
    )
    mount("--bind", root / "run" / "cgroups", root / "proc/cgroups")


def run_systemd() -> None:
    """Become systemd, without what would change the machine itself."""
    environment = {
        "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "container": "edgectl-faults",
    }
    kept = "--bounding-set=-mknod,-sys_module,-sys_rawio,-sys_time,-syslog,-sys_boot"
    command = ["setpriv", kept, SYSTEMD, "--unit=edgectl-faults.target", "--show-status=no"]
    os.dup2(os.open("/dev/null", os.O_RDONLY), 0)
    os.execve("/usr/bin/setpriv", command, environment)


def populate_root(root: Path, name: str, groups: list[str], *, docker: bool = False) -> None:
    """Mount and create what a kernel and an init provide at boot. ``docker``: an engine makes control groups there."""
    mount("-t", "proc", "proc", root / "proc")
    mount("-t", "sysfs", "-o", "ro", "sysfs", root / "sys")
    mount("-t", "tmpfs", "-o", "mode=755,size=1m", "dev", root / "dev")
    for device in DEVICES:
        (root / "dev" / device).touch()
        mount("--bind", f"/dev/{device}", root / "dev" / device)
    for link, target in (("fd", "/proc/self/fd"), ("stdin", "fd/0"), ("stdout", "fd/1"), ("stderr", "fd/2")):
        (root / "dev" / link).symlink_to(target)
    (root / "dev" / "shm").mkdir()
    for place in ("dev/shm", "tmp"):
        mount("-t", "tmpfs", "-o", "mode=1777,size=32m", "tmpfs", root / place)
    if groups:
        (root / "dev" / "console").touch()
        mount("--bind", "/dev/null", root / "dev" / "console")
    mount("-t", "tmpfs", "-o", f"mode=755,size={'32m' if groups else '4m'}", "run", root / "run")
    if groups:
        mount_cgroups(root, groups)
        mount("--bind", root / "proc/sys", root / "proc/sys")
        mount("-o", "remount,bind,ro", root / "proc/sys")
        if (root / "proc/sysrq-trigger").exists():
            mount("--bind", "/dev/null", root / "proc/sysrq-trigger")
    else:
        mount("--rbind", *([] if docker else ["-o", "ro"]), "/sys/fs/cgroup", root / "sys/fs/cgroup")
    (root / "run" / "sshd").mkdir(mode=0o755)
    boot_id = root / "run" / "boot_id"
    boot_id.write_text(f"{uuid.uuid4()}\n")
    mount("--bind", boot_id, root / "proc/sys/kernel/random/boot_id")
    socket.sethostname(name)


def run_sshd(sshd: str) -> None:
    """Run sshd as PID 1: restart it when it ends, and reap orphans."""
    environment = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"}
    command = [sshd, "-D", "-e", "-f", "/etc/ssh/edgectl-faults/sshd_config"]
    while True:
        server = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL)
        while os.wait()[0] != server.pid:
            pass
        server.returncode = 0
        time.sleep(0.05)


def run_computer(root: Path, config: dict[str, Any]) -> None:
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    console = os.open(f"{config['directory']}/console.log", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.dup2(console, 1)
    os.dup2(console, 2)
    populate_root(root, config["name"], config["groups"], docker=config["docker"])
    os.chroot(root)
    os.chdir("/")
    if config["groups"]:
        run_systemd()
    run_sshd(config["sshd"])


def boot_computer(root: Path, config: dict[str, Any]) -> tuple[int, int]:
    """Boot; return the pid of PID 1 as seen by this machine, and the pid of its parent."""
    reader, writer = os.pipe()
    keeper = os.fork()
    if not keeper:
        try:
            LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
            for tasks in config["cgroups"]:
                Path(tasks).write_text(f"{os.getpid()}\n")
            unshare(NEWPID | NEWNS | NEWNET | NEWUTS | NEWIPC)
            if not (first := os.fork()):
                run_computer(root, config)
            os.write(writer, f"{first}\n".encode())
            os.waitpid(first, 0)
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as answer:
        return int(answer.readline()), keeper


def main(path: str) -> None:
    config = json.loads(Path(path).read_text())
    unshare(NEWNS)
    mount("--make-rprivate", "/")
    root = make_disk(config)
    make_user(root, config)
    if config["groups"]:
        install_systemd(root, config)
    print(json.dumps({"root": str(root)}), flush=True)
    first = keeper = 0
    for line in sys.stdin:
        if line.strip() == "on" and not first:
            first, keeper = boot_computer(root, config)
        elif line.strip() == "off" and first:
            os.kill(first, signal.SIGKILL)
            os.waitpid(keeper, 0)
            first = 0
        print(json.dumps({"pid": first}), flush=True)
    if first:
        os.kill(first, signal.SIGKILL)
        os.waitpid(keeper, 0)


if __name__ == "__main__":
    main(sys.argv[1])
