# SPDX-License-Identifier: Apache-2.0
"""Emulated computer on this machine: namespaces, disk, sshd, power switch and cable (see `host_emulator`),
with the manager's network.

Everything is created by the tests, is confined to namespaces, and is gone once they end, even if they are
killed: the outer process of each computer ends with its standard input.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from tests import sshd
from tests.faults import cgroup, scan
from tests.faults.computer_engine import SHARED, ComputerEngine, is_of_engine
from tests.faults.hosts import (
    CABLE,
    DISK,
    HERE,
    LIMIT,
    MOUNTS,
    POWER,
    PYTHON,
    REBOOT,
    Host,
    install_programs,
    wait_for,
)
from tests.faults.network import ManagerNetwork, plug_in_card, run_ip
from tests.faults.scan import Bystander, Process
from tests.pace import patience

REPOSITORY = HERE.parent.parent
USER = "edge"
SYSTEMD_PROGRAMS = ("/lib/systemd/systemd", "(sd-pam)", "dbus-daemon")
AS_USER = [
    "setpriv",
    "--reuid=4711",
    "--regid=4711",
    "--clear-groups",
    "env",
    "-i",
    f"HOME=/home/{USER}",
    "PATH=/usr/bin:/bin",
]


def find_missing_for_namespaces() -> str:
    """Return why namespaces cannot be used here; empty if they can."""
    if os.geteuid() != 0:
        return "needs root"
    if lacking := [
        name
        for name in ("unshare", "nsenter", "ip", "mount", "setpriv")
        if not shutil.which(name, path=find_sshd())
    ]:
        return f"needs {', '.join(lacking)}"
    probe = subprocess.run(
        ["unshare", "--mount", "--net", "--pid", "--fork", "true"],
        capture_output=True,
        text=True,
        check=False,
    )
    return f"namespaces are refused: {probe.stderr.strip()}" if probe.returncode else ""


def find_missing_for_systemd() -> str:
    """Return why systemd cannot be PID 1 of a computer here; empty if it can."""
    if why := find_missing_for_namespaces():
        return why
    needed = {
        "systemd": Path("/lib/systemd/systemd"),
        "libpam-systemd": Path("/lib/systemd/systemd-logind"),
        "dbus": Path("/usr/bin/dbus-daemon"),
    }
    if lacking := [package for package, path in needed.items() if not path.exists()]:
        return f"needs {', '.join(lacking)}"
    return "" if cgroup.list_hierarchies() else "no writable control groups"


def find_sshd() -> str:
    return f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"


@dataclass(kw_only=True)
class NamespaceHost:
    """A computer with network, pid, mount, uts and ipc namespaces, disk, sshd and boot id of its own.

    ``shared``: directories of the machine that it has too, at these places of its disk. ``docker``: it has a Docker
    Engine of its own, whose containers survive that (``live_restore``) or not.
    """

    name: str
    site: ManagerNetwork
    directory: Path
    number: int
    user_key: str
    cores: float | None = None
    memory: float | None = None
    systemd: bool = False
    docker: bool = False
    live_restore: bool = True
    shared: Mapping[str, Path] = field(default_factory=dict)
    env: dict[str, str] = field(default_factory=dict)
    options: tuple[str, ...] = ()
    kind: str = "namespace"
    can: frozenset[str] = frozenset({POWER, CABLE, REBOOT, DISK, MOUNTS, PYTHON})
    pid: int = 0
    key: str = ""
    read_only: bool = False

    def __post_init__(self) -> None:
        for place in ("ssh", "oracle"):
            (self.directory / place).mkdir(parents=True)
        install_programs(self.directory / "oracle")
        self.kind = "containers" if self.docker else "systemd" if self.systemd else self.kind
        self.own_groups = (
            cgroup.create_everywhere(f"edgectl-faults-{os.getpid()}-{id(self)}-{self.name}")
            if self.systemd
            else []
        )
        self.group = cgroup.create_cgroup(
            f"edgectl-faults-{os.getpid()}-{self.name}", self.cores, self.memory
        )
        self.can |= {LIMIT} if self.group.limited else frozenset()
        self.engine = (
            ComputerEngine(self.directory / "docker", self, self.live_restore) if self.docker else None
        )
        self.key = sshd.make_key(self.directory / "ssh" / "host_key")
        self.allow_logins(allowed=True, settle=False)
        self._write_sshd_config()
        (self.directory / "config.json").write_text(json.dumps(self._config()))
        self.emulator = subprocess.Popen(
            [sys.executable, str(HERE / "host_emulator.py"), str(self.directory / "config.json")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.emulator.stdout is not None
        self.root = str(json.loads(self.emulator.stdout.readline())["root"])
        if self.engine:
            self.engine.install()
        self.boot()

    def _config(self) -> dict[str, object]:
        return {
            "name": self.name,
            "directory": str(self.directory),
            "user": USER,
            "home_size": "24m",
            "hidden": [str(REPOSITORY)],
            "shared": {
                place: str(source.resolve())
                for place, source in {**self.shared, **(SHARED if self.docker else {})}.items()
            },
            "docker": self.docker,
            "oracle": str(self.directory / "oracle"),
            "ssh": str(self.directory / "ssh"),
            "sshd": sshd.find_program("sshd"),
            "cgroups": self.group.procs_files,
            "groups": [str(group) for group in self.own_groups],
        }

    def _write_sshd_config(self) -> None:
        lines = [
            *self.options,
            *sshd.no_penalty_options(),
            "Port 22",
            "HostKey /etc/ssh/edgectl-faults/host_key",
            "AuthorizedKeysFile /etc/ssh/edgectl-faults/authorized_keys",
            "PidFile none",
            f"UsePAM {'yes' if self.systemd else 'no'}",
            "UseDNS no",
            "StrictModes no",
            "PasswordAuthentication no",
            "KbdInteractiveAuthentication no",
            "MaxStartups 200:30:400",
            "PrintMotd no",
            *(
                ["SetEnv " + " ".join(f'"{name}={value}"' for name, value in self.env.items())]
                if self.env
                else []
            ),
        ]
        (self.directory / "ssh" / "sshd_config").write_text("\n".join(lines) + "\n")

    def _order(self, word: str) -> int:
        assert self.emulator.stdin is not None
        assert self.emulator.stdout is not None
        self.emulator.stdin.write(f"{word}\n")
        self.emulator.stdin.flush()
        return int(json.loads(self.emulator.stdout.readline())["pid"])

    @property
    def address(self) -> str:
        return f"{self.site.network}.{self.number}"

    @property
    def login(self) -> tuple[str, int, str, str]:
        return self.address, 22, USER, self.key

    def path(self, inside: str) -> Path:
        """Return the path of a file on the computer's disk as seen by the tests (also while it is off)."""
        return Path(f"/proc/{self.emulator.pid}/root{self.root}") / inside.lstrip("/")

    @property
    def home(self) -> Path:
        return self.path(f"home/{USER}")

    @property
    def records(self) -> Path:
        return self.directory / "oracle" / "records"

    @property
    def cable(self) -> str:
        return f"v-{self.name}"

    @property
    def boot_id(self) -> str:
        return Path(f"/proc/{self.pid}/root/run/boot_id").read_text().strip()

    def boot(self) -> None:
        """Power on, plug in the cable, and wait until sshd listens, and the engine answers."""
        if self.pid:
            return
        self.pid = self._order("on")
        plug_in_card(
            self.cable,
            site=self.site.process.pid,
            inside=self.pid,
            address=self.address,
            # A real network card keeps its address over a reboot; a new one would leave a stale neighbour entry
            # on the manager for seconds.
            hardware=f"02:e7:00:00:00:{self.number:02x}",
        )
        self._wait_for_sshd()
        if self.engine:
            self.engine.start()

    def _wait_for_sshd(self) -> None:
        try:
            wait_for(self._listens, f"sshd on {self.name}", 60 if self.systemd else 20)
        except AssertionError as error:
            raise AssertionError(f"{error}: {self._console()}") from None

    def _listens(self) -> bool:
        """Return whether port 22 is in state LISTEN in this computer's /proc/net/tcp."""
        return bool(re.search(r":0016 00000000:0000 0A", Path(f"/proc/{self.pid}/net/tcp").read_text()))

    def _console(self) -> str:
        with suppress(OSError):
            return (self.directory / "console.log").read_text()[-500:]
        return ""

    def power_off(self) -> None:
        """Cut the power: the cable goes first, so that no FIN or RST leaves; then every process dies at once."""
        if self.pid:
            run_ip("link", "del", self.cable, netns=self.site.process.pid)
            self._order("off")
            self.pid, self.read_only = 0, False
            if self.engine:
                self.engine.forget()

    def unplug_cable(self) -> None:
        """Unplug the cable: no carrier."""
        run_ip("link", "set", self.cable, "down", netns=self.site.process.pid)

    def plug_in_cable(self) -> None:
        if self.pid:
            run_ip("link", "set", self.cable, "up", "master", "br0", netns=self.site.process.pid)

    def drop_packets(self) -> None:
        """Drop all packets; the carrier stays up."""
        run_ip("link", "set", self.cable, "nomaster", netns=self.site.process.pid)

    def processes(self) -> list[Process]:
        """List processes except PID 1, sshd's listener and sessions, bystanders, and those of the engine; those in
        containers are among them.
        """
        if not self.pid:
            return []
        ours = ("bystander.py", "sshd", *SYSTEMD_PROGRAMS) if self.systemd else ("bystander.py", "sshd")
        return [
            each
            for each in (*self.list_all(), *(self.engine.list_inside() if self.engine else ()))
            if each.pid != self.pid
            and not is_of_engine(each)
            and not any(word in each.command for word in ours)
        ]

    def enter(self, *command: str, user: bool = True) -> list[str]:
        """Build the command line that runs ``command`` on this computer."""
        who = AS_USER if user else []
        spaces = ["--mount", "--uts", "--ipc", "--net", "--pid", "--root", "--wd"]
        return ["nsenter", f"--target={self.pid}", *spaces, *who, *command]

    def run(self, *command: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            self.enter(*command), capture_output=True, text=True, timeout=patience(60), check=False
        )

    def start_bystander(self, name: str, *words: str, pid: int = 0) -> Bystander:
        """Start an unrelated process; ``pid``: its process id on this computer, which must be free."""
        inside = f"/home/{USER}/oracle/records/{name}.bystander"
        last = "/proc/sys/kernel/ns_last_pid"
        if pid:  # the shell that starts it must not take the requested pid
            subprocess.run(
                self.enter("sh", "-c", f"echo 20000 > {last}", user=False), timeout=patience(60), check=True
            )
        begin, after = (f"echo {pid - 1} > {last}; ", f"; echo 20000 > {last}") if pid else ("", "")
        script = f'{begin}{" ".join(AS_USER)} python3 /home/{USER}/oracle/bystander.py "$0" "$@" </dev/null >/dev/null 2>&1 & echo $!{after}'
        done = subprocess.run(
            self.enter("sh", "-c", script, inside, *words, user=False),
            capture_output=True,
            text=True,
            timeout=patience(60),
            check=True,
        )
        number = int(done.stdout)
        assert not pid or number == pid, f"wanted pid {pid}, got {number}"
        return scan.wait_for_bystander(name, self.records / f"{name}.bystander", self._outside(number))

    def inner_pid(self, each: Process) -> int:
        """Return the process id on this computer; 0 if the process is gone."""
        with suppress(OSError):
            # Those in a container have a third number there.
            return int(
                re.findall(
                    r"^NSpid:\t\d+\t(\d+)", Path(f"/proc/{each.pid}/status").read_text(), re.MULTILINE
                )[0]
            )
        return 0

    def _outside(self, inner: int) -> int:
        for each in self.list_all():
            if self.inner_pid(each) == inner:
                return each.pid
        raise AssertionError(f"no process {inner} on {self.name}")

    def list_all(self) -> list[Process]:
        """List every process of the computer outside of containers."""
        return scan.list_processes_in_namespace("pid", Path(f"/proc/{self.pid}/ns/pid").stat().st_ino)

    def restart_sshd(self) -> None:
        """End the listener; PID 1 starts another with the present configuration. Open sessions continue."""
        (listener,) = [each for each in self.list_all() if "[listener]" in each.command]
        os.kill(listener.pid, signal.SIGKILL)
        wait_for(lambda: not listener.alive, "sshd's end")
        self._wait_for_sshd()

    def set_env(self, **env: str) -> None:
        self.env = env
        self._write_sshd_config()
        self.restart_sshd()

    def set_server_options(self, *lines: str) -> None:
        """Add lines to the configuration of sshd, for connections from now on."""
        self.options = lines
        self._write_sshd_config()
        self.restart_sshd()

    def change_key(self) -> None:
        (self.directory / "ssh" / "host_key").unlink()
        self.key = sshd.make_key(self.directory / "ssh" / "host_key")
        self.restart_sshd()

    def allow_logins(self, *, allowed: bool, settle: bool = True) -> None:
        path = self.directory / "ssh" / "authorized_keys"
        path.write_text(f"{self.user_key}\n" if allowed else "")
        path.chmod(0o644)

    def home_read_only(self, *, yes: bool) -> None:
        """Make files below /home read-only for everyone who opens them from now on; files open for writing
        stay writable.
        """
        home = f"{self.root}/home"
        enter = ["nsenter", f"--target={self.pid}", "--mount", "mount"]
        if yes and not self.read_only:
            subprocess.run([*enter, "--rbind", home, home], check=True)
            subprocess.run([*enter, "-o", "remount,bind,ro", home], check=True)
        elif self.read_only and not yes:
            subprocess.run([*enter[:-1], "umount", "-l", home], check=True)
        self.read_only = yes

    def fill_disk(self) -> None:
        """Fill /home to the last byte."""
        with suppress(OSError), (self.home / "fill").open("wb", buffering=0) as file:
            while file.write(bytes(1 << 12)):
                pass

    def free_disk(self) -> None:
        (self.home / "fill").unlink(missing_ok=True)

    def hide_python(self, *, yes: bool) -> None:
        python = self.path("usr/bin/python3")
        hidden = python.with_name("hidden-python3")
        if yes:
            python.rename(hidden)
        else:
            hidden.rename(python)

    def close(self) -> None:
        self.power_off()
        assert self.emulator.stdin is not None
        assert self.emulator.stdout is not None
        self.emulator.stdin.close()
        self.emulator.stdout.close()
        self.emulator.wait(60)
        self.group.remove()
        for group in self.own_groups:
            cgroup.remove_tree(group)
        if self.engine:
            self.engine.remove_groups()


