# SPDX-License-Identifier: Apache-2.0
"""A real Docker Engine with mounts, network, data and control groups of its own. Nothing of it is left afterwards."""

import contextlib
import http.client
import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tarfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.pace import patience

IMAGE = "edgectl-test:1"
_START_S, _CALL_S = 60.0, 60.0
PROGRAMS = Path(sys.executable).parents[1] / "docker"
# What the containers see of this system, read-only: Python and a shell of it.
SYSTEM = ("/usr:/usr:ro",)
_LINKS = {name: f"usr/{name}" for name in ("bin", "lib", "lib64", "lib32")}


def find_missing_for_containers() -> str:
    """Return why no engine can be started here; empty if one can."""
    if os.geteuid() != 0:
        return "needs root"
    return "" if (PROGRAMS / "dockerd").exists() else "needs Docker's programs: .ci/need-docker"


class _SocketConnection(http.client.HTTPConnection):
    """HTTP over a socket of this machine."""

    def __init__(self, path: Path) -> None:
        super().__init__("localhost", timeout=patience(_CALL_S))
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(str(self._path))


@dataclass
class EngineClient:
    """Requests of the tests to an engine. ``folder``: its files."""

    folder: Path

    @property
    def socket(self) -> Path:
        return self.folder / "docker.sock"

    @property
    def environment(self) -> dict[str, str]:
        """The variables with which the program ``docker`` finds it, and is found."""
        return {
            "DOCKER_HOST": f"unix://{self.socket}",
            "DOCKER_CONFIG": str(self.folder / "config"),
            "PATH": f"{PROGRAMS}:{os.environ['PATH']}:/usr/sbin:/sbin",
        }

    def request(self, method: str, path: str, body: bytes | None = None) -> tuple[int, bytes]:
        """Ask without the program ``docker``, which takes 50 ms of CPU; the status is 0 where nobody answers."""
        try:
            connection = _SocketConnection(self.socket)
            with contextlib.closing(connection):
                connection.request(method, path, body)
                answer = connection.getresponse()
                return answer.status, answer.read()
        except OSError:
            return 0, b""

    def answers(self) -> bool:
        return self.request("GET", "/_ping")[0] == 200

    def call(self, *words: str) -> str:
        """Run ``docker`` with ``words``; its output."""
        done = subprocess.run(
            [str(PROGRAMS / "docker"), *words],
            env=os.environ | self.environment,
            capture_output=True,
            timeout=patience(_CALL_S),
            check=False,
        )
        assert done.returncode == 0, done.stderr.decode()
        return done.stdout.decode().strip()

    def import_image(self) -> None:
        """Make the image of the tests, if it is missing: a system of links into this one, and a busybox."""
        if self.request("GET", f"/images/{IMAGE}/json")[0] != 200:
            name, _, tag = IMAGE.partition(":")
            status, said = self.request(
                "POST", f"/images/create?fromSrc=-&repo={name}&tag={tag}", build_image()
            )
            assert status == 200, said

    def list_containers(self, *, dead: bool = True) -> list[str]:
        """The names of all containers, running or ``dead``."""
        status, said = self.request("GET", f"/containers/json?all={int(dead)}")
        assert status == 200, said
        return [name.lstrip("/") for each in json.loads(said) for name in each["Names"]]


def build_engine_argv(
    programs: Path, group: str, *, folder: Path, more: Iterable[str], storage: str = "vfs"
) -> list[str]:
    """The command line of an engine whose programs are in ``programs``, whose containers are in the control group
    ``group``, and whose files are in ``folder``. ``storage``: its driver; vfs runs everywhere, and copies each layer whole.
    """
    return [
        str(programs / "dockerd"), f"--data-root={folder}/data", "--bridge=none", "--iptables=false",
        "--ip6tables=false", f"--storage-driver={storage}", f"--cgroup-parent=/{group}", f"--init-path={programs}/docker-init",
        "--exec-opt=native.cgroupdriver=cgroupfs", *more,
    ]  # fmt: skip


