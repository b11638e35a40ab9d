# SPDX-License-Identifier: Apache-2.0
"""The cables of the measurement over slow lines: they delay, lose and slow down what they carry (root)."""

import os
import socket
import threading
import time
from pathlib import Path

import pytest

from tests.pace import patience
from tests.slow_links.cable import Line, run_cables, run_in_netns

LONG_S = patience(30.0)


def send_and_hear_back(manager: Path, hosts: Path, data: bytes) -> float:
    """Seconds from the beginning of a TCP connection until its peer has read ``data`` and said so."""
    listener = run_in_netns(hosts, lambda: socket.create_server(("10.234.0.2", 0)))

    def serve() -> None:
        line, _ = listener.accept()
        with line:
            left = len(data)
            while left:
                left -= len(line.recv(65536))
            line.sendall(b"all")

    server = threading.Thread(target=serve, daemon=True)
    server.start()

    def send() -> float:
        began = time.monotonic()
        with socket.create_connection(listener.getsockname(), timeout=LONG_S) as line:
            line.settimeout(LONG_S)
            line.sendall(data)
            assert line.recv(3) == b"all"
        return time.monotonic() - began

    try:
        return run_in_netns(manager, send)
    finally:
        server.join(LONG_S)
        listener.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root")
def test_a_cable_delays_loses_and_slows_down() -> None:
    with run_cables(1) as (manager, hosts, cables):
        # A connection, data and an answer: two ways there and back, of which only the least time is certain.
        cables.line = Line(delay_s=0.2)
        assert send_and_hear_back(manager, hosts, b"x") >= 0.8
        cables.line = Line(bits_per_s=256e3)
        assert send_and_hear_back(manager, hosts, bytes(32_000)) >= 0.9
        sent = []
        for line in (Line(), Line(loss=0.1)):
            cables.line, before = line, cables.ways[0].passed_bytes
            send_and_hear_back(manager, hosts, bytes(400_000))
            sent.append(cables.ways[0].passed_bytes - before)
        assert sent[1] > sent[0] + 10_000, "what was lost is sent again"
