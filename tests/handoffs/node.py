# SPDX-License-Identifier: Apache-2.0
# Hosts may have Python 3.6, so:
# ruff: noqa: PTH103, PTH110, UP032
"""Node of a plain TCP task: sends its name, a number and the time to a subscriber while it is active.

Runs on hosts: Python >= 3.6, standard library, one file. It starts inactive; ``wake`` and ``sleep`` come through
a FIFO, and each is answered through another one once it has taken effect, so that the answer is a proof.
"""

import os
import select
import socket
import sys
import time

PERIOD_S = 0.004


def open_pipe(folder: str, name: str) -> int:
    path = os.path.join(folder, name)  # noqa: PTH118 - as the rest
    if not os.path.exists(path):
        os.mkfifo(path, 0o600)
    return os.open(path, os.O_RDWR | os.O_NONBLOCK)


def run_node(folder: str, name: str, address: str, port: int) -> None:
    os.makedirs(folder, exist_ok=True)
    subscriber = socket.create_connection((address, port))
    subscriber.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    control, answers = open_pipe(folder, "in"), open_pipe(folder, "out")
    active, number = False, 0
    while True:
        heard, _, _ = select.select([control], [], [], PERIOD_S if active else None)
        if heard:
            word = os.read(control, 64).split()[-1]
            active = word == b"wake"
            os.write(answers, word + b"\n")
        if active:
            number += 1
            line = "{} {} {}\n".format(name, number, int(time.monotonic() * 1e9))
            subscriber.sendall(line.encode())


if __name__ == "__main__":
    run_node(sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]))