@dataclass
class DockerEngine(EngineClient):
    """An engine on this machine. It is running between `start` and `kill`."""

    live_restore: bool = True
    # For a build: with the network of this machine, not without a cable, and with layers that are not copied whole.
    builds: bool = False
    process: "subprocess.Popen[bytes] | None" = None
    # Keeps the namespaces while the engine is away.
    holder: "subprocess.Popen[bytes] | None" = None

    @property
    def group(self) -> str:
        """Name of the control group of all its containers."""
        return f"test-of-edgectl-{os.getpid()}-{self.folder.name}"

    def start(self) -> None:
        """Start the engine and wait until it answers."""
        if self.holder is None:
            self._make_namespaces()
        (self.folder / "docker.pid").unlink(missing_ok=True)
        own = [
            f"--host=unix://{self.socket}",
            f"--exec-root={self.folder}/exec",
            f"--pidfile={self.folder}/docker.pid",
            *(["--live-restore"] if self.live_restore else []),
        ]
        storage = "overlay2" if self.builds else "vfs"
        argv = build_engine_argv(PROGRAMS, self.group, folder=self.folder, more=own, storage=storage)
        words = [*self._enter(), *argv]
        with (self.folder / "dockerd.log").open("ab") as log:
            self.process = subprocess.Popen(
                words,
                env=os.environ | self.environment | {"LD_LIBRARY_PATH": str(PROGRAMS)},
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
            )
        deadline = time.monotonic() + patience(_START_S)
        while not self.answers():
            ended = self.process.poll()
            if ended is not None or time.monotonic() > deadline:
                raise AssertionError((self.folder / "dockerd.log").read_text()[-2000:])
            time.sleep(0.1)

    def _make_namespaces(self) -> None:
        """A /run of its own, in which the sockets of the shims are; and mostly a network without a cable."""
        self.folder.mkdir(exist_ok=True)
        ready = "mount -t tmpfs tmpfs /run && echo ready && exec sleep infinity"
        self.holder = subprocess.Popen(
            ["unshare", "--mount", *(() if self.builds else ("--net",)), "--ipc", "sh", "-c", ready],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )
        assert self.holder.stdout is not None
        with self.holder.stdout as said:
            assert said.readline() == b"ready\n"

    def _enter(self) -> list[str]:
        assert self.holder is not None
        spaces = (("mount", "mnt"), ("net", "net"), ("ipc", "ipc"))
        return ["nsenter", *(f"--{name}=/proc/{self.holder.pid}/ns/{file}" for name, file in spaces)]

    def stop(self) -> None:
        """End the engine as a service manager does."""
        assert self.process is not None
        self.process.terminate()
        self.process.wait(patience(_START_S))

    def kill(self) -> None:
        """Kill the engine, and with it its containerd; shims and containers live on."""
        assert self.process is not None
        self.process.kill()
        self.process.wait(patience(_START_S))
        # The kernel has killed it with its parent; where nobody reaps it, its pid would look alive to the next engine.
        for pid, line in self.list_processes().items():
            if line.startswith("containerd "):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        for name in ("containerd.pid", "containerd.sock", "containerd.sock.ttrpc"):
            (self.folder / "exec/containerd" / name).unlink(missing_ok=True)

    def list_processes(self) -> dict[int, str]:
        """Engine, containerd, shims and containers that live, with their command lines."""
        assert self.holder is not None
        found, space = {}, Path(f"/proc/{self.holder.pid}/ns/mnt").readlink()
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError, ProcessLookupError):
                if (
                    not entry.name.isdigit()
                    or (entry / "stat").read_text().rpartition(")")[2].split()[0] in "ZX"
                ):
                    continue
                inside = self.group in (entry / "cgroup").read_text()
                if inside or ((entry / "ns/mnt").readlink() == space and int(entry.name) != self.holder.pid):
                    found[int(entry.name)] = (entry / "cmdline").read_text().replace("\0", " ")
        return found

    def find_shims(self) -> list[int]:
        """The processes between containerd and the containers."""
        return [
            pid for pid, line in self.list_processes().items() if "containerd-shim" in line.split(" ", 1)[0]
        ]

    def end(self) -> None:
        """Kill everything that is left, and remove its control groups and files."""
        deadline = time.monotonic() + patience(_START_S)
        while self.holder is not None and (left := self.list_processes()) and time.monotonic() < deadline:
            for pid in left:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            time.sleep(0.05)
        for process in (self.process, self.holder):
            if process is not None:
                process.kill()
                process.wait(patience(_START_S))
        for top in Path("/sys/fs/cgroup").glob(f"*/{self.group}"):
            for folder, _, _ in os.walk(top, topdown=False):
                Path(folder).rmdir()
        shutil.rmtree(self.folder, ignore_errors=True)


def build_image() -> bytes:
    """A tar archive for ``docker import``."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for name in ("usr", "sbin", "tmp", "etc", "root", "proc", "sys", "dev", "run", "opt"):
            entry = tarfile.TarInfo(name)
            entry.type, entry.mode = tarfile.DIRTYPE, 0o1777 if name == "tmp" else 0o755
            archive.addfile(entry)
        for name, target in _LINKS.items():
            entry = tarfile.TarInfo(name)
            entry.type, entry.linkname = tarfile.SYMTYPE, target
            archive.addfile(entry)
        archive.add(PROGRAMS / "busybox", "opt/busybox")
    return packed.getvalue()


@contextmanager
def docker_engine(folder: Path, *, live_restore: bool = True, builds: bool = False) -> Iterator[DockerEngine]:
    """An engine with the image of the tests."""
    engine = DockerEngine(folder, live_restore, builds)
    try:
        engine.start()
        engine.import_image()
        yield engine
    finally:
        engine.end()
