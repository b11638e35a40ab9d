# SPDX-License-Identifier: Apache-2.0
"""Boot program: load the agent from its cache or from standard input, check its hash, run one request.

The text of this file is sent on standard input after that of ``stub.py``, which runs it in its own namespace,
so it may import the standard library only. Input: ``length newline stub-text length newline boot-zlib``, then
one line ``marker sha256 request-length agent-length timeout key operation``, the request, the packed agent.
Output: one frame with the request's random marker, a length and a digest; anything else that a login shell
prints is noise.
"""

# Module signal imports enum: 4 ms of CPU.
import _signal as signal
import gc
import marshal
import sys
from _imp import extension_suffixes

if __name__ == "__main__":
    # A request leaves no garbage worth the search, which takes 0.2 ms; a supervisor is searched now and then.
    gc.set_threshold(10000)


def take_part_of_os() -> None:
    """Let module os be the part of it that is written in C, and the rest on demand: that takes 0.7 ms."""
    import posix

    coding, part = sys.getfilesystemencoding(), type(sys)("os")
    part.__dict__.update(posix.__dict__, __name__="os", name="posix", pathsep=":", devnull="/dev/null")
    part.__dict__.update(defpath="/bin:/usr/bin", __getattr__=load_rest_of_os)
    # No comprehensions here and below: each is a function, 0.3 KB of code.
    environ = {}
    for key, value in posix.environ.items():
        environ[key.decode(coding, "surrogateescape")] = value.decode(coding, "surrogateescape")
    path = type(sys)("os.path")
    path.__dict__.update(__getattr__=load_os_path)
    sys.modules.update({"os": part, "os.path": path})
    part.__dict__.update(path=path, environ=environ)


def load_os_path(name: str) -> object:
    """Load module os.path, which takes 0.14 ms with what it needs; a usual probe does without."""
    import posixpath

    sys.modules["os.path"].__dict__.update(posixpath.__dict__)
    return getattr(posixpath, name)


def load_rest_of_os(name: str) -> object:
    """Load all of module os; whoever has its part has it, too."""
    part = sys.modules.pop("os").__dict__
    import os

    part.pop("__getattr__", None)
    part.update(os.__dict__)
    return getattr(os, name)


# Python 3.6 asks no module for what it lacks.
if __name__ == "__main__" and sys.version_info >= (3, 7) and "os" not in sys.modules:
    take_part_of_os()
import os  # noqa: E402

try:
    # Packages importlib and importlib.machinery: 1 ms.
    from _frozen_importlib import ModuleSpec
except ImportError:
    from importlib.machinery import ModuleSpec

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, BinaryIO, Dict, List, Optional, Tuple, Union

    # Inode, size, and times of modification and of change of a file, in ns.
    Fingerprint = Tuple[int, ...]
    # Code by the name of its module, None for a package; and what is no module. Until it is needed, the bytes
    # of name -> code of all modules that are needed together.
    Bundle = Dict[str, Any]

PACKAGE = "edgectl_agent"
# The keys of a bundle that are no modules: the fingerprint that the agent's file had when its hash was
# checked; module -> the modules that its code imports when it runs, each after those that it imports itself,
# and Python's own libraries in C among them.
FINGERPRINT, NEEDS = "", "*"
OLDEST_PYTHON = (3, 6)


def compute_sha256(data: bytes) -> str:
    """Compute the digest in hexadecimal."""
    try:
        # Module hashlib loads OpenSSL: 4 ms.
        if sys.version_info >= (3, 12):
            from _sha2 import sha256
        else:
            from _sha256 import sha256
    except ImportError:
        from hashlib import sha256
    return str(sha256(data).hexdigest())


