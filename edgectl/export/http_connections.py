# SPDX-License-Identifier: Apache-2.0
"""Bounded connections of the HTTP servers: how many at once, and how long a request may take."""

import contextlib
import socket
import threading
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

# Of a request until it is complete, and of its answer once it is made.
REQUEST_TIMEOUT_S = 10.0
# Connections at once, and of these from one address.
MAX_CONNECTIONS, MAX_PER_PEER = 64, 16


class BoundedServer(ThreadingHTTPServer):
    """One thread per connection, up to a maximum in all and for one address; further ones are closed."""

    daemon_threads = True
    request_queue_size = MAX_CONNECTIONS

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._peers: Counter[str] = Counter()
        self._guard = threading.Lock()
        if ":" in address[0]:
            self.address_family = socket.AF_INET6
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Answer in a thread if the maximum is not reached."""
        with self._guard:
            peer = client_address[0]
            free = self._peers.total() < MAX_CONNECTIONS and self._peers[peer] < MAX_PER_PEER
            self._peers[peer] += free
        if free:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Answer, and release the thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._guard:
                self._peers[client_address[0]] -= 1
                self._peers += Counter()  # without the addresses that have none left

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore a client that went away."""


class DeadlineRequestHandler(BaseHTTPRequestHandler):
    """One request, which is complete within ``timeout`` seconds: a byte now and then does not prolong it."""

    timeout = REQUEST_TIMEOUT_S

    def setup(self) -> None:
        """Begin the deadline."""
        super().setup()
        self.begin_deadline()

    def finish(self) -> None:
        """End the deadline."""
        self.end_deadline()
        super().finish()

    def begin_deadline(self) -> None:
        """End the connection after ``timeout`` seconds."""
        self._timer = threading.Timer(self.timeout, _hang_up_socket, (self.connection,))
        self._timer.daemon = True
        self._timer.start()

    def end_deadline(self) -> None:
        """Let the connection live: its answer is being made, or goes on and on."""
        self._timer.cancel()


def _hang_up_socket(line: socket.socket) -> None:
    """End a connection at once, which wakes the thread that reads it."""
    with contextlib.suppress(OSError):
        line.shutdown(socket.SHUT_RDWR)
