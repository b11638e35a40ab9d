"""The relay does what it is told, byte by byte, and leaves no thread or socket behind."""

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from tests.faults.relay import Relay, relaying
from tests.faults.trouble import Kind, Trouble


@pytest.fixture
def echo() -> Iterator[tuple[str, int]]:
    """A server that sends everything back."""

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
    with relaying(echo) as running:
        yield running
    assert not any(thread.name.startswith("relay") for thread in threading.enumerate())


def dial(relay: Relay) -> socket.socket:
    return socket.create_connection((relay.address, relay.port), timeout=30)


def exactly(sock: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count and (more := sock.recv(count - len(data))):
        data += more
    return data


def first_byte(relay: Relay) -> bytes:
    with dial(relay) as sock:
        return exactly(sock, 1)


def test_pass(relay: Relay) -> None:
    message = bytes(range(256)) * 4000
    with dial(relay) as sock:
        sender = threading.Thread(target=sock.sendall, args=(message,))
        sender.start()
        assert exactly(sock, len(message)) == message
        sender.join()
    assert relay.passed == 2 * len(message)


def test_end_of_input_reaches_the_other_side(relay: Relay) -> None:
    with dial(relay) as sock:
        sock.sendall(b"last words")
        sock.shutdown(socket.SHUT_WR)
        assert exactly(sock, 100) == b"last words"


def test_delay(relay: Relay) -> None:
    relay.set(Trouble(kind=Kind.DELAY, seconds=0.2))
    with dial(relay) as sock:
        begun = time.monotonic()
        sock.sendall(b"x")
        assert exactly(sock, 1) == b"x"
        assert 0.4 <= time.monotonic() - begun < 15


def test_black_hole_after_byte_k(relay: Relay) -> None:
    relay.set(Trouble(kind=Kind.BLACK_HOLE, after=14))
    with dial(relay) as sock:
        sock.sendall(b"0123456789")
        assert exactly(sock, 4) == b"0123"
        sock.settimeout(0.3)
        with pytest.raises(TimeoutError):
            sock.recv(1)
        assert relay.fired
        relay.heal()
        sock.settimeout(30)
        with pytest.raises(ConnectionResetError):
            sock.recv(1)


def test_a_half_open_connection_is_never_ended_on_the_far_side() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, relaying(server.getsockname()) as relay:
        relay.set(Trouble(kind=Kind.BLACK_HOLE, after=4, half_open=True))
        with dial(relay) as sock:
            far, _ = server.accept()
            sock.sendall(b"0123456789")
            assert exactly(far, 4) == b"0123"
            relay.heal()
            with pytest.raises(ConnectionResetError):
                sock.recv(1)
        with far:
            far.settimeout(0.3)
            far.sendall(b"still here?")
            with pytest.raises(TimeoutError):
                far.recv(1)
        with dial(relay) as sock:
            far, _ = server.accept()
            with far:
                sock.sendall(b"again")
                assert exactly(far, 5) == b"again"


@pytest.mark.parametrize("kind", [Kind.CUT_FIN, Kind.CUT_RST])
def test_cut_after_byte_k(relay: Relay, kind: Kind) -> None:
    relay.set(Trouble(kind=kind, after=13))
    with dial(relay) as sock:
        sock.sendall(b"0123456789")
        if kind is Kind.CUT_FIN:
            assert exactly(sock, 10) == b"012"
        else:
            with pytest.raises(ConnectionResetError):
                exactly(sock, 10)
    with dial(relay) as sock:
        sock.sendall(b"again")
        assert exactly(sock, 5) == b"again"


def test_a_lasting_cut_refuses_what_comes_later(relay: Relay) -> None:
    relay.set(Trouble(kind=Kind.CUT_FIN, after=3, lasting=True))
    with dial(relay) as sock:
        sock.sendall(b"0123456789")
        assert exactly(sock, 10) == b""
    with pytest.raises(ConnectionRefusedError):
        dial(relay)
    relay.heal()
    dial(relay).close()


def test_garble_byte_k_only(relay: Relay) -> None:
    relay.set(Trouble(kind=Kind.GARBLE, after=12))
    with dial(relay) as sock:
        sock.sendall(b"0123456789")
        assert exactly(sock, 10) == b"01" + bytes([ord("2") ^ 0x55]) + b"3456789"
        sock.sendall(b"more")
        assert exactly(sock, 4) == b"more"


def test_mute_accepts_and_says_nothing(relay: Relay) -> None:
    relay.set(Trouble(kind=Kind.MUTE))
    with dial(relay) as sock:
        sock.sendall(b"hello")
        sock.settimeout(0.3)
        with pytest.raises(TimeoutError):
            sock.recv(1)


def test_refuse_resets_and_refuses(relay: Relay) -> None:
    with dial(relay) as sock:
        sock.sendall(b"x")
        assert exactly(sock, 1) == b"x"
        relay.set(Trouble(kind=Kind.REFUSE))
        with pytest.raises(ConnectionResetError):
            sock.recv(1)
    with pytest.raises(ConnectionRefusedError):
        dial(relay)
    relay.heal()
    dial(relay).close()


def test_a_dead_target_is_a_reset(echo: tuple[str, int]) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        with relaying(unused.getsockname()) as relay, pytest.raises(ConnectionResetError):
            first_byte(relay)
