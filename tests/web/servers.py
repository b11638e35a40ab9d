# SPDX-License-Identifier: Apache-2.0
"""The server of the page in this process, over documents that the test makes."""

import contextlib
import http.client
import threading
from collections.abc import Callable, Iterator
from http.server import ThreadingHTTPServer

from edgectl.formats.document import Document
from edgectl.web.feed import FleetFeed
from edgectl.web.server import bind_page_server
from tests.pace import patience


@contextlib.contextmanager
def run_page_server(
    make: Callable[[], Document], *, token: str | None = None, every: float = 0.05
) -> Iterator[tuple[ThreadingHTTPServer, FleetFeed]]:
    """The server on a free port of this machine, and its feed."""
    feed = FleetFeed(make, every=every)
    made = bind_page_server(("127.0.0.1", 0), feed, token)
    # No result may depend on the speed of this machine.
    made.RequestHandlerClass.timeout = patience(60)  # type: ignore[attr-defined]
    threads = [
        threading.Thread(target=feed.run),
        threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.05}),
    ]
    for thread in threads:
        thread.start()
    try:
        yield made, feed
    finally:
        feed.stop()
        made.shutdown()
        for thread in threads:
            thread.join(patience(60))
        made.server_close()


def fetch(
    made: ThreadingHTTPServer, path: str, method: str = "GET", **headers: str
) -> tuple[int, dict[str, str], bytes]:
    """Status, headers (keys in lower case) and body of one request; ``_`` in a key stands for ``-``."""
    line = http.client.HTTPConnection("127.0.0.1", made.server_port, timeout=patience(60))
    with contextlib.closing(line):
        line.request(method, path, headers={key.replace("_", "-"): value for key, value in headers.items()})
        answer = line.getresponse()
        return answer.status, {key.lower(): value for key, value in answer.getheaders()}, answer.read()
