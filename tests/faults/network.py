# SPDX-License-Identifier: Apache-2.0
"""Network of the manager and the emulated computers; needs root."""

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tests import sshd
from tests.faults.hosts import wait_for


def run_ip(*words: str, netns: int = 0) -> None:
    """Run ip(8), in the network namespace of process ``netns``."""
    prefix = ["nsenter", f"--target={netns}", "--net"] if netns else []
    done = subprocess.run(
        [*prefix, sshd.find_program("ip"), *words], capture_output=True, text=True, check=False
    )
    assert not done.returncode, f"ip {' '.join(words)}: {done.stderr}"


def plug_in_card(cable: str, *, site: int, inside: int, address: str, hardware: str = "") -> None:
    """Give the network of process ``inside`` a card ``eth0`` with ``address``, whose other end ``cable`` is at the
    bridge of process ``site``.
    """
    ends = f"link add name {cable} type veth peer name eth0 netns {inside}"
    run_ip(*ends.split(), netns=site)
    run_ip("link", "set", cable, "master", "br0", "up", netns=site)
    card = [f"link set eth0 address {hardware}"] if hardware else []
    for words in ("link set lo up", *card, f"addr add {address}/24 dev eth0", "link set eth0 up"):
        run_ip(*words.split(), netns=inside)


def run_tc(*words: str, netns: int) -> str:
    """Run tc(8) in the network namespace of process ``netns``; return its error message, empty on success."""
    program = shutil.which("tc", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    if program is None:
        return "tc is missing"
    done = subprocess.run(
        ["nsenter", f"--target={netns}", "--net", program, *words],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stderr.strip() if done.returncode else ""


@dataclass(kw_only=True)
class ManagerNetwork:
    """The manager's network namespace with a bridge, to which every computer's cable is attached."""

    process: "subprocess.Popen[bytes]"
    network: str

    @property
    def netns(self) -> Path:
        return Path(f"/proc/{self.process.pid}/ns/net")

    @property
    def prefix(self) -> list[str]:
        """Command prefix that enters the manager's namespace."""
        return ["nsenter", f"--net={self.netns}"]

    @classmethod
    def make(cls, network: str = "10.231.0") -> "ManagerNetwork":
        process = subprocess.Popen(
            ["unshare", "--net", "cat"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
        )
        site = cls(process=process, network=network)
        own = Path("/proc/self/ns/net").readlink()
        wait_for(lambda: site.netns.readlink() != own, "a network namespace")
        for words in (
            "link set lo up",
            "link add br0 type bridge forward_delay 0",
            f"addr add {network}.1/24 dev br0",
            "link set br0 up",
        ):
            run_ip(*words.split(), netns=process.pid)
        return site

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(60)
