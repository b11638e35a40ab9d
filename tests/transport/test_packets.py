# SPDX-License-Identifier: Apache-2.0
"""Packets of an SSH connection: their MACs are made and compared by the library, not in Python."""

import hashlib
import os
import socket
from collections.abc import Callable, Iterator
from typing import Any

import paramiko
import pytest
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from paramiko.common import cMSG_IGNORE
from paramiko.packet import Packetizer

# For its effect on the packets of paramiko.
import edgectl.transport.ssh_client  # noqa: F401
from edgectl.transport.sockets import TunedSocket
from tests.call_count import count_calls

KEY, COUNTER = b"k" * 32, b"c" * 16
# Calls in Python for one packet; by the functions of paramiko 156 (SHA-256) and 11.
MOST_RECEIVED, MOST_SENT = 30, 9


def use_key(end: Packetizer, digest: Callable[..., Any], key: bytes = KEY) -> None:
    """Encrypt with `KEY` and sign with ``key`` in both directions, as the usual algorithms do."""
    made: Any = Cipher(algorithms.AES(KEY), modes.CTR(COUNTER))
    any_end: Any = end
    size = digest().digest_size
    any_end.set_outbound_cipher(made.encryptor(), 16, digest, size, key, sdctr=True)
    any_end.set_inbound_cipher(made.decryptor(), 16, digest, size, key)


@pytest.fixture(params=[hashlib.sha256, hashlib.sha512])
def packetizers(request: pytest.FixtureRequest) -> Iterator[tuple[Packetizer, Packetizer]]:
    """Two ends of a connection with one key."""
    ours, theirs = socket.socketpair()
    with TunedSocket(fileno=ours.detach()) as one, theirs:
        ends = Packetizer(one), Packetizer(theirs)
        for end in ends:
            use_key(end, request.param)
        yield ends


def build_message() -> paramiko.Message:
    """A message of some hundred bytes."""
    message = paramiko.Message()
    message.add_byte(cMSG_IGNORE)
    message.add_string(os.urandom(130))
    return message


def test_packets_arrive_and_take_few_calls(
    packetizers: tuple[Packetizer, Packetizer],
) -> None:
    ours, theirs = packetizers
    for sent in (build_message() for _ in range(3)):
        theirs.send_message(sent)
        got: list[paramiko.Message] = []
        received = count_calls(lambda: got.append(ours.read_message()[1]))  # noqa: B023 - called at once
        assert got[0].asbytes() == sent.asbytes()[1:]
        assert received["constant_time_bytes_eq"] == 0
        assert received.total() <= MOST_RECEIVED, received
        answer = build_message()
        said = count_calls(lambda: ours.send_message(answer))  # noqa: B023 - called at once
        assert said["__init__"] == 0, "no object for the MAC"
        assert said.total() <= MOST_SENT, said
        theirs.read_message()


def test_a_packet_that_was_changed_is_refused(
    packetizers: tuple[Packetizer, Packetizer],
) -> None:
    ours, theirs = packetizers
    # The packet is encrypted as it should be, and signed with another key.
    use_key(ours, hashlib.sha256)
    use_key(theirs, hashlib.sha256, b"x" * 32)
    theirs.send_message(build_message())
    with pytest.raises(paramiko.SSHException, match="Mismatched MAC"):
        ours.read_message()
