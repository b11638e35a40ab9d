"""Boot program: load the agent from its cache or from standard input, check its hash, run one request.

The text of this file is sent on standard input after the constant command line, so it may import the standard
library only. Input: ``length newline boot-text``, then one line ``marker sha256 request-length agent-length
timeout key``, the request, the agent. Output: one frame with the request's random marker, a length and a
digest; anything else that a login shell prints is noise.
"""

# Module signal imports enum: 4 ms of CPU.
import _signal as signal
import os
import stat
import sys

# What importlib.machinery gives, without the packages importlib and warnings: 1 ms of CPU.
from _frozen_importlib import ModuleSpec
from _frozen_importlib_external import SourceFileLoader

try:
    # Module hashlib loads OpenSSL: another 4 ms. The bare module is _sha2 since Python 3.12, _sha256 before.
    from _sha2 import sha256 as _new_sha256
except ImportError:
    try:
        from _sha256 import sha256 as _new_sha256
    except ImportError:
        from hashlib import sha256 as _new_sha256

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import BinaryIO

PACKAGE = "edgectl_agent"
OLDEST_PYTHON = (3, 6)
AGENT_KEPT_S = 30 * 86400
# Hexadecimal digits of a seal.
SEAL_LENGTH = 64
# Root of the agent's modules where no directory can keep the agent: a path that cannot exist.
NO_FOLDER = "/dev/null/edgectl"


def compute_sha256(data: bytes) -> str:
    """Compute the digest in hexadecimal."""
    return str(_new_sha256(data).hexdigest())


class Channel:
    """Reply channel to the manager.

    It takes over standard output, so that nothing else can write between its bytes.
    """

    def __init__(self, marker: str) -> None:
        self.marker = marker
        self.fd = os.dup(1)
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, 1)
        os.close(null)

    def write(self, data: bytes) -> None:
        """Write all of ``data``."""
        view = memoryview(data)
        while view:
            view = view[os.write(self.fd, view) :]

    def reply(self, payload: bytes) -> None:
        """Send the one reply: ``edgectl-frame marker length sha256``, then the bytes."""
        head = "\nedgectl-frame %s %d %s\n" % (self.marker, len(payload), compute_sha256(payload))
        self.write(head.encode() + payload + b"\n")


def list_state_bases() -> "list[str]":
    """List the state directories of this host, best first; the second is for homes that cannot be written."""
    base = os.environ.get("EDGECTL_STATE_DIR")
    if not base:
        root = os.environ.get("XDG_STATE_HOME") or os.path.join(os.path.expanduser("~"), ".local", "state")
        base = os.path.join(root, "edgectl")
    return [os.path.abspath(base), "/dev/shm/edgectl-%d" % os.geteuid()]  # noqa: S108 - its owner and mode are checked before use


def make_private_dir(path: str) -> None:
    """Create ``path`` as a directory of this user alone.

    OSError where it is a link, has another owner, or others may write.
    """
    os.makedirs(path, 0o700, exist_ok=True)
    check_private_dir(path)


def check_private_dir(path: str) -> None:
    """OSError unless ``path`` is a directory of this user that no other may write.

    Read access of others is removed.
    """
    info = os.lstat(path)
    if not stat.S_ISDIR(info.st_mode) or info.st_uid != os.geteuid() or info.st_mode & 0o022:
        raise PermissionError(1, "not a private directory of this user (mode 0700)", path)
    if info.st_mode & 0o077:
        os.chmod(path, 0o700)


def make_agent_dir(base: str) -> str:
    """Create the directory of cached agents under ``base``."""
    make_private_dir(base)
    path = os.path.join(base, "agent")
    make_private_dir(path)
    return path


