# SPDX-License-Identifier: Apache-2.0
"""The metrics server, in this process."""

import contextlib
import select
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.server import ThreadingHTTPServer

import pytest

from edgectl.errors import StateError
from edgectl.export.http_connections import MAX_CONNECTIONS, MAX_PER_PEER
from edgectl.export.metric_samples import MetricsInput
from edgectl.export.prometheus import bind_metrics_server
from tests.export.metrics_inputs import a_metrics_input


def address_of(made: ThreadingHTTPServer) -> tuple[str, int]:
    return "127.0.0.1", made.server_port


@contextlib.contextmanager
def run_server(*, fails: bool = False) -> Iterator[tuple[ThreadingHTTPServer, list[str]]]:
    said: list[str] = []

    def look() -> MetricsInput:
        if fails:
            raise StateError("the disk <is> full")
        return a_metrics_input()

    made = bind_metrics_server(("127.0.0.1", 0), look, said.append)
    # No result here may depend on the speed of this machine.
    made.RequestHandlerClass.timeout = 600.0  # type: ignore[attr-defined]
    thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield made, said
    finally:
        made.shutdown()
        thread.join(60)
        made.server_close()


def connect_from(made: ThreadingHTTPServer, address: str) -> socket.socket:
    """A connection from one of the addresses of this machine."""
    return socket.create_connection(address_of(made), timeout=60, source_address=(address, 0))


def test_more_connections_than_there_is_room_for_are_hung_up_on() -> None:
    with run_server() as (made, _), contextlib.ExitStack() as stack:
        idle = [
            stack.enter_context(connect_from(made, f"127.0.0.{1 + number // MAX_PER_PEER}"))
            for number in range(MAX_CONNECTIONS)
        ]
        with connect_from(made, "127.0.0.99") as late:
            assert late.recv(1) == b""
        assert select.select(idle, [], [], 0)[0] == [], "those before it are still served"
        idle[0].sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
        assert idle[0].recv(15) == b"HTTP/1.0 200 OK"


def test_one_address_does_not_take_all_connections() -> None:
    with run_server() as (made, _), contextlib.ExitStack() as stack:
        for _ in range(MAX_PER_PEER):
            stack.enter_context(connect_from(made, "127.0.0.1"))
        with connect_from(made, "127.0.0.1") as late:
            assert late.recv(1) == b""
        with connect_from(made, "127.0.0.2") as other:
            other.sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
            assert other.recv(15) == b"HTTP/1.0 200 OK"


def test_a_byte_now_and_then_does_not_prolong_a_request() -> None:
    with run_server() as (made, _):
        made.RequestHandlerClass.timeout = 0.4  # type: ignore[attr-defined]
        with socket.create_connection(address_of(made), timeout=60) as slow:
            slow.settimeout(0.05)
            for _ in range(400):
                with contextlib.suppress(ConnectionError):
                    slow.send(b"G")
                try:
                    assert slow.recv(1) == b""
                    break
                except TimeoutError:
                    continue
                except ConnectionError:
                    break
            else:
                pytest.fail("the connection was kept")


def test_a_failure_is_told_to_both_sides_and_steers_no_browser() -> None:
    with run_server(fails=True) as (made, said):
        with pytest.raises(urllib.error.HTTPError) as caught:
            urllib.request.urlopen(f"http://127.0.0.1:{made.server_port}/metrics", timeout=60)
        with caught.value as answer:
            assert answer.code == 503
            assert b"the disk &lt;is&gt; full" in answer.read()
        assert said == ["the disk <is> full"]
