# SPDX-License-Identifier: Apache-2.0
"""One file with the code of the modules that commands import, beside the files that Python keeps (ADR 208).

Python finds, opens and checks a file for each of 450 modules: a tenth of the CPU of a command, and much of
its time on a disk whose files are not in memory yet. A module is taken from here as long as its source has
the times and the size that it had. Python asks less of its own files of code, but an upgrade removes those
with their sources, and not this one.
"""

import contextlib
import marshal
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import MAGIC_NUMBER, cache_from_source
from types import CodeType, ModuleType

# Path of a source, whether it is that of a package, its size (bytes), and when it was written and its inode
# changed (ns since the epoch): an archive can state the first of these times, nobody the second.
Source = tuple[str, bool, int, int, int]
# A module of the file: its source, and where its code begins and ends after the index (bytes).
Entry = tuple[Source, int, int]
# Directory of modules -> when a name was added to it or removed (ns since the epoch); 0: there is none.
Folders = dict[str, int]

_LENGTH_BYTES = 8
_PACKAGE_FILE = "/__init__.py"


class ModuleCache:
    """Finder of modules for ``sys.meta_path``, to stand before all others.

    A module outside of packages is taken from the file only where no directory of ``sys.path`` can have got
    another one of its name since.
    """

    def __init__(self, path: str) -> None:
        """Read the index of the file ``path``. Without one that fits, no module is taken from it."""
        self._path = path
        self._earlier = frozenset(sys.modules)
        self._sys_path = list(sys.path)
        self._folders = {each: _read_time(each) for each in (each or os.getcwd() for each in sys.path)}
        self._fd, self._begin, known, self._entries = _read_index(path)
        if not _is_same_order(known, self._folders):
            self._entries = {}
        changed = [folder for folder, time in self._folders.items() if known.get(folder) != time]
        self._hidden = {name for folder in changed for name in _list_names(folder)}

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of a module that the file has, unchanged; None where Python has to look for it."""
        if name not in self._entries:
            return None
        if path is None:
            if name in self._hidden or sys.path != self._sys_path:
                return None
            path = sys.path
        source, _, _ = self._entries[name]
        place, is_package, *_ = source
        folder = os.path.dirname(place)
        if (os.path.dirname(folder) if is_package else folder) not in path or _read_source(place) != source:
            return None
        spec = ModuleSpec(name, _CachedLoader(name, place, self), origin=place, is_package=is_package)
        spec.has_location, spec.cached = True, self._path
        if spec.submodule_search_locations is not None:
            spec.submodule_search_locations.append(folder)
        return spec

    def read_code(self, name: str) -> bytes:
        """Read the code of a module of the file, as ``marshal`` writes it."""
        _, begin, end = self._entries[name]
        return os.pread(self._fd, end - begin, self._begin + begin)

    def update(self) -> None:
        """Write the file again if modules were imported that were not taken from it.

        It stays as it is where it cannot be written, or Python writes no code either.
        """
        loaded = dict(_list_loaded(self._earlier))
        known = {name: self._entries[name][0] for name in loaded.keys() & self._entries.keys()}
        if sys.dont_write_bytecode or (known == loaded and not loaded.keys() & self._hidden):
            return
        codes = {
            name: (source, self.read_code(name))
            for name, (source, _, _) in self._entries.items()
            if name not in self._hidden and name not in loaded and _read_source(source[0]) == source
        }
        for name, source in loaded.items():
            # What was changed or removed meanwhile may not be code any more.
            with contextlib.suppress(ImportError, OSError, SyntaxError, ValueError):
                code = sys.modules[name].__spec__.loader.get_code(name)  # type: ignore[union-attr]
                codes[name] = source, marshal.dumps(code)
        _replace_file(self._path, _join_codes(self._folders, codes))


class _CachedLoader(SourceFileLoader):
    """Loader of a module whose code is in the file."""

    def __init__(self, name: str, path: str, cache: ModuleCache) -> None:
        super().__init__(name, path)
        self._cache = cache

    def get_code(self, fullname: str) -> CodeType | None:
        """The code; as Python finds it where the file is damaged."""
        try:
            code: CodeType = marshal.loads(self._cache.read_code(fullname))  # noqa: S302 - Python's own form
        except (OSError, ValueError, EOFError, TypeError):
            return super().get_code(fullname)
        return code


def install_module_cache() -> ModuleCache:
    """Let modules that are imported from now on be taken from the file of this Python, beside this module's
    code.
    """
    cache = ModuleCache(cache_from_source(__file__).removesuffix(".pyc") + "-commands.pyc")
    sys.meta_path.insert(0, cache)
    return cache


def _read_index(path: str) -> tuple[int, int, Folders, dict[str, Entry]]:
    """Open the file: its descriptor, where its codes begin, the directories in which the modules were looked
    for, in their order, and the modules.

    There are none in one that is missing, damaged, or of another version of Python.
    """
    fd, length, magic = -1, 0, None
    with contextlib.suppress(OSError, ValueError, EOFError, TypeError, OverflowError):
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        # A number of a damaged file may be larger than all memory.
        length = min(os.fstat(fd).st_size, int.from_bytes(os.pread(fd, _LENGTH_BYTES, 0), "little"))
        magic, folders, entries = marshal.loads(os.pread(fd, length, _LENGTH_BYTES))  # noqa: S302 - Python's own form
    if magic != MAGIC_NUMBER:
        folders, entries = {}, {}
    return fd, _LENGTH_BYTES + length, folders, entries


def _join_codes(folders: Folders, codes: Mapping[str, tuple[Source, bytes]]) -> bytes:
    """The content of the file: the length of the index, the index, and the codes."""
    entries: dict[str, Entry] = {}
    begin = 0
    for name, (source, code) in codes.items():
        entries[name] = source, begin, begin + len(code)
        begin += len(code)
    index = marshal.dumps((MAGIC_NUMBER, folders, entries))
    return b"".join(
        [len(index).to_bytes(_LENGTH_BYTES, "little"), index, *(code for _, code in codes.values())]
    )


def _replace_file(path: str, data: bytes) -> None:
    """Write a file under another name first: who reads it has the whole of it, after a loss of power too."""
    partial = f"{path}.{os.getpid()}"
    with contextlib.suppress(OSError):
        fd = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            with open(fd, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(fd)
            os.replace(partial, path)
        except BaseException:
            os.unlink(partial)
            raise


def _list_loaded(earlier: frozenset[str]) -> Iterator[tuple[str, Source]]:
    """List the modules that Python has imported from sources by itself, except ``earlier`` ones."""
    for name, module in list(sys.modules.items()):
        spec = getattr(module, "__spec__", None)
        if name in earlier or spec is None or spec.name != name or type(spec.loader) is not SourceFileLoader:
            continue
        source = _read_source(spec.origin or "")
        if source is not None:
            yield name, source


def _read_source(place: str) -> Source | None:
    """State the source at ``place`` as it is now; None where there is none."""
    try:
        info = os.stat(place)
    except OSError:
        return None
    return place, place.endswith(_PACKAGE_FILE), info.st_size, info.st_mtime_ns, info.st_ctime_ns


def _read_time(folder: str) -> int:
    try:
        return os.stat(folder).st_mtime_ns
    except OSError:
        return 0


def _is_same_order(known: Folders, folders: Folders) -> bool:
    """Whether the directories of both are searched in the same order."""
    return [each for each in known if each in folders] == [each for each in folders if each in known]


def _list_names(folder: str) -> set[str]:
    """List the names of modules that a directory may have."""
    try:
        return {name.partition(".")[0] for name in os.listdir(folder)}
    except OSError:
        return set()
