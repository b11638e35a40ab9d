# SPDX-License-Identifier: Apache-2.0
"""Hosts and servers that send too much: their own call fails, and the memory of the manager stays small."""

import hashlib
import itertools
import resource
import socket
import subprocess
import sys

import pytest

from edgectl.errors import ReplyError
from edgectl.transport.agent_client import _ChunkReader, find_payload
from edgectl.transport.sockets import MAX_LOGIN_BYTES, MAX_PACKET_BYTES, TunedSocket, TunnelLine
from tests.pace import patience

MARKER = "0" * 32


def nest_frames(count: int) -> bytes:
    """``count`` frames, each with the right digest around the one before."""
    payload = b"{}"
    for _ in range(count):
        digest = hashlib.sha256(payload).hexdigest()
        payload = f"\nedgectl-frame {MARKER} {len(payload)} {digest}\n".encode() + payload
    return payload


def measure_growth() -> None:
    """Print by how many MiB the memory of this process grows while it looks for the payload."""
    reply = nest_frames(1800)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    find_payload(reply, MARKER)
    print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)


def test_thousands_of_frames_within_each_other_take_no_memory() -> None:
    program = "from tests.transport.test_hostile_replies import measure_growth; measure_growth()"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=patience(60), check=True
    )
    assert int(done.stdout) < 50


def test_a_frame_is_what_it_encloses_and_two_that_differ_are_none() -> None:
    one, other = nest_frames(1), nest_frames(1).replace(b"{}", b"[]")
    assert find_payload(one * 2, MARKER) == b"{}"
    assert find_payload(one * 3, MARKER) is None
    assert find_payload(one + other, MARKER) == b"{}"  # the digest of the other is wrong
    assert find_payload(nest_frames(2), MARKER) == one


@pytest.mark.parametrize("kind", [TunedSocket, TunnelLine])
def test_a_packet_that_announces_too_much_ends_the_connection(kind: type) -> None:
    """As if the server had closed: no buffer of that size is ever made."""
    ours, theirs = socket.socketpair()
    with theirs, ours:
        theirs.sendall(b"x" * 1000)
        line = TunedSocket(fileno=ours.detach()) if kind is TunedSocket else TunnelLine(ours)
        assert line.recv(100) == b"x" * 100
        assert line.recv(MAX_PACKET_BYTES) == b"x" * 900
        assert line.recv(1 << 31) == b""
        line.close()


def test_packets_that_came_together_are_fetched_by_one_call() -> None:
    """paramiko asks for the first block of a packet, then for its rest."""
    ours, theirs = socket.socketpair()
    calls = []
    with theirs, ours:
        theirs.sendall(b"".join(b"%02d" % number * 50 for number in range(20)))
        line = TunedSocket(fileno=ours.detach())
        sys.setprofile(lambda _frame, event, what: calls.append(what.__name__) if event == "c_call" else None)
        try:
            found = [line.recv(16) + line.recv(84) for _ in range(20)]
        finally:
            sys.setprofile(None)
        theirs.close()
        assert found == [b"%02d" % number * 50 for number in range(20)]
        assert (calls.count("recv"), calls.count("setsockopt")) == (1, 1)
        assert line.recv(16) == b""
        line.close()


def test_a_server_behind_a_jump_host_may_not_talk_without_end_before_the_login() -> None:
    ours, theirs = socket.socketpair()
    with theirs, ours:
        theirs.setblocking(False)
        line, total = TunnelLine(ours), 0
        for _ in itertools.count():
            theirs.send(b"banner\r\n" * 1000)
            data = line.recv(1 << 16)
            total += len(data)
            if not data:
                break
        assert MAX_LOGIN_BYTES - (1 << 16) <= total <= MAX_LOGIN_BYTES


@pytest.mark.parametrize("stream", [b"x" * 64, b"1" * 64, b"end" * 9, b"9" * 8])
def test_a_log_without_lengths_is_garbled_at_once(stream: bytes) -> None:
    reader = _ChunkReader(MARKER)
    opened = b'{"stream": true}'
    digest = hashlib.sha256(opened).hexdigest()
    list(reader.feed(f"\nedgectl-frame {MARKER} {len(opened)} {digest}\n".encode() + opened + b"\n"))
    with pytest.raises(ReplyError, match="garbled"):
        list(reader.feed(stream))
