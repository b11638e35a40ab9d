# SPDX-License-Identifier: Apache-2.0
"""Real OpenSSH servers on loopback addresses, each a host of its own, for tests and benchmarks.

No root is needed and no system file is changed, with one exception: as root, sshd refuses to start without
its empty privilege separation directory (/run/sshd), which is created where it is missing. Every host has its
own address, host key, HOME and XDG_STATE_HOME (through ``SetEnv``); the process list and the machine's
figures are shared. ``EDGECTL_SSH_CONFIG`` names the configuration with the hosts' names, so that neither ssh
nor edgectl reads the configuration of the user who runs the tests.
"""

import getpass
import ipaddress
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from edgectl.model.inventory import Host, Role
from tests.compiled_agent import give_agent
from tests.leftovers import end_started_in
from tests.pace import patience

PRIVSEP = Path("/run/sshd")
MARK = "EDGECTL_TEST_SSHD"
# The interpreter of the tests without its virtual environment: a host has a python3 and nothing of edgectl.
PATH = f"{sys.base_prefix}/bin:/usr/local/bin:/usr/bin:/bin"
# Time-out in seconds for the start of a server, on a machine that may be busy or stall.
STARTS_S = patience(60.0)


def find_program(name: str) -> str:
    """Return the full path of ``name``, searched in the system directories too; sshd requires an absolute
    path.
    """
    found = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    assert found, f"{name} is missing; install it: sudo apt-get install openssh-server"
    return found


def get_first_address() -> ipaddress.IPv4Address:
    """Return the first address of this process alone: no other process that searches a free port takes ours while a
    server restarts.
    """
    return ipaddress.IPv4Address(f"127.{20 + os.getpid() // 250 % 80}.{os.getpid() % 250}.11")


def make_key(path: Path, comment: str = "edgectl-test") -> str:
    """Write an ed25519 key pair to ``path`` and ``path``.pub; return the public line."""
    key = Ed25519PrivateKey.generate()
    path.touch(mode=0o600)
    path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption()))
    public = key.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH).decode()
    path.with_suffix(path.suffix + ".pub").write_text(f"{public} {comment}\n")
    return public


@cache
def no_penalty_options() -> tuple[str, ...]:
    """Return options that switch off penalties: OpenSSH 9.8 and later punish addresses with failed logins;
    the tests fail on purpose, from one address.
    """
    asked = subprocess.run(
        [find_program("sshd"), "-T", "-f", "/dev/null", "-o", "PerSourcePenalties=no"],
        capture_output=True,
        text=True,
        check=False,
    )
    return () if "Bad configuration option" in asked.stderr else ("PerSourcePenalties no",)


@dataclass(kw_only=True)
class Server:
    """One sshd. ``key`` is its public host key line (type and base64), ``home`` the HOME of the login; ``enter``: words
    before its command, which enter namespaces of its own.
    """

    name: str
    address: str
    port: int
    directory: Path
    key: str
    home: Path
    process: subprocess.Popen[bytes] | None = None
    extra: tuple[str, ...] = ()
    enter: tuple[str, ...] = ()

    @property
    def known_hosts_line(self) -> str:
        return f"[{self.address}]:{self.port} {self.key}\n"

    @property
    def log(self) -> str:
        return (self.directory / "sshd.log").read_text(errors="replace")

    def start(self) -> None:
        """Start sshd, without waiting for it."""
        log = (self.directory / "sshd.log").open("wb")
        with log:
            command = [
                *self.enter,
                find_program("sshd"),
                "-D",
                "-e",
                "-f",
                str(self.directory / "sshd_config"),
            ]
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )

    def wait(self) -> None:
        """Wait until it listens."""
        deadline = time.monotonic() + STARTS_S
        assert self.process is not None
        while "Server listening on" not in self.log:
            assert self.process.poll() is None, self.log
            assert time.monotonic() < deadline, f"sshd did not start: {self.log}"
            time.sleep(0.01)

    def stop(self) -> None:
        """End the server, its open sessions, and their background processes."""
        if self.process is not None:
            pids = [self.process.pid, *_list_descendants(self.process.pid)]
            for pid in pids:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self.process.wait()
            self.process = None
        kill_marked(str(self.directory))

    def restart(self) -> None:
        self.stop()
        self.start()
        self.wait()

    def change_key(self) -> None:
        """Replace the host key, as after a reinstallation, and restart."""
        (self.directory / "host_key").unlink()
        self.key = make_key(self.directory / "host_key")
        self.restart()

    def configure(self, **changes: object) -> None:
        """Write sshd_config; ``changes`` are for `write_config`."""
        write_config(self, **changes)  # type: ignore[arg-type]


def write_config(
    server: Server, *, env: Mapping[str, str], authorized: Path, extra: Sequence[str] = ()
) -> None:
    """Write sshd_config. ``extra`` lines come first: sshd takes the first value, except of MaxStartups, of
    which it takes the last.
    """
    set_env = " ".join(f'"{name}={value}"' for name, value in env.items())
    lines = [
        *extra,
        *no_penalty_options(),
        f"ListenAddress {server.address}",
        f"Port {server.port}",
        f"HostKey {server.directory / 'host_key'}",
        "PidFile none",
        "UsePAM no",
        "StrictModes no",
        "UseDNS no",
        "PermitRootLogin prohibit-password",
        "PasswordAuthentication no",
        "KbdInteractiveAuthentication no",
        f"AuthorizedKeysFile {authorized}",
        *([] if any(line.startswith("MaxStartups") for line in extra) else ["MaxStartups 200:30:400"]),
        "PrintMotd no",
        "AcceptEnv EDGECTL_CANARY*",
        f"SetEnv {set_env}",
    ]
    (server.directory / "sshd_config").write_text("\n".join(lines) + "\n")


