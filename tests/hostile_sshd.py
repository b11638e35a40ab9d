# SPDX-License-Identifier: Apache-2.0
"""An SSH server whose login names are attacks: ``python -m tests.hostile_sshd HOST-KEY ADDRESS``.

It prints two ports: of the server, and of one that sends a banner without end. Any key may log in. The name
``honest`` is a host that answers every request of an agent, the others are the keys of ``ATTACKS``.
"""

import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import paramiko
from paramiko.common import (
    cMSG_CHANNEL_DATA,
    cMSG_DEBUG,
    cMSG_GLOBAL_REQUEST,
    cMSG_IGNORE,
)

from edgectl.transport.fake import frame_reply, unpack_request
from tests.transport.test_hostile_replies import nest_frames

# As much as a flood sends at a time, bytes; and how long the slowest attack goes on, s.
_BLOCK, _LONGEST_S = 30_000, 60.0


def _send_messages(transport: Any, kind: bytes, body: bytes) -> None:
    while transport.is_active():
        message = paramiko.Message()
        message.add_bytes(kind + body)
        transport._send_message(message)


def _flood_ignore(transport: paramiko.Transport, _channel: paramiko.Channel) -> None:
    _send_messages(transport, cMSG_IGNORE, struct.pack(">I", _BLOCK) + bytes(_BLOCK))


def _flood_small(transport: paramiko.Transport, _channel: paramiko.Channel) -> None:
    _send_messages(transport, cMSG_IGNORE, struct.pack(">I", 0))


def _flood_debug(transport: paramiko.Transport, _channel: paramiko.Channel) -> None:
    _send_messages(transport, cMSG_DEBUG, b"\1" + struct.pack(">I", _BLOCK) + b"x" * _BLOCK + bytes(4))


def _flood_requests(transport: paramiko.Transport, _channel: paramiko.Channel) -> None:
    _send_messages(transport, cMSG_GLOBAL_REQUEST, struct.pack(">I", 1) + b"x\1")


def _exceed_window(transport: paramiko.Transport, channel: paramiko.Channel) -> None:
    head = struct.pack(">II", channel.remote_chanid, _BLOCK)
    _send_messages(transport, cMSG_CHANNEL_DATA, head + bytes(_BLOCK))


def _flood_rekeys(transport: paramiko.Transport, _channel: paramiko.Channel) -> None:
    while transport.is_active():
        transport.renegotiate_keys()


def _announce_packet(transport: paramiko.Transport, channel: paramiko.Channel) -> None:
    """A packet of 2 GiB, of which as much comes as is taken."""
    packetizer: Any = transport.packetizer
    build = packetizer._build_packet
    packetizer._build_packet = lambda data: struct.pack(">I", 1 << 31) + build(data)[4:]
    channel.send(bytes(_BLOCK))
    packetizer._build_packet = lambda data: data + bytes(-len(data) % 16)
    _flood_ignore(transport, channel)


def _flood_stderr(_transport: paramiko.Transport, channel: paramiko.Channel) -> None:
    while channel.send_stderr(bytes(_BLOCK)):
        pass


def _drip(_transport: paramiko.Transport, channel: paramiko.Channel) -> None:
    end = time.monotonic() + _LONGEST_S
    while time.monotonic() < end and channel.send(b"x"):
        time.sleep(0.02)


def _stay_silent(_transport: paramiko.Transport, _channel: paramiko.Channel) -> None:
    time.sleep(_LONGEST_S)


def _nest(_transport: paramiko.Transport, channel: paramiko.Channel) -> None:
    marker, _ = unpack_request(_read_all(channel))
    channel.sendall(nest_frames(1800).replace(b"0" * 32, marker.encode()))
    channel.close()


def _reply(_transport: paramiko.Transport, channel: paramiko.Channel) -> None:
    marker, request = unpack_request(_read_all(channel))
    channel.sendall(frame_reply(marker, {"v": 1, "op": request["op"], "host": request["host"]}))
    channel.send_exit_status(0)
    channel.close()


def _reply_then_flood(transport: paramiko.Transport, channel: paramiko.Channel) -> None:
    _reply(transport, channel)
    time.sleep(0.2)
    _flood_ignore(transport, channel)


def _read_all(channel: paramiko.Channel) -> bytes:
    data = bytearray()
    while piece := channel.recv(1 << 16):
        data += piece
    return bytes(data)


ATTACKS: dict[str, Callable[[paramiko.Transport, paramiko.Channel], None]] = {
    "debug": _flood_debug,
    "drip": _drip,
    "ignore": _flood_ignore,
    "later": _reply_then_flood,
    "nested": _nest,
    "packet": _announce_packet,
    "rekeys": _flood_rekeys,
    "requests": _flood_requests,
    "silent": _stay_silent,
    "small": _flood_small,
    "stderr": _flood_stderr,
    "window": _exceed_window,
}


class _Login(paramiko.ServerInterface):
    def __init__(self, transport: paramiko.Transport) -> None:
        self._transport = transport
        self._user = ""

    def get_allowed_auths(self, username: str) -> str:
        del username
        return "publickey"

    def check_auth_publickey(self, username: str, key: paramiko.PKey) -> int:
        del key
        self._user = username
        return paramiko.AUTH_SUCCESSFUL  # type: ignore[attr-defined,no-any-return]

    def check_channel_request(self, kind: str, chanid: int) -> int:
        del kind, chanid
        return paramiko.OPEN_SUCCEEDED  # type: ignore[attr-defined,no-any-return]

    def check_channel_exec_request(self, channel: paramiko.Channel, command: bytes) -> bool:
        del command
        threading.Thread(target=self._attack, args=(channel,), daemon=True).start()
        return True

    def _attack(self, channel: paramiko.Channel) -> None:
        with suppress(Exception):
            ATTACKS.get(self._user, _reply)(self._transport, channel)


def _serve(line: socket.socket, key: paramiko.PKey) -> None:
    transport = paramiko.Transport(line)
    transport.add_server_key(key)
    with suppress(Exception):
        transport.start_server(server=_Login(transport))


def _talk(line: socket.socket) -> None:
    with suppress(OSError):
        while True:
            line.sendall(b"no banner yet\r\n" * 1000)


def _listen(address: str, serve: Callable[[socket.socket], None]) -> int:
    listener = socket.create_server((address, 0), backlog=50)

    def accept() -> None:
        while True:
            threading.Thread(target=serve, args=(listener.accept()[0],), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    return int(listener.getsockname()[1])


def main(key_file: str, address: str) -> None:
    """Serve until standard input ends."""
    key = paramiko.Ed25519Key.from_private_key_file(key_file)
    print(_listen(address, lambda line: _serve(line, key)), _listen(address, _talk), flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main(*sys.argv[1:])