def read_cached_agent(sha: str) -> "tuple[str | None, bytes]":
    """Read (directory, bytes) of the agent cached under its hash.

    (None, b"") where it is missing or was changed.
    """
    for base in list_state_bases():
        try:
            if not os.path.isdir(os.path.join(base, "agent")):
                continue
            folder = make_agent_dir(base)
            fd = os.open(os.path.join(folder, sha + ".pyz"), os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
            with open(fd, "rb") as file:
                agent = file.read()
        except OSError:
            continue
        if compute_sha256(agent) == sha:
            return folder, agent
    return None, b""


def cache_agent(sha: str, agent: bytes) -> "str | None":
    """Write the agent for the next request; returns its directory, or None where nothing can be written."""
    for base in list_state_bases():
        try:
            folder = make_agent_dir(base)
            final = os.path.join(folder, sha + ".pyz")
            partial = "%s.%d" % (final, os.getpid())
            fd = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        except OSError:
            continue
        try:
            with open(fd, "wb") as file:
                file.write(agent)
            os.rename(partial, final)
        except OSError:
            remove_file(partial)
        else:
            remove_old_agents(folder)
            return folder
    return None


def remove_old_agents(folder: str) -> None:
    """Remove agents that were not sent for 30 days: a new version leaves its predecessor behind."""
    import shutil
    import time

    for name in os.listdir(folder):
        path = os.path.join(folder, name)
        try:
            old = os.lstat(path).st_mtime < time.time() - AGENT_KEPT_S
        except OSError:
            # Another agent has just renamed or removed it.
            continue
        if old:
            shutil.rmtree(path, ignore_errors=True) if os.path.isdir(path) else remove_file(path)


def remove_file(path: str) -> None:
    """Remove a file where it exists."""
    try:
        os.unlink(path)
    except OSError:
        pass


def read_archive(agent: bytes) -> "dict[str, bytes]":
    """Read file name -> bytes of a zip archive whose members are stored, not compressed."""
    found, at = {}, 0
    while agent[at : at + 4] == b"PK\x03\x04":
        size = int.from_bytes(agent[at + 18 : at + 22], "little")
        name_end = at + 30 + int.from_bytes(agent[at + 26 : at + 28], "little")
        start = name_end + int.from_bytes(agent[at + 28 : at + 30], "little")
        found[agent[at + 30 : name_end].decode()] = agent[start : start + size]
        at = start + size
    return found


def compute_seal(key: str, path: str, code: bytes) -> bytes:
    """Compute the proof that a holder of ``key`` wrote ``code`` to ``path``."""
    content = compute_sha256(path.encode() + b"\0" + code)
    return compute_sha256(("%s %s" % (key, content)).encode()).encode()


class ArchiveLoader(SourceFileLoader):
    """Import of source from the verified bytes in memory.

    Compiled code is cached in the private directory. Each file begins with a seal by the manager's key, which
    is on no disk of this host: a task of the same login can write there, and no code of its own runs.
    """

    root = ""
    key = ""
    files: "dict[str, bytes]" = {}

    def get_data(self, path: str) -> bytes:
        """Source from memory; anything else (compiled code) from disk, OSError where its seal is not ours."""
        if path in self.files:
            return self.files[path]
        data = SourceFileLoader.get_data(self, path)
        seal, code = data[:SEAL_LENGTH], data[SEAL_LENGTH:]
        if seal != compute_seal(self.key, path, code):
            raise OSError("not written by this manager")
        return code

    def set_data(self, path: str, data: bytes, *, _mode: int = 0o600) -> None:  # type: ignore[override]
        """Keep compiled code with its seal; where it cannot be written, it is compiled again."""
        SourceFileLoader.set_data(self, path, compute_seal(self.key, path, data) + data, _mode=_mode)

    def path_stats(self, path: str) -> "dict[str, int]":
        """A constant time: the directory is named by the hash, so compiled code is never stale."""
        return {"mtime": 1, "size": len(self.files[path])}


class ArchiveFinder:
    """Finder of the agent's modules for ``sys.meta_path``."""

    @staticmethod
    def find_spec(name: str, _path: object = None, _target: object = None) -> "ModuleSpec | None":
        """Find the spec of a module of the agent; None for any other module."""
        stem = os.path.join(ArchiveLoader.root, *name.split("."))
        if name.split(".")[0] != PACKAGE:
            return None
        if os.path.join(stem, "__init__.py") in ArchiveLoader.files:
            # Packages of the agent have no code, so nothing is loaded: 0.1 to 0.2 ms of CPU each.
            return ModuleSpec(name, None, is_package=True)
        if stem + ".py" not in ArchiveLoader.files:
            return None
        spec = ModuleSpec(name, ArchiveLoader(name, stem + ".py"), origin=stem + ".py")
        spec.has_location = True
        return spec


def install_agent(folder: "str | None", sha: str, agent: bytes, key: str) -> None:
    """Make package ``edgectl_agent`` importable. Each ``key`` has a directory of its own."""
    sys.dont_write_bytecode = folder is None
    ArchiveLoader.key = key
    ArchiveLoader.root = os.path.join(folder or NO_FOLDER, sha, compute_sha256(key.encode())[:8])
    ArchiveLoader.files = {
        os.path.join(ArchiveLoader.root, name): data for name, data in read_archive(agent).items()
    }
    sys.meta_path.insert(0, ArchiveFinder)
    # The agent's modules use this one, instead of loading its text a second time.
    sys.modules[PACKAGE + ".link.boot"] = sys.modules[__name__]


def boot_agent(stdin: "BinaryIO") -> None:
    """Serve the one request on ``stdin``."""
    marker, sha, request_length, agent_length, timeout, key = stdin.readline().decode("ascii").split()
    os.umask(0o077)
    channel = Channel(marker)
    version = '"python": "%d.%d.%d"' % sys.version_info[:3]
    if sys.version_info < OLDEST_PYTHON:
        return channel.reply(('{%s, "too_old": true}' % version).encode())
    # The manager's deadline ends this side too: nothing lingers after it has given up.
    signal.setitimer(signal.ITIMER_REAL, float(timeout))
    request, agent = stdin.read(int(request_length)), stdin.read(int(agent_length))
    if not agent:
        folder, agent = read_cached_agent(sha)
    elif compute_sha256(agent) == sha:
        folder = cache_agent(sha, agent)
    else:
        folder, agent = None, b""
    if not agent:
        return channel.reply(('{%s, "missing": true}' % version).encode())
    install_agent(folder, sha, agent, key)
    __import__(PACKAGE + ".link.main")
    sys.modules[PACKAGE + ".link.main"].serve_request(request, channel, list_state_bases())
    return None


if __name__ == "__main__":
    boot_agent(sys.stdin.buffer)
    # Nothing is left to write or to clean up: without Python's own end a request takes a tenth less CPU.
    os._exit(0)
