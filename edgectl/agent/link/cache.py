# SPDX-License-Identifier: Apache-2.0
"""Cache of the agent on its host: the archive, and the code compiled from it, sealed."""

import marshal
import os

from .boot import FINGERPRINT, NEEDS, PACKAGE, AgentImporter, make_private_dir, read_file, split_code
from .stub import SEAL_BYTES, compute_seal, name_code

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Dict, List, Set

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
    _write_and_rename(fd, partial, path, compute_seal(importer.key.encode(), operation.encode(), code) + code)


def join_code(bundle: "Bundle") -> bytes:
    """Join the code of modules to one file: a request unmarshals what it needs (``split_code``).

    Modules that are needed together are marshalled together, which shares their names and takes a quarter
    less CPU to unmarshal. The boot program comes first. At the end: the fingerprint of the agent, what each
    module needs, and where each begins and ends, in the order of ``bundle``, and the length of that.
    """
    joined, spans = bytearray(), {}
    for names in _group_modules(bundle):
        begin, code = len(joined), bundle[names[0]]
        # One after the other: an agent that stays would keep the memory of all of them.
        if not isinstance(code, memoryview):
            code = marshal.dumps(code if names == [BOOT] else {name: bundle[name] for name in names})
        joined += code
        spans.update(dict.fromkeys(names, (begin, len(joined))))
    places = [(name, spans.get(name, (0, 0))) for name in bundle if name not in (FINGERPRINT, NEEDS)]
    index = marshal.dumps((bundle[FINGERPRINT], bundle[NEEDS], places))
    joined += index
    joined += len(index).to_bytes(4, "little")
    return bytes(joined)


def _group_modules(bundle: "Bundle") -> "List[List[str]]":
    """Group the modules that have code: the boot program, then each that no other needs, with what it needs.

    Those that were not unmarshalled stay as they were grouped.
    """
    loose: "Set[str]" = set()
    kept: "Dict[int, List[str]]" = {}
    for name, code in bundle.items():
        if isinstance(code, memoryview) and name != BOOT:
            kept.setdefault(id(code), []).append(name)
        elif code is not None and name not in (BOOT, FINGERPRINT, NEEDS):
            loose.add(name)
    groups = [[BOOT]] if BOOT in bundle else []
    # From the last that ran: each comes after those that it needs.
    for name in reversed(list(bundle[NEEDS])):
        group = [each for each in (*bundle[NEEDS][name], name) if each in loose]
        loose.difference_update(group)
        groups += [group] if group else []
    return [*groups, *([name] for name in sorted(loose)), *kept.values()]


def read_code(importer: AgentImporter, operation: str) -> "Bundle":
    """Read the compiled code of an operation; {} where there is none, or its seal is not ours."""
    return _read_bundle(importer, _find_code_path(importer, str(importer.folder), operation))


def _find_code_path(importer: AgentImporter, folder: str, operation: str) -> str:
    """Find the file of an operation's code: ``stub.py`` reads it."""
    return os.path.join(folder, importer.sha, *name_code(importer.key.encode(), operation))


def _read_bundle(importer: AgentImporter, path: str) -> "Bundle":
    """Read compiled code; {} where there is none, or its seal is not ours."""
    try:
        data = memoryview(read_file(path)[0])
    except OSError:
        return {}
    operation = os.path.basename(path).partition(".")[0]
    if data[:SEAL_BYTES] != compute_seal(importer.key.encode(), operation.encode(), data[SEAL_BYTES:]):
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
