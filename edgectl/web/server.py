# SPDX-License-Identifier: Apache-2.0
"""HTTP server of the page: the page itself, its document, and an event for each newer one."""

import json
import select
from http import HTTPStatus
from http.server import ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

from edgectl.export.http_connections import BoundedServer, DeadlineRequestHandler
from edgectl.web.access import Access, decide_access, derive_cookie, is_equal
from edgectl.web.feed import FleetFeed, Publication
from edgectl.web.page import Page, load_page

# An event comes at least so often: then a viewer that has gone is noticed, and its place is free.
HEARTBEAT_S = 2.0
_COOKIE_AGE_S = 30 * 86400
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
}


def bind_page_server(
    address: tuple[str, int], feed: FleetFeed, token: str | None = None
) -> ThreadingHTTPServer:
    """A server bound to ``address`` that shows what ``feed`` has, to who has the ``token`` (None: to all on
    this machine).

    Raises:
        OSError: the address cannot be bound.
    """
    return BoundedServer(address, type("_Bound", (_PageRequestHandler,), {"feed": feed, "token": token}))


class _PageRequestHandler(DeadlineRequestHandler):
    """One request."""

    server_version = "edgectl"
    sys_version = ""
    feed: FleetFeed
    token: str | None

    def parse_request(self) -> bool:
        """Whether the request can be read and is a GET; nothing here can be changed."""
        if not super().parse_request():
            return False
        if self.command != "GET":
            extra = {"Allow": "GET"}
            self._answer_text(HTTPStatus.METHOD_NOT_ALLOWED, "the page is read-only: GET alone", extra)
            return False
        return True

    def do_GET(self) -> None:  # noqa: N802, the name that http.server calls
        """Answer the page, the document or the events to who may see them."""
        self.end_deadline()
        parts = urlsplit(self.path)
        given = parse_qs(parts.query).get("token", [])
        if given and parts.path == "/" and self.token is not None:
            self._log_in(given[0])
            return
        headers = {key.lower(): value for key, value in self.headers.items()}
        match decide_access(headers, self.token, self._cookie_name):
            case Access.WRONG_HOST:
                self._answer_text(HTTPStatus.MISDIRECTED_REQUEST, "open the page as localhost or 127.0.0.1")
            case Access.DENIED:
                self._deny(parts.path)
            case Access.GRANTED:
                self._answer_path(parts.path)

    def _answer_path(self, path: str) -> None:
        match path:
            case "/":
                self._answer_page(HTTPStatus.OK, load_page("fleet"))
            case "/api/fleet":
                self._answer_document(self.feed.get_latest())
            case "/api/events":
                self._send_events()
            case _:
                self._answer_text(HTTPStatus.NOT_FOUND, "there are /, /api/fleet and /api/events")

    @property
    def _cookie_name(self) -> str:
        """Browsers share cookies between the ports of a host."""
        return f"edgectl-{self.server.server_port}"  # type: ignore[attr-defined]

    def _log_in(self, given: str) -> None:
        """Keep a cookie in the browser, and take the token out of its address line."""
        if self.token is None or not is_equal(given, self.token):
            self._deny("/")
            return
        cookie = f"{self._cookie_name}={derive_cookie(self.token)}; Path=/; HttpOnly; SameSite=Lax"
        extra = {"Location": "/", "Set-Cookie": f"{cookie}; Max-Age={_COOKIE_AGE_S}"}
        self._answer_text(HTTPStatus.SEE_OTHER, "", extra)

    def _deny(self, path: str) -> None:
        if path == "/":
            self._answer_page(HTTPStatus.UNAUTHORIZED, load_page("login"))
        else:
            self._answer_text(HTTPStatus.UNAUTHORIZED, "a token is needed", {"WWW-Authenticate": "Bearer"})

    def _answer_page(self, status: HTTPStatus, page: Page) -> None:
        extra = {"Content-Security-Policy": page.policy, "X-Frame-Options": "DENY"}
        self._answer(status, "text/html; charset=utf-8", page.body, extra)

    def _answer_document(self, latest: Publication) -> None:
        if not latest.version:
            why = latest.error or "the first probe is not done yet"
            self._answer_text(HTTPStatus.SERVICE_UNAVAILABLE, why, {"Retry-After": "1"})
            return
        tag = f'"{id(self.feed):x}-{latest.version}"'
        extra = {"ETag": tag, "Vary": "Accept-Encoding", "Cache-Control": "no-cache, private"}
        if self.headers.get("If-None-Match") == tag:
            self._answer(HTTPStatus.NOT_MODIFIED, "application/json", b"", extra)
            return
        packed = "gzip" in self.headers.get("Accept-Encoding", "")
        if packed:
            extra["Content-Encoding"] = "gzip"
        body = latest.packed if packed else latest.body
        self._answer(HTTPStatus.OK, "application/json", body, extra)

    def _send_events(self) -> None:
        """One event per publication until the viewer goes or the server ends; a slow viewer misses some."""
        self._begin(HTTPStatus.OK, "text/event-stream", {"X-Accel-Buffering": "no"})
        latest = self.feed.get_latest()
        while not self.feed.ended and not self._is_left():
            event = json.dumps(self.feed.describe(latest))
            # A deadline of the socket: a viewer whose buffers are full for so long is gone.
            self.wfile.write(f"data: {event}\n\n".encode())
            latest = self.feed.wait_newer(latest.number, HEARTBEAT_S)

    def _is_left(self) -> bool:
        """Whether the viewer has closed the connection; it has nothing more to say."""
        return bool(select.select([self.connection], [], [], 0)[0])

    def _answer_text(self, status: HTTPStatus, text: str, extra: dict[str, str] | None = None) -> None:
        self._answer(status, "text/plain; charset=utf-8", f"{text}\n".encode() if text else b"", extra or {})

    def _answer(self, status: HTTPStatus, kind: str, body: bytes, extra: dict[str, str]) -> None:
        self._begin(status, kind, {"Content-Length": str(len(body))} | extra)
        if self.command != "HEAD":
            self.end_deadline()
            self.begin_deadline()
            self.wfile.write(body)

    def _begin(self, status: HTTPStatus, kind: str, extra: dict[str, str]) -> None:
        self.send_response(status)
        for key, value in ({"Content-Type": kind} | _HEADERS | extra).items():
            self.send_header(key, value)
        self.end_headers()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """A request that cannot be read: the reason as plain text."""
        self.command = self.command or ""
        self._answer_text(HTTPStatus(code), message or explain or HTTPStatus(code).phrase)

    def log_message(self, format: str, *_args: object) -> None:  # noqa: A002, the name that http.server uses
        """Write no log: a first address holds the token."""
