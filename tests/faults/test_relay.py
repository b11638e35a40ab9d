# SPDX-License-Identifier: Apache-2.0
"""Tests of the TCP relay: effect at each byte, no thread or socket left."""

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.relay import Relay, run_relay


@pytest.fixture
def echo() -> Iterator[tuple[str, int]]:
    """A server that echoes its input."""

    def serve(peer: socket.socket) -> None:
        with peer:
            while True:
                try:
                    data = peer.recv(4096)
                    if not data:
                        return
                    peer.sendall(data)
                except OSError:
                    return

    def accept() -> None:
        while True:
            try:
                peer, _ = listener.accept()
            except OSError:
                return
            threads.append(threading.Thread(target=serve, args=(peer,)))
            threads[-1].start()

    threads: list[threading.Thread] = []
    listener = socket.create_server(("127.0.0.1", 0))
    threads.append(threading.Thread(target=accept))
    threads[0].start()
    yield listener.getsockname()
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()
    for thread in threads:
        thread.join(5)


@pytest.fixture
def relay(echo: tuple[str, int]) -> Iterator[Relay]:
    with run_relay(echo) as running:
        yield running
    assert not any(thread.name.startswith("relay") for thread in threading.enumerate())


def connect_to_relay(relay: Relay) -> socket.socket:
    return socket.create_connection((relay.address, relay.port), timeout=30)


def receive_exactly(sock: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count and (more := sock.recv(count - len(data))):
        data += more
    return data


def receive_first_byte(relay: Relay) -> bytes:
    with connect_to_relay(relay) as sock:
        return receive_exactly(sock, 1)


def test_pass(relay: Relay) -> None:
    message = bytes(range(256)) * 4000
    with connect_to_relay(relay) as sock:
        sender = threading.Thread(target=sock.sendall, args=(message,))
        sender.start()
        assert receive_exactly(sock, len(message)) == message
        sender.join()
    assert relay.passed == 2 * len(message)


def test_end_of_input_reaches_the_other_side(relay: Relay) -> None:
    with connect_to_relay(relay) as sock:
        sock.sendall(b"last words")
        sock.shutdown(socket.SHUT_WR)
        assert receive_exactly(sock, 100) == b"last words"


def test_delay(relay: Relay) -> None:
    relay.set(LinkFault(kind=LinkFaultKind.DELAY, seconds=0.2))
    with connect_to_relay(relay) as sock:
        begun = time.monotonic()
        sock.sendall(b"x")
        assert receive_exactly(sock, 1) == b"x"
        assert 0.4 <= time.monotonic() - begun < 15


def test_black_hole_after_byte_k(relay: Relay) -> None:
    relay.set(LinkFault(kind=LinkFaultKind.BLACK_HOLE, after=14))
    with connect_to_relay(relay) as sock:
        sock.sendall(b"0123456789")
        assert receive_exactly(sock, 4) == b"0123"
        sock.settimeout(0.3)
        with pytest.raises(TimeoutError):
            sock.recv(1)
        assert relay.fired
        relay.heal()
        sock.settimeout(30)
        with pytest.raises(ConnectionResetError):
            sock.recv(1)


@pytest.mark.parametrize(
    ("kind", "far_hears", "near_hears"),
    [(LinkFaultKind.ANSWERS_LOST, b"0123456789", b""), (LinkFaultKind.REQUESTS_LOST, b"", b"answer")],
)
def test_one_direction_is_lost(kind: LinkFaultKind, far_hears: bytes, near_hears: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, run_relay(server.getsockname()) as relay:
        relay.set(LinkFault(kind=kind))
        with connect_to_relay(relay) as near:
            far, _ = server.accept()
            with far:
                near.sendall(b"0123456789")
                far.sendall(b"answer")
                for sock, wanted in ((far, far_hears), (near, near_hears)):
                    sock.settimeout(30 if wanted else 0.3)
                    if wanted:
                        assert receive_exactly(sock, len(wanted)) == wanted
                    else:
                        with pytest.raises(TimeoutError):
                            sock.recv(1)


def test_a_half_open_connection_is_never_ended_on_the_far_side() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, run_relay(server.getsockname()) as relay:
        relay.set(LinkFault(kind=LinkFaultKind.BLACK_HOLE, after=4, half_open=True))
        with connect_to_relay(relay) as sock:
            far, _ = server.accept()
            sock.sendall(b"0123456789")
            assert receive_exactly(far, 4) == b"0123"
            relay.heal()
            with pytest.raises(ConnectionResetError):
                sock.recv(1)
        with far:
            far.settimeout(0.3)
            far.sendall(b"still here?")
            with pytest.raises(TimeoutError):
                far.recv(1)
        with connect_to_relay(relay) as sock:
            far, _ = server.accept()
            with far:
                sock.sendall(b"again")
                assert receive_exactly(far, 5) == b"again"


@pytest.mark.parametrize("kind", [LinkFaultKind.CUT_FIN, LinkFaultKind.CUT_RST])
def test_cut_after_byte_k(relay: Relay, kind: LinkFaultKind) -> None:
    relay.set(LinkFault(kind=kind, after=13))
    with connect_to_relay(relay) as sock:
        sock.sendall(b"0123456789")
        if kind is LinkFaultKind.CUT_FIN:
            assert receive_exactly(sock, 10) == b"012"
        else:
            with pytest.raises(ConnectionResetError):
                receive_exactly(sock, 10)
    with connect_to_relay(relay) as sock:
        sock.sendall(b"again")
        assert receive_exactly(sock, 5) == b"again"


def test_a_lasting_cut_refuses_what_comes_later(relay: Relay) -> None:
    relay.set(LinkFault(kind=LinkFaultKind.CUT_FIN, after=3, lasting=True))
    with connect_to_relay(relay) as sock:
        sock.sendall(b"0123456789")
        assert receive_exactly(sock, 10) == b""
    with pytest.raises(ConnectionRefusedError):
        connect_to_relay(relay)
    relay.heal()
    connect_to_relay(relay).close()


def test_garble_byte_k_only(relay: Relay) -> None:
    relay.set(LinkFault(kind=LinkFaultKind.GARBLE, after=12))
    with connect_to_relay(relay) as sock:
        sock.sendall(b"0123456789")
        assert receive_exactly(sock, 10) == b"01" + bytes([ord("2") ^ 0x55]) + b"3456789"
        sock.sendall(b"more")
        assert receive_exactly(sock, 4) == b"more"


def test_mute_accepts_and_says_nothing(relay: Relay) -> None:
    relay.set(LinkFault(kind=LinkFaultKind.MUTE))
    with connect_to_relay(relay) as sock:
        sock.sendall(b"hello")
        sock.settimeout(0.3)
        with pytest.raises(TimeoutError):
            sock.recv(1)


def test_refuse_resets_and_refuses(relay: Relay) -> None:
    with connect_to_relay(relay) as sock:
        sock.sendall(b"x")
        assert receive_exactly(sock, 1) == b"x"
        relay.set(LinkFault(kind=LinkFaultKind.REFUSE))
        with pytest.raises(ConnectionResetError):
            sock.recv(1)
    with pytest.raises(ConnectionRefusedError):
        connect_to_relay(relay)
    relay.heal()
    connect_to_relay(relay).close()


def test_a_dead_target_is_a_reset(echo: tuple[str, int]) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        with run_relay(unused.getsockname()) as relay, pytest.raises(ConnectionResetError):
            receive_first_byte(relay)