def compute_frame_digest(payload: bytes) -> str:
    """Compute the digest of a reply: BLAKE2b, which the stub has loaded already, else SHA-256."""
    try:
        from _blake2 import blake2b

        return str(blake2b(payload, digest_size=32).hexdigest())
    except (ImportError, ValueError):
        return compute_sha256(payload)


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
        """Send the one reply: ``edgectl-frame marker length digest``, then the bytes."""
        head = "\nedgectl-frame %s %d %s\n" % (self.marker, len(payload), compute_frame_digest(payload))
        self.write(head.encode() + payload + b"\n")


def make_private_dir(path: str) -> None:
    """Create ``path`` as a directory of this user alone.

    OSError where it is a link, has another owner, or others may write.
    """
    try:
        os.mkdir(path, 0o700)
    except FileExistsError:
        pass
    except FileNotFoundError:
        os.makedirs(path, 0o700, exist_ok=True)
    check_private_dir(path)


def is_own_dir(info: os.stat_result) -> bool:
    """Whether this is the state of a directory of this user."""
    # S_ISDIR without module stat, which takes 30 us.
    return info.st_mode & 0o170000 == 0o040000 and info.st_uid == os.geteuid()


def is_dir(path: str) -> bool:
    """Whether there is a directory, or a link to one: os.path.isdir without that module."""
    return os.access(path + "/", os.F_OK)


def make_absolute(path: str) -> str:
    """Make a path absolute, without ``//``, ``.`` and ``..``."""
    is_plain = path[:1] == "/" and {"", ".", ".."}.isdisjoint(path[1:].split("/"))
    return path if is_plain else os.path.abspath(path)


def check_private_dir(path: str) -> None:
    """OSError unless ``path`` is a directory of this user that no other may write.

    Read access of others is removed.
    """
    info = os.lstat(path)
    if not is_own_dir(info) or info.st_mode & 0o022:
        raise PermissionError(1, "not a private directory of this user (mode 0700)", path)
    if info.st_mode & 0o077:
        os.chmod(path, 0o700)


def unpack_agent(sent: bytes) -> bytes:
    """Unpack an agent that was sent; nothing is left of one that arrived damaged."""
    if not sent:
        return b""
    import zlib

    try:
        return zlib.decompress(sent)
    except zlib.error:
        return b""


def find_cached_agent(bases: "List[str]", sha: str, bundle: "Bundle") -> "Optional[str]":
    """Find the directory of the agent cached under its hash; None where it is missing or was changed.

    It is not read where ``bundle`` knows the present fingerprint of the file: a change of the file changes a
    time in its inode, which no user can set. An old fingerprint is removed.
    """
    for base in bases:
        folder = base + "/agent"
        path = "%s/%s.pyz" % (folder, sha)
        try:
            check_private_dir(base)
            check_private_dir(folder)
            if take_fingerprint(os.lstat(path)) == bundle.get(FINGERPRINT):
                return folder
            bundle.pop(FINGERPRINT, None)
            if compute_sha256(read_file(path)[0]) == sha:
                return folder
        except OSError:
            continue
    return None


def take_fingerprint(info: os.stat_result) -> "Fingerprint":
    """Take from the state of a file what changes with its content."""
    return info.st_ino, info.st_size, info.st_mtime_ns, info.st_ctime_ns


def read_file(path: str) -> "Tuple[bytes, Fingerprint]":
    """Read a file that is no link. Raises OSError."""
    fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    with open(fd, "rb", 0) as file:
        return file.read(), take_fingerprint(os.fstat(fd))


def find_library(name: str) -> str:
    """Find the file of one of Python's own libraries in C; empty where it is built in, or none."""
    # A Python that is linked statically has no suffix, and none of the functions below.
    for suffix in extension_suffixes()[:1]:
        path = "%s/%s%s" % (sys.path[-1], name, suffix)
        if os.access(path, os.F_OK):
            return path
    return ""


