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

NEWNS, NEWUTS, NEWIPC, NEWPID, NEWNET = 0x20000, 0x4000000, 0x8000000, 0x20000000, 0x40000000
PR_SET_PDEATHSIG = 1
LIBC = ctypes.CDLL(None, use_errno=True)
DEVICES = ("null", "zero", "full", "random", "urandom", "tty")


def unshare(flags: int) -> None:
    if LIBC.unshare(flags):
        raise OSError(ctypes.get_errno(), "unshare")


def mount(*words: str | Path) -> None:
    subprocess.run(["mount", *map(str, words)], check=True, stdin=subprocess.DEVNULL)


def make_disk(config: dict[str, str]) -> Path:
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
    for hidden in config["hidden"]:
        mount("-t", "tmpfs", "-o", "size=4k,mode=755", "hidden", root / hidden.lstrip("/"))
    return root


def make_user(root: Path, config: dict[str, str]) -> None:
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
    (root / "etc" / "ssh" / "edgectl-faults").mkdir()
    mount("--bind", config["ssh"], root / "etc" / "ssh" / "edgectl-faults")


def populate_root(root: Path, name: str) -> None:
    """Mount and create what a kernel and an init provide at boot."""
    mount("-t", "proc", "proc", root / "proc")
    mount("-t", "sysfs", "-o", "ro", "sysfs", root / "sys")
    mount("--rbind", "-o", "ro", "/sys/fs/cgroup", root / "sys/fs/cgroup")
    mount("-t", "tmpfs", "-o", "mode=755,size=1m", "dev", root / "dev")
    for device in DEVICES:
        (root / "dev" / device).touch()
        mount("--bind", f"/dev/{device}", root / "dev" / device)
    for link, target in (("fd", "/proc/self/fd"), ("stdin", "fd/0"), ("stdout", "fd/1"), ("stderr", "fd/2")):
        (root / "dev" / link).symlink_to(target)
    (root / "dev" / "shm").mkdir()
    for place in ("dev/shm", "tmp"):
        mount("-t", "tmpfs", "-o", "mode=1777,size=32m", "tmpfs", root / place)
    mount("-t", "tmpfs", "-o", "mode=755,size=4m", "run", root / "run")
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


def run_computer(root: Path, config: dict[str, str]) -> None:
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    console = os.open(f"{config['directory']}/console.log", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.dup2(console, 1)
    os.dup2(console, 2)
    populate_root(root, config["name"])
    os.chroot(root)
    os.chdir("/")
    run_sshd(config["sshd"])


def boot_computer(root: Path, config: dict[str, str]) -> tuple[int, int]:
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
