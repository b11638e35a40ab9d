# SPDX-License-Identifier: Apache-2.0
"""Cache of the agent on its host: the archive, and the code compiled from it, sealed."""

import marshal
import os

from .boot import FINGERPRINT, NEEDS, PACKAGE, AgentImporter, make_private_dir, read_file, split_code
from .stub import SEAL_BYTES, compute_seal, name_code

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import List, Union

    from .boot import Bundle

BOOT, STUB = PACKAGE + ".link.boot", PACKAGE + ".link.stub"
_AGENT_KEPT_S = 30 * 86400


def prepare_cache(importer: AgentImporter, bases: "List[str]") -> None:
    """Keep an agent that was sent, where it can be written, and find the code that other operations have
    compiled.
    """
    if importer.folder is None:
        importer.folder = _cache_agent(bases, importer.sha, importer.agent)
    if importer.folder is not None:
        codes, suffix = os.path.split(_find_code_path(importer, importer.folder, ""))
        try:
            names = os.listdir(codes)
        except OSError:
            names = []
        # In an order that no file system gives: what stays of the memory of each depends on it.
        for name in sorted(names):
            if name.endswith(suffix):
                for module, code in _read_bundle(importer, os.path.join(codes, name)).items():
                    importer.spare.setdefault(module, code)


def write_bundle(importer: AgentImporter, operation: str) -> None:
    """Keep the code of this request for the next one of its operation, where it can be written.

    Each file begins with a seal by the manager's key, which is on no disk of this host: a task of the same
    login can write there, and no code of its own runs.
    """
    # Where it is loaded first, it is none of the modules that the first one of each request needs.
    from .protocol import OP_CONVERSE

    folder = str(importer.folder)
    path = _find_code_path(importer, folder, operation)
    partial = "%s.%d" % (path, os.getpid())
    try:
        agent, fingerprint = read_file(os.path.join(folder, importer.sha + ".pyz"))
        if agent != importer.agent:
            return
        os.makedirs(os.path.dirname(path), 0o700, exist_ok=True)
        fd = _create_file(partial)
    except OSError:
        return
    importer.compile_module(BOOT)
    importer.bundle[FINGERPRINT] = fingerprint
    # What writes code is not needed again until there is more to write; a conversation reads code by it.
    left_out = () if operation == OP_CONVERSE else (STUB, __name__)
    kept = {name: each for name, each in importer.bundle.items() if name not in left_out}
    code = join_code(kept)
    _write_and_rename(fd, partial, path, _compute_seal(importer.key, path, code) + code)


def join_code(bundle: "Bundle") -> bytes:
    """Join the code of modules to one file, each apart: a request unmarshals what it needs (``split_code``).

    The boot program comes first. At the end: the fingerprint of the agent, what each module needs, and where
    each begins and ends, in the order of ``bundle``, and the length of that.
    """
    joined, spans = bytearray(), {}
    names = [name for name in bundle if name not in (FINGERPRINT, NEEDS)]
    for name in sorted(names, key=lambda each: each != BOOT):
        code, begin = bundle[name], len(joined)
        if code is not None:
            # One after the other: an agent that stays would keep the memory of all of them.
            joined += code if isinstance(code, memoryview) else marshal.dumps(code)
            spans[name] = begin, len(joined)
    places = [(name, *spans.get(name, (0, 0))) for name in names]
    index = marshal.dumps((bundle[FINGERPRINT], bundle[NEEDS], places))
    joined += index
    joined += len(index).to_bytes(4, "little")
    return bytes(joined)


def read_code(importer: AgentImporter, operation: str) -> "Bundle":
    """Read the compiled code of an operation; {} where there is none, or its seal is not ours."""
    return _read_bundle(importer, _find_code_path(importer, str(importer.folder), operation))


def _find_code_path(importer: AgentImporter, folder: str, operation: str) -> str:
    """Find the file of an operation's code: ``stub.py`` reads it."""
    return os.path.join(folder, importer.sha, *name_code(importer.key, operation))


def _compute_seal(key: str, path: str, code: "Union[bytes, memoryview]") -> bytes:
    return compute_seal(key.encode(), os.path.basename(path).encode(), code)


def _read_bundle(importer: AgentImporter, path: str) -> "Bundle":
    """Read compiled code; {} where there is none, or its seal is not ours."""
    try:
        data = memoryview(read_file(path)[0])
    except OSError:
        return {}
    if data[:SEAL_BYTES] != _compute_seal(importer.key, path, data[SEAL_BYTES:]):
        return {}
    return split_code(data[SEAL_BYTES:])


def _create_file(path: str) -> int:
    """Open a new file of this user alone."""
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)


def _write_and_rename(fd: int, partial: str, final: str, data: bytes) -> bool:
    """Write ``data`` to a new file and give it its name; False where the file system refuses."""
    try:
        with open(fd, "wb") as file:
            file.write(data)
        os.rename(partial, final)
    except OSError:
        _remove_file(partial)
        return False
    return True


def _cache_agent(bases: "List[str]", sha: str, agent: bytes) -> "str | None":
    """Write the agent for the next request; returns its directory, or None where nothing can be written."""
    for base in bases:
        try:
            make_private_dir(base)
            folder = os.path.join(base, "agent")
            make_private_dir(folder)
            final = os.path.join(folder, sha + ".pyz")
            partial = "%s.%d" % (final, os.getpid())
            fd = _create_file(partial)
        except OSError:
            continue
        if _write_and_rename(fd, partial, final, agent):
            _remove_old_agents(folder)
            return folder
    return None


def _remove_old_agents(folder: str) -> None:
    """Remove agents that were not sent for 30 days: a new version leaves its predecessor behind."""
    import shutil
    import time

    for name in os.listdir(folder):
        path = os.path.join(folder, name)
        try:
            old = os.lstat(path).st_mtime < time.time() - _AGENT_KEPT_S
        except OSError:
            # Another agent has just renamed or removed it.
            continue
        if old:
            shutil.rmtree(path, ignore_errors=True) if os.path.isdir(path) else _remove_file(path)


def _remove_file(path: str) -> None:
    """Remove a file where it exists."""
    try:
        os.unlink(path)
    except OSError:
        pass