def load_library(name: str) -> None:
    """Load a library as an import does it, which looks in several folders before: 80 us."""
    path = find_library(name)
    # Where it is gone, the module that imports it knows what to do.
    if path:
        from _imp import create_dynamic, exec_dynamic

        module = create_dynamic(ModuleSpec(name, None, origin=path))
        exec_dynamic(module)
        sys.modules[name] = module


class AgentImporter:
    """Finder and loader of the agent's modules for ``sys.meta_path``.

    ``bundle`` grows by what is compiled from the agent: the bytes that were sent, else the file in
    ``folder``, read when it is needed. Its hash is checked before.
    """

    def __init__(self, sha: str, key: str, folder: "Optional[str]", agent: bytes, bundle: "Bundle") -> None:
        self.sha, self.key, self.folder, self.agent, self.bundle = sha, key, folder, agent, bundle
        # Code that other operations have compiled.
        self.spare: "Bundle" = {}
        self.sources: "Dict[str, memoryview]" = {}
        self._needs: "Dict[str, List[str]]" = bundle.setdefault(NEEDS, {})
        # Names of modules, in the order in which their code was done, and of the libraries that they import.
        self._ran: "List[str]" = []

    def find_spec(self, name: str, _path: object = None, _target: object = None) -> "Optional[ModuleSpec]":
        """Find the spec of a module of the agent; None for any other module."""
        if name.split(".")[0] != PACKAGE:
            if find_library(name):
                self._ran.append(name)
            return None
        if name not in self.bundle and not self.compile_module(name):
            return None
        # Packages of the agent have no code, so nothing is loaded: 0.1 to 0.2 ms of CPU each.
        package = self.bundle[name] is None
        return ModuleSpec(name, None if package else self, is_package=package)  # type: ignore[arg-type]

    def create_module(self, _spec: ModuleSpec) -> None:
        """Leave the creation to Python."""
        return None  # noqa: RET501, PLR1711 - the docstring does not travel

    def exec_module(self, module: "Any") -> None:
        """Run the code of a module, after that of the modules which it imports."""
        name = module.__name__
        for each in self._needs.get(name, ()):
            if each not in sys.modules:
                make = self._make_module if each.startswith(PACKAGE) else load_library
                make(each)
        if isinstance(self.bundle[name], memoryview):
            self._unmarshal(self.bundle[name])
        done = len(self._ran)
        exec(self.bundle[name], module.__dict__)  # noqa: S102 - its seal or hash was checked
        self._needs.setdefault(name, self._ran[done:])
        self._ran.append(name)

    def _unmarshal(self, joined: memoryview) -> None:
        """Put the code of modules that are needed together in the place of their bytes."""
        for name, code in marshal.loads(joined).items():  # noqa: S302 - sealed
            for place in (self.bundle, self.spare):
                if place.get(name) is joined:
                    place[name] = code

    def _make_module(self, name: str) -> None:
        """Make a module without Python's import, which takes 15 us more. ImportError: there is none."""
        if name not in self.bundle and not self.compile_module(name):
            raise ImportError("the agent has no module " + name)
        parent, _, last = name.rpartition(".")
        if parent and parent not in sys.modules:
            self._make_module(parent)
        module = sys.modules[name] = type(sys)(name)
        if self.bundle[name] is None:
            module.__dict__.update(__package__=name, __path__=[])
        else:
            module.__dict__.update(__package__=parent, __loader__=self)
            try:
                self.exec_module(module)
            except BaseException:
                del sys.modules[name]
                raise
        if parent:
            setattr(sys.modules[parent], last, module)

    def load(self, name: str) -> "Any":
        """Load a module by its name in the agent."""
        name = PACKAGE + "." + name
        if name not in sys.modules:
            self._make_module(name)
        return sys.modules[name]

    def read_sources(self) -> "Dict[str, memoryview]":
        """Read file name -> source of the agent. ImportError where its hash is another."""
        if not self.sources:
            if self.folder and not self.agent:
                self.agent = read_file("%s/%s.pyz" % (self.folder, self.sha))[0]
            if compute_sha256(self.agent) != self.sha:
                raise ImportError("the agent is damaged on this host")
            self.sources = read_archive(self.agent)
        return self.sources

    def compile_module(self, name: str) -> bool:
        """Add a module to the bundle; False where the agent has none of this name."""
        path = name.replace(".", "/")
        if path + "/__init__.py" in self.read_sources():
            self.bundle[name] = None
        elif name in self.spare:
            self.bundle[name] = self.spare[name]
        elif path + ".py" in self.sources:
            # Without docstrings and asserts, which half of the size would be.
            self.bundle[name] = compile(self.sources[path + ".py"], path + ".py", "exec", 0, True, 2)
        return name in self.bundle