@contextmanager
def start_namespace_hosts(
    directory: Path,
    names: list[str],
    *,
    cores: Mapping[str, float] | None = None,
    memory: Mapping[str, float] | None = None,
    systemd: bool = False,
    live_restore: bool | None = None,
    shared: Mapping[str, Path] | None = None,
) -> Iterator[tuple[ManagerNetwork, dict[str, Host]]]:
    """Start computers in namespaces and the manager's network; needs root. ``systemd``: it is their PID 1.
    ``live_restore``: they have Docker Engines, with or without it. ``shared``: directories of the machine that they have
    too.
    """
    directory.mkdir(parents=True, exist_ok=True)
    key = sshd.make_key(directory / "user_key")
    with ExitStack() as stack:
        site = ManagerNetwork.make()
        stack.callback(site.close)
        hosts: dict[str, Host] = {}
        for number, name in enumerate(names, start=11):
            host = NamespaceHost(
                name=name,
                site=site,
                directory=directory / name,
                number=number,
                user_key=key,
                cores=(cores or {}).get(name),
                memory=(memory or {}).get(name),
                systemd=systemd,
                docker=live_restore is not None,
                live_restore=bool(live_restore),
                shared=shared or {},
            )
            stack.callback(host.close)
            hosts[name] = host
        yield site, hosts
