# SPDX-License-Identifier: Apache-2.0
"""Two computers of network namespaces with a cable between them: an edge and a robot on this machine.

Each is a process with a network and mounts of its own: a /sys of its network, and an /etc into which the tests may
write. Nothing of it is left after its last process.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.faults.hosts import wait_for
from tests.faults.network import run_ip

USER_ID = 4711
_PREPARE = """
set -e
mkdir -p "$FOLDER/upper" "$FOLDER/work" "$FOLDER/groups"
mount -t tmpfs tmpfs "$FOLDER"
mkdir -p "$FOLDER/upper" "$FOLDER/work" "$FOLDER/groups"
mount -t overlay overlay -o "lowerdir=/etc,upperdir=$FOLDER/upper,workdir=$FOLDER/work" /etc
mount --rbind /sys/fs/cgroup "$FOLDER/groups"
mount -t sysfs sysfs /sys
mount --rbind "$FOLDER/groups" /sys/fs/cgroup
mount -t tmpfs tmpfs /dev/shm
echo "edge:x:4711:4711::/tmp:/bin/sh" >> /etc/passwd
echo "edge:*:19000::::::" >> /etc/shadow
"""


def find_missing_for_counters() -> str:
    """Return why counters cannot be tried here; empty if they can."""
    if os.geteuid() != 0:
        return "needs root"
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    names = ("unshare", "nsenter", "ip", "setpriv", "nft", "sudo", "visudo")
    if lacking := [name for name in names if not shutil.which(name, path=path)]:
        return f"needs {', '.join(lacking)}"
    table = "add table inet edgectl_try"
    probe = subprocess.run(
        ["unshare", "--net", "/usr/sbin/nft", table], capture_output=True, text=True, check=False
    )
    return f"no nf_tables here: {probe.stderr.strip()}" if probe.returncode else ""


@dataclass(frozen=True)
class NetworkHost:
    """``pid``: the process whose namespaces it is; ``mounts``: that of its mounts; ``folder``: for its files."""

    name: str
    address: str
    pid: int
    mounts: int
    folder: Path

    def enter(self, *command: str, user: bool = False) -> list[str]:
        """Build the command line that runs ``command`` there; ``user``: without root's rights."""
        who = ["setpriv", f"--reuid={USER_ID}", f"--regid={USER_ID}", "--clear-groups"] if user else []
        spaces = [f"--mount=/proc/{self.mounts}/ns/mnt", f"--net=/proc/{self.pid}/ns/net"]
        return ["nsenter", *spaces, *who, *command]

    def run(self, *command: str) -> str:
        """Run ``command`` as root; its output."""
        done = subprocess.run(self.enter(*command), capture_output=True, text=True, check=False)
        assert not done.returncode, f"{' '.join(command)}: {done.stderr}{done.stdout}"
        return done.stdout

    def write_python(self, *, user: bool = False, python: str = sys.executable) -> str:
        """Write a program that runs Python there, and return its path."""
        words = " ".join(self.enter("/usr/bin/python3" if user else python, user=user))
        path = self.folder / f"python-{self.name}-{user}"
        path.write_text(f'#!/bin/sh\nexec {words} "$@"\n')
        path.chmod(0o755)
        return str(path)

    def read_interface(self, name: str = "eth0") -> tuple[int, int]:
        """Read the bytes that the interface has received and sent."""
        kinds = ("rx", "tx")
        text = self.run("cat", *(f"/sys/class/net/{name}/statistics/{kind}_bytes" for kind in kinds))
        received, sent = (int(line) for line in text.split())
        return received, sent


@contextmanager
def pair_of_hosts(folder: Path, *, mounts_of: int = 0) -> Iterator[tuple[NetworkHost, NetworkHost]]:
    """Make an edge and a robot; ``mounts_of``: the edge gets the mounts of this process."""
    folder.mkdir(mode=0o755)
    with ExitStack() as stack:
        edge = stack.enter_context(_make_host(folder, "edge1", "10.233.0.1", mounts_of))
        robot = stack.enter_context(_make_host(folder, "robot1", "10.233.0.2", 0))
        run_ip(*f"link add eth0 type veth peer name eth0 netns {robot.pid}".split(), netns=edge.pid)
        for host in (edge, robot):
            words = ("link set lo up", f"addr add {host.address}/24 dev eth0", "link set eth0 up")
            for each in (*words, "link set eth0 multicast on", "route add default dev eth0"):
                run_ip(*each.split(), netns=host.pid)
        yield edge, robot


@contextmanager
def _make_host(folder: Path, name: str, address: str, mounts_of: int) -> Iterator[NetworkHost]:
    process = subprocess.Popen(
        ["unshare", "--net", "--mount", "--propagation", "private", "cat"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    assert process.stdin is not None
    try:
        own = os.readlink("/proc/self/ns/mnt")  # noqa: PTH115 - of a link that leads nowhere
        wait_for(lambda: os.readlink(f"/proc/{process.pid}/ns/mnt") != own, "namespaces")  # noqa: PTH115
        host = NetworkHost(name, address, process.pid, mounts_of or process.pid, folder)
        (folder / name).mkdir()
        host.run("env", f"FOLDER={folder / name}", "sh", "-c", _PREPARE)
        yield host
    finally:
        process.stdin.close()
        process.wait(60)
