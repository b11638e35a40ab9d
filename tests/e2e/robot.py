# SPDX-License-Identifier: Apache-2.0
"""Robot that knows which instances control it: each holds a connection, which the kernel closes when its
process ends.

robot.py serve SOCKET RECORD   the robot: one line of JSON every 10 ms: controlling instances, hold state,
                               and requests since
robot.py steer SOCKET READY    an instance of the task: takes control, then makes READY/INSTANCE; on a host
                               named in SOCKET.broken it fails
robot.py WORD SOCKET           hold, release or safe: a hook; safe fails while SOCKET.unsafe exists
"""

import json
import os
import selectors
import socket
import sys
import time
from pathlib import Path

PERIOD_S = 0.01


def main(word: str, path: str, *more: str) -> int:
    if word == "serve":
        return Robot(path, Path(more[0])).serve()
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(path)
        if word != "steer":
            line.sendall(f"{word}\n".encode())
            return 0 if line.recv(16) == b"yes\n" else 1
        if os.environ["EDGECTL_HOST"] in Path(path + ".broken").read_text().split():
            return 3
        line.sendall(f"steer {os.environ['EDGECTL_HOST']}\n".encode())
        assert line.recv(16) == b"yes\n"
        (Path(more[0]) / os.environ["EDGECTL_INSTANCE"]).touch()
        line.recv(16)
    return 0


class Robot:
    """The robot in one thread, so that all its events are ordered."""

    def __init__(self, path: str, record: Path) -> None:
        self.path, self.record = path, record
        self.steering: dict[socket.socket, str] = {}
        self.holds = False
        self.told: list[str] = []
        self.selector = selectors.DefaultSelector()

    def serve(self) -> int:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(self.path)
        listener.listen(16)
        self.selector.register(listener, selectors.EVENT_READ)
        with self.record.open("w", buffering=1) as out:
            while True:
                due = time.monotonic() + PERIOD_S
                while (left := due - time.monotonic()) > 0:
                    for key, _ in self.selector.select(left):
                        self.accept(listener) if key.fileobj is listener else self.hear(key.fileobj)  # type: ignore[arg-type]
                sample = {
                    "t": time.monotonic(),
                    "steer": sorted(self.steering.values()),
                    "holds": self.holds,
                    "told": self.told,
                }
                out.write(json.dumps(sample) + "\n")
                self.told = []

    def accept(self, listener: socket.socket) -> None:
        self.selector.register(listener.accept()[0], selectors.EVENT_READ)

    def hear(self, line: socket.socket) -> None:
        try:  # a hook may be ended at its deadline, before it has read the answer
            self.answer(line)
        except OSError:
            self.drop(line)

    def answer(self, line: socket.socket) -> None:
        word, _, rest = line.recv(256).decode().strip().partition(" ")
        if not word:
            self.drop(line)
            return
        self.told.append(word)
        if word == "steer":
            self.steering[line] = rest
        elif word in ("hold", "release"):
            self.holds = word == "hold"
        no = word == "safe" and Path(self.path + ".unsafe").exists()
        line.sendall(b"no\n" if no else b"yes\n")

    def drop(self, line: socket.socket) -> None:
        self.selector.unregister(line)
        line.close()
        self.told += ["lost"] if self.steering.pop(line, None) else []


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
