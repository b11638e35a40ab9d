# SPDX-License-Identifier: Apache-2.0
"""Second program of a request: find the boot program as an earlier request compiled it, wherever it may be.

``first.py`` runs the text of this file where it has not found that program in the usual directory; ``boot``
then has it as it was sent.
"""

import marshal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Union

SEAL_BYTES = 32


def compute_seal(key: bytes, name: bytes, code: "Union[bytes, memoryview]") -> bytes:
    """Compute the proof that whoever knows ``key`` wrote ``code`` to a file of this name."""
    try:
        # Three times as fast as SHA-256, which takes 0.7 ms for the code of a probe.
        from _blake2 import blake2b

        return blake2b(code, key=blake2b(name, key=key).digest(), digest_size=SEAL_BYTES).digest()
    except (ImportError, ValueError):
        # Not built, or forbidden where only approved algorithms run.
        from hashlib import sha256

        return sha256(key + sha256(name + b"\0" + code).digest()).digest()


def name_code(key: str, operation: str) -> "tuple[str, str]":
    """Name directory and file of an operation's code: of this key, for this version of Python."""
    return compute_seal(key.encode(), b"", b"").hex()[:8], "%s.%x.code" % (operation, sys.hexversion)


def find_code(bases: "list[str]", sha: str, key: str, operation: str) -> "Union[bytes, memoryview]":
    """Find the code of an operation that has the seal of this manager: ``cache.py`` writes it. Else empty."""
    folder, name = name_code(key, operation)
    for base in bases:
        try:
            with open("%s/agent/%s/%s/%s" % (base, sha, folder, name), "rb", 0) as file:
                # Slices of it are no copies: each takes 0.1 ms.
                data = memoryview(file.read())
        except OSError:
            continue
        code = data[SEAL_BYTES:]
        if data[:SEAL_BYTES] == compute_seal(key.encode(), name.encode(), code):
            return code
    return b""


if __name__ == "__main__":
    found = find_code(places, words[1], words[5], words[6])  # type: ignore[name-defined] # noqa: F821 - of ``first.py``
    if found:
        # The first of what is in the file.
        boot = marshal.loads(found)  # noqa: S302 - sealed