def read_archive(agent: bytes) -> "dict[str, memoryview]":
    """Read file name -> content of a zip archive whose members are stored, not compressed.

    No copies: an agent that stays would keep their memory.
    """
    found, at, view = {}, 0, memoryview(agent)
    while agent[at : at + 4] == b"PK\x03\x04":
        size = int.from_bytes(agent[at + 18 : at + 22], "little")
        name_end = at + 30 + int.from_bytes(agent[at + 26 : at + 28], "little")
        start = name_end + int.from_bytes(agent[at + 28 : at + 30], "little")
        found[agent[at + 30 : name_end].decode()] = view[start : start + size]
        at = start + size
    return found


def split_code(code: "Union[bytes, memoryview]") -> "Bundle":
    """Split a file of code, as ``cache.py`` joined it: no module is unmarshalled before it is needed."""
    if not code:
        return {}
    size = int.from_bytes(code[-4:], "little")
    fingerprint, needs, places = marshal.loads(code[-4 - size :])  # noqa: S302 - sealed
    bundle: "Bundle" = {}
    parts: "Dict[Tuple[int, int], Any]" = {(0, 0): None}
    for name, span in places:
        if span not in parts:
            parts[span] = code[slice(*span)]
        bundle[name] = parts[span]
    bundle.update({FINGERPRINT: fingerprint, NEEDS: needs})
    return bundle


def boot_agent(
    stdin: "BinaryIO", words: "List[bytes]", places: "List[bytes]", code: "Union[bytes, memoryview]"
) -> None:
    """Serve the one request on ``stdin``, after its line of ``words``.

    ``places``: the state directories of this host. ``code``: sealed by this manager, empty for none.
    """
    marker, sha, request_length, agent_length, timeout, key, operation = b" ".join(words).decode().split()
    coding = sys.getfilesystemencoding()
    bases = [make_absolute(place.decode(coding, "surrogateescape")) for place in places]
    bundle = split_code(code)
    os.umask(0o077)
    channel = Channel(marker)
    version = '"python": "%d.%d.%d"' % sys.version_info[:3]
    if sys.version_info < OLDEST_PYTHON:
        return channel.reply(('{%s, "too_old": true}' % version).encode())
    # The manager's deadline ends this side too: nothing lingers after it has given up.
    signal.setitimer(signal.ITIMER_REAL, float(timeout))
    request, agent = stdin.read(int(request_length)), unpack_agent(stdin.read(int(agent_length)))
    folder = None if agent else find_cached_agent(bases, sha, bundle)
    if folder is None and compute_sha256(agent) != sha:
        return channel.reply(('{%s, "missing": true}' % version).encode())
    importer = AgentImporter(sha, key, folder, agent, bundle)
    sys.meta_path.insert(0, importer)
    sys.modules[PACKAGE + ".link.boot"] = sys.modules[__name__]
    known = len(bundle) if FINGERPRINT in bundle else 0
    if agent or not code:
        importer.load("link.cache").prepare_cache(importer, bases)
    importer.load("link.main").serve_request(request, channel, bases)
    if importer.folder and len(bundle) != known:
        importer.load("link.cache").write_bundle(importer, operation)
    return None