def _list_descendants(pid: int) -> list[int]:
    children: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError):
            fields = stat.read_text(errors="replace").rpartition(")")[2].split()
            children.setdefault(int(fields[1]), []).append(int(stat.parent.name))
    found, todo = [], [pid]
    while todo:
        todo += (below := children.get(todo.pop(), []))
        found += below
    return found


def kill_marked(mark: str) -> None:
    """End processes left by logins to our servers: those with our mark in their environment."""
    wanted = f"{MARK}={mark}\0".encode()
    for environ in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if wanted in environ.read_bytes() + b"\0":
                os.kill(int(environ.parent.name), signal.SIGKILL)


def free_port(address: str) -> int:
    with socket.socket() as probe:
        probe.bind((address, 0))
        return int(probe.getsockname()[1])


@dataclass(kw_only=True)
class Lab:
    """Running servers, the key that opens them, and the ssh_config and known_hosts with their entries."""

    directory: Path
    servers: dict[str, Server] = field(default_factory=dict)

    @property
    def user_key(self) -> Path:
        return self.directory / "user_key"

    @property
    def known_hosts(self) -> Path:
        return self.directory / "known_hosts"

    @property
    def ssh_config(self) -> Path:
        return self.directory / "ssh_config"

    @property
    def authorized_keys(self) -> Path:
        return self.directory / "authorized_keys"

    @property
    def environment(self) -> dict[str, str]:
        """Return the environment that a process needs to find the servers."""
        return {"EDGECTL_SSH_CONFIG": str(self.ssh_config)}

    def __getitem__(self, name: str) -> Server:
        return self.servers[name]

    def restart_stopped_servers(self) -> None:
        """Start the servers that a test has stopped."""
        for server in self.servers.values():
            if server.process is None:
                server.restart()

    def end_tasks(self) -> None:
        """End what runs on the hosts by signals, and remove their records: to have edgectl stop it takes 30 times the
        CPU. All servers run again.
        """
        self.restart_stopped_servers()
        end_started_in([server.home for server in self.servers.values()])
        for server in self.servers.values():
            for path in (server.home / "state" / "edgectl").iterdir():
                if path.name != "agent":
                    shutil.rmtree(path)

    def add(
        self, name: str, *, address: str = "", extra: Sequence[str] = (), enter: Sequence[str] = ()
    ) -> Server:
        """Create the files of one more server; it is not started yet. One with ``enter`` has every port for itself."""
        directory = self.directory / name
        home = directory / "home"
        home.mkdir(parents=True)
        give_agent(home / "state" / "edgectl")
        address = address or str(get_first_address() + len(self.servers))
        key = make_key(directory / "host_key")
        server = Server(
            name=name,
            address=address,
            port=2222 if enter else free_port(address),
            directory=directory,
            key=key,
            home=home,
            extra=tuple(extra),
            enter=tuple(enter),
        )
        self.servers[name] = server
        self.configure(server, extra)
        return server

    def configure(self, server: Server, extra: Sequence[str] = ()) -> None:
        env = {
            "HOME": str(server.home),
            "XDG_STATE_HOME": str(server.home / "state"),
            MARK: str(server.directory),
            "PATH": PATH,
        }
        write_config(server, env=env, authorized=self.authorized_keys, extra=extra)

    def write_files(self, *extra: str, key: Path | None = None) -> None:
        """(Re)write known_hosts and ssh_config; ``extra`` lines are put before everything else in ssh_config, ``key`` is the user's."""
        self.known_hosts.write_text("".join(server.known_hosts_line for server in self.servers.values()))
        blocks = [f"Host {s.name}\n  HostName {s.address}\n  Port {s.port}\n" for s in self.servers.values()]
        common = [
            "Host *",
            f"  User {getpass.getuser()}",
            f"  IdentityFile {key or self.user_key}",
            "  IdentitiesOnly yes",
            "  IdentityAgent none",
            f"  UserKnownHostsFile {self.known_hosts}",
            "  GlobalKnownHostsFile none",
        ]
        self.ssh_config.write_text("\n".join([*extra, *blocks, *common]) + "\n")

    def host(self, name: str, **changes: object) -> Host:
        """The inventory's entry for server ``name``, by its ssh_config alias."""
        values: dict[str, object] = {"name": name, "role": Role.EDGE, "host": name}
        return Host(**(values | changes))  # type: ignore[arg-type]


@contextmanager
def running_lab(
    directory: Path,
    names: Sequence[str],
    *,
    extra: Sequence[str] = (),
    networks: Mapping[str, tuple[str, Sequence[str]]] | None = None,
) -> Iterator[Lab]:
    """Start one server per name; ``extra`` are sshd_config lines for all, ``networks`` the address of each and the
    words that enter its namespaces. Everything that ran on them is ended afterwards.
    """
    directory.mkdir(parents=True, exist_ok=True)
    if os.geteuid() == 0:
        PRIVSEP.mkdir(mode=0o755, exist_ok=True)
    lab = Lab(directory=directory)
    lab.authorized_keys.write_text(make_key(lab.user_key) + "\n")
    try:
        for name in names:
            address, enter = (networks or {}).get(name, ("", ()))
            lab.add(name, address=address, extra=extra, enter=enter)
        lab.write_files()
        for server in lab.servers.values():
            server.start()
        for server in lab.servers.values():
            server.wait()
        yield lab
    finally:
        for server in lab.servers.values():
            server.stop()
