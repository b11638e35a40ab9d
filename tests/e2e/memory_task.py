# SPDX-License-Identifier: Apache-2.0
"""A task that keeps text in memory: ``serve SOCKET`` holds it, ``save SOCKET`` prints it, ``load SOCKET`` replaces it.

``serve`` appends a line to its text for each ``add``, so a test can see which instance has which memory.
"""

import socket
import sys
from pathlib import Path

BLOCK = 1 << 16


def serve(path: str) -> None:
    memory = bytearray()
    Path(path).unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
        server.bind(path)
        server.listen(8)
        while True:
            peer, _ = server.accept()
            with peer, peer.makefile("rwb") as stream:
                match stream.readline().split():
                    case [b"save"]:
                        stream.write(memory)
                    case [b"load"]:
                        memory[:] = stream.read()
                        stream.write(b"ok\n")
                    case [b"add", word]:
                        memory += word + b"\n"
                        stream.write(b"ok\n")


def ask(path: str, head: bytes, source: object = None) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as peer:
        peer.connect(path)
        peer.sendall(head + b"\n")
        while source is not None and (data := source.read(BLOCK)):  # type: ignore[attr-defined]
            peer.sendall(data)
        peer.shutdown(socket.SHUT_WR)
        while data := peer.recv(BLOCK):
            if head != b"load":
                sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    verb, place, *rest = sys.argv[1:]
    if verb == "serve":
        serve(place)
    else:
        ask(place, " ".join([verb, *rest]).encode(), sys.stdin.buffer if verb == "load" else None)
