# SPDX-License-Identifier: Apache-2.0
"""First program of a request: run the code that an earlier request of its operation has compiled.

It is compiled at each request, 10 us of CPU for a line, so it has the usual case alone: what it does not
find, ``stub.py`` looks for, which travels compressed with ``boot.py``. Of modules that are not built in it
needs ``_blake2`` alone. What it reads stays bytes, which ``boot.py`` decodes. Nothing imports it.
"""

import marshal
import posix
import sys

names, stdin = posix.environ, sys.stdin.buffer
programs = stdin.read(int(stdin.readline()))
words = stdin.readline().split()
# Where there is no HOME, nothing is found so, and stub.py replaces the ~.
home = names.get(b"XDG_STATE_HOME") or names.get(b"HOME", b"~") + b"/.local/state"
base = names.get(b"EDGECTL_STATE_DIR") or home + b"/edgectl"
# The state directories of this host, best first; the second is for homes that cannot be written.
# Its owner and mode are checked before use.
places = [base, b"/dev/shm/edgectl-%d" % posix.geteuid()]  # noqa: S108
try:
    import _imp

    if not _imp.is_builtin("_blake2"):
        # As an import does it, which lists the folder of the libraries before: 0.1 ms.
        from _frozen_importlib import ModuleSpec

        path = sys.path[-1] + "/_blake2" + _imp.extension_suffixes()[0]
        sys.modules["_blake2"] = _imp.create_dynamic(ModuleSpec("_blake2", None, origin=path))
        _imp.exec_dynamic(sys.modules["_blake2"])
    from _blake2 import blake2b

    key, version = words[5], b"%x" % sys.hexversion
    folder = blake2b(key=key, salt=version).hexdigest()[:8].encode()
    file = b"%s/agent/%s/%s/%s.%s.code" % (base, words[1], folder, words[6], version)
    fd = posix.open(file, posix.O_RDONLY)
    # Slices of it are no copies: each takes 0.1 ms.
    data = memoryview(posix.read(fd, 1 << 22))
    posix.close(fd)
    found = data[64:]
    if data[:64] != blake2b(found, key=key, salt=version, person=words[6]).digest():
        raise ValueError  # noqa: TRY301 - as short as it can be
    # The first of what is in the file.
    boot = marshal.loads(found)  # noqa: S302 - sealed
except Exception:  # noqa: BLE001 - whatever is unusual here, stub.py is ready for it
    import zlib

    stub, boot = zlib.decompress(programs).split(b"\0")
    exec(stub)  # noqa: S102 - sent
exec(boot)  # noqa: S102 - sealed, or sent
boot_agent(stdin, words, places, found)  # type: ignore[name-defined] # noqa: F821 - of the boot program
# The end of the interpreter would take 2 ms of CPU.
posix._exit(0)  # noqa: SLF001 - its name
