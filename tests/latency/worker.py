# SPDX-License-Identifier: Apache-2.0
"""Programs of one host: a detector that answers frames, the work of others, and the robot that sends frames.

    python -m tests.latency.worker serve CORE
    python -m tests.latency.worker load CORE RATE SEED WIDTH HEIGHT
    python -m tests.latency.worker robot CORE ADDRESS COUNT WIDTH HEIGHT THINK

Each runs on the core CORE alone. The work is that of tasks/patrol/detection.py.
"""

import contextlib
import importlib
import json
import os
import socket
import struct
import sys
import time
from pathlib import Path
from random import Random
from typing import Any

PORT = 27500
ANSWER_BYTES = 1000
_HEADER = struct.Struct("!II")
_PATIENCE_S = 60.0


def load_detection() -> Any:
    """Import the detection of the patrol."""
    sys.path.insert(0, str(Path(__file__).parents[2] / "tasks/patrol"))
    return importlib.import_module("detection")


def make_frame(width: int, height: int, seed: int) -> bytes:
    """Make a noisy grey picture with three bright balls."""
    random = Random(seed)
    rows = [bytearray(random.randbytes(width)) for _ in range(height)]
    rows = [bytearray(60 + pixel // 16 for pixel in row) for row in rows]
    for _ in range(3):
        reach = height // 20
        middle, line = random.randrange(reach, width - reach), random.randrange(reach, height - reach)
        for row in range(line - reach, line + reach):
            wide = int((reach**2 - (row - line) ** 2) ** 0.5)
            rows[row][middle - wide : middle + wide] = b"\xe6" * (2 * wide)
    return b"".join(bytes(row) for row in rows)


def receive(connection: socket.socket, size: int) -> bytes:
    """Read so many bytes; fewer at the end."""
    parts, left = [], size
    while left:
        part = connection.recv(min(left, 1 << 20))
        if not part:
            break
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def serve() -> None:
    """Answer the frames of one robot with the seconds that each took, until it leaves."""
    detection = load_detection()
    with socket.create_server(("", PORT)) as server:
        print("ready", flush=True)
        connection, _ = server.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    while header := receive(connection, _HEADER.size):
        width, height = _HEADER.unpack(header)
        pixels = receive(connection, width * height)
        began = time.perf_counter()
        detection.detect(pixels, width)
        took = struct.pack("!d", time.perf_counter() - began)
        connection.sendall(took.ljust(ANSWER_BYTES))


def work(rate: float, seed: int, width: int, height: int) -> None:
    """Work on frames that come at random, ``rate`` a second on average, one after the other, for ever."""
    detection, random = load_detection(), Random(seed)
    frame = make_frame(width, height, seed)
    print("ready", flush=True)
    due = time.monotonic()
    while True:
        due += random.expovariate(rate)
        time.sleep(max(0.0, due - time.monotonic()))
        detection.detect(frame, width)


def measure_rtt(address: str) -> float:
    """Measure the time until a port refuses a connection."""
    began = time.perf_counter()
    with contextlib.suppress(ConnectionRefusedError):
        socket.create_connection((address, PORT + 1), timeout=_PATIENCE_S).close()
    return time.perf_counter() - began


def send_frames(address: str, count: int, width: int, height: int, think: float) -> None:
    """Send frames, each after a random pause of ``think`` s on average; print latencies and service times (s)."""
    random = Random(1)
    frames = [make_frame(width, height, seed) for seed in range(8)]
    latencies, services = [], []
    rtt = min(measure_rtt(address) for _ in range(5))
    with socket.create_connection((address, PORT), timeout=_PATIENCE_S) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for number in range(count + 5):
            time.sleep(think * random.uniform(0.25, 1.75))
            began = time.perf_counter()
            connection.sendall(_HEADER.pack(width, height) + frames[number % len(frames)])
            answer = receive(connection, ANSWER_BYTES)
            if number >= 5:  # the first ones open the window of TCP
                latencies.append(time.perf_counter() - began)
                services.append(struct.unpack("!d", answer[:8])[0])
    print(json.dumps({"latencies": latencies, "services": services, "rtt": rtt}))


def main(role: str, core: str, *rest: str) -> None:
    """Run one of the programs."""
    os.sched_setaffinity(0, {int(core)})
    if role == "serve":
        serve()
    elif role == "load":
        work(float(rest[0]), int(rest[1]), int(rest[2]), int(rest[3]))
    else:
        send_frames(rest[0], int(rest[1]), int(rest[2]), int(rest[3]), float(rest[4]))


if __name__ == "__main__":
    main(*sys.argv[1:])
