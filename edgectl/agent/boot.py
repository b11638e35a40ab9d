"""The first thing that runs on a host: find the agent under its hash, or take it from standard input, check it, run it.

The text of this file follows the constant command line on standard input, so it may import nothing but the standard library.
Input: ``length newline boot-text``, then one line ``marker sha256 request-length agent-length timeout``, the request, the agent.
Output: one frame that carries the request's random marker, a length and a digest; whatever else a login shell prints is noise.
"""

import os
import stat
import sys
from importlib.machinery import ModuleSpec, SourceFileLoader

try:
    # The module ``signal`` itself brings enum along: 4 ms of CPU.
    from _signal import ITIMER_REAL, setitimer
except ImportError:
    from signal import ITIMER_REAL, setitimer
try:
    # And hashlib loads OpenSSL: another 4 ms. The bare module is _sha2 since Python 3.12, _sha256 before.
    from _sha2 import sha256 as _algorithm
except ImportError:
    try:
        from _sha256 import sha256 as _algorithm
    except ImportError:
        from hashlib import sha256 as _algorithm

PACKAGE = "edgectl_agent"
OLDEST = (3, 6)
KEPT_S = 30 * 86400
# With neither disk nor memory file system to keep it, the agent lives under a name that cannot exist.
NOWHERE = "/dev/null/edgectl"


def sha256(data):
    """Hex digest."""
    return _algorithm(data).hexdigest()


class Channel:
    """The way back to the manager. Takes over standard output, so that nothing else can write between our bytes."""

    def __init__(self, marker):
        self.marker = marker
        self.fd = os.dup(1)
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, 1)
        os.close(null)

    def write(self, data):
        """Write all of ``data``."""
        view = memoryview(data)
        while view:
            view = view[os.write(self.fd, view) :]

    def reply(self, payload):
        """Send the one answer: ``edgectl-frame marker length sha256``, then the bytes."""
        head = "\nedgectl-frame %s %d %s\n" % (self.marker, len(payload), sha256(payload))
        self.write(head.encode() + payload + b"\n")


def state_bases():
    """Where edgectl keeps its state on this host, best first; the second is for homes that cannot be written."""
    base = os.environ.get("EDGECTL_STATE_DIR")
    if not base:
        root = os.environ.get("XDG_STATE_HOME") or os.path.join(os.path.expanduser("~"), ".local", "state")
        base = os.path.join(root, "edgectl")
    return [os.path.abspath(base), "/dev/shm/edgectl-%d" % os.geteuid()]  # noqa: S108 - checked to be ours before use


def private_dir(path):
    """Make ``path`` a directory that is ours alone. OSError where it is a link, somebody else's, or open to writers."""
    os.makedirs(path, 0o700, exist_ok=True)
    check_private(path)


def check_private(path):
    """OSError unless ``path`` is a directory that is ours alone; what others may only read is closed to them."""
    info = os.lstat(path)
    if not stat.S_ISDIR(info.st_mode) or info.st_uid != os.geteuid() or info.st_mode & 0o022:
        raise PermissionError(1, "not a directory of our own, mode 0700", path)
    if info.st_mode & 0o077:
        os.chmod(path, 0o700)


def agent_dir(base):
    """The directory of cached agents under ``base``."""
    private_dir(base)
    path = os.path.join(base, "agent")
    private_dir(path)
    return path


def cached(sha):
    """(directory, bytes) of the agent kept under its hash; (None, b"") where it is missing or was changed."""
    for base in state_bases():
        try:
            if not os.path.isdir(os.path.join(base, "agent")):
                continue
            folder = agent_dir(base)
            fd = os.open(os.path.join(folder, sha + ".pyz"), os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
            with open(fd, "rb") as file:
                agent = file.read()
        except OSError:
            continue
        if sha256(agent) == sha:
            return folder, agent
    return None, b""


def store(sha, agent):
    """Keep the agent for the next request; returns its directory, or None where nothing can be written."""
    for base in state_bases():
        try:
            folder = agent_dir(base)
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
            remove(partial)
        else:
            forget_old(folder)
            return folder
    return None


def forget_old(folder):
    """Remove agents that nobody has sent for a month: a new version leaves its predecessor behind."""
    import shutil
    import time

    for name in os.listdir(folder):
        path = os.path.join(folder, name)
        try:
            old = os.lstat(path).st_mtime < time.time() - KEPT_S
        except OSError:
            # Another agent has just renamed or removed it.
            continue
        if old:
            shutil.rmtree(path, ignore_errors=True) if os.path.isdir(path) else remove(path)


def remove(path):
    """Remove a file; no matter if it is gone."""
    try:
        os.unlink(path)
    except OSError:
        pass


def sources(agent):
    """File name -> bytes of an archive whose members are stored, not compressed."""
    found, at = {}, 0
    while agent[at : at + 4] == b"PK\x03\x04":
        size = int.from_bytes(agent[at + 18 : at + 22], "little")
        name_end = at + 30 + int.from_bytes(agent[at + 26 : at + 28], "little")
        start = name_end + int.from_bytes(agent[at + 28 : at + 30], "little")
        found[agent[at + 30 : name_end].decode()] = agent[start : start + size]
        at = start + size
    return found


class Loader(SourceFileLoader):
    """Source from the verified bytes in memory, compiled code from our private directory, as Python itself keeps it."""

    files = {}

    def get_data(self, path):
        """The source from memory; anything else (compiled code) from disk."""
        return self.files[path] if path in self.files else SourceFileLoader.get_data(self, path)

    def path_stats(self, path):
        """The directory carries the hash, so compiled code can never be older than its source."""
        return {"mtime": 1, "size": len(self.files[path])}


class Finder:
    """Finds the modules of the agent."""

    @staticmethod
    def find_spec(name, _path=None, _target=None):
        """The module's spec, or None where it is not one of ours."""
        stem = os.path.join(Loader.root, *name.split("."))
        for file, package in ((stem + ".py", False), (os.path.join(stem, "__init__.py"), True)):
            if name.split(".")[0] == PACKAGE and file in Loader.files:
                spec = ModuleSpec(name, Loader(name, file), origin=file, is_package=package)
                spec.has_location = True
                return spec
        return None


def install(folder, sha, agent):
    """Make ``edgectl_agent`` importable."""
    sys.dont_write_bytecode = folder is None
    Loader.root = os.path.join(folder or NOWHERE, sha)
    Loader.files = {os.path.join(Loader.root, name): data for name, data in sources(agent).items()}
    sys.meta_path.insert(0, Finder)


def boot(stdin):
    """Serve the one request on ``stdin``."""
    marker, sha, request_length, agent_length, timeout = stdin.readline().decode("ascii").split()
    os.umask(0o077)
    channel = Channel(marker)
    version = '"python": "%d.%d.%d"' % sys.version_info[:3]
    if sys.version_info < OLDEST:
        return channel.reply(('{%s, "too_old": true}' % version).encode())
    # The manager's deadline is ours as well: nothing lingers here after it has given up.
    setitimer(ITIMER_REAL, float(timeout))
    request, agent = stdin.read(int(request_length)), stdin.read(int(agent_length))
    folder = None
    if agent:
        folder = store(sha, agent)
    else:
        folder, agent = cached(sha)
    if sha256(agent) != sha:
        return channel.reply(('{%s, "missing": true}' % version).encode())
    install(folder, sha, agent)
    from edgectl_agent.main import serve

    return serve(request, channel, state_bases())


if __name__ == "__main__":
    boot(sys.stdin.buffer)
