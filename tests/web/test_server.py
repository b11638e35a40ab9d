# SPDX-License-Identifier: Apache-2.0
"""The server of the page over real sockets."""

import contextlib
import gzip
import itertools
import json
import re
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from http.server import ThreadingHTTPServer
from typing import Any

import pytest

from edgectl.errors import StateError
from edgectl.export.http_connections import MAX_PER_PEER
from edgectl.formats.document import Document
from edgectl.web.access import derive_cookie
from edgectl.web.page import build_policy, load_page
from tests.pace import patience
from tests.web.servers import fetch, run_page_server

TOKEN = "a-token-of-the-lab"


def test_the_page_runs_nothing_but_its_own_script() -> None:
    with run_page_server(dict) as (made, _):
        status, headers, body = fetch(made, "/")
        assert (status, body) == (200, load_page("fleet").body)
        policy = headers["content-security-policy"]
        assert "unsafe" not in policy
        assert policy.startswith("default-src 'none'; script-src 'sha256-")
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["x-content-type-options"] == "nosniff"
    assert len(body) < 150_000
    text = body.decode()
    assert not re.search(r"https?:|//[a-z]|\sstyle=|\son[a-z]+=|innerHTML", text), (
        "the page loads and injects nothing"
    )
    assert build_policy(text.replace("EventSource(", "eventSource(")) != policy, (
        "a changed script is another one"
    )


def test_the_document_comes_whole_packed_or_not_at_all() -> None:
    with run_page_server(lambda: {"item": {"text": "grün"}}, every=600) as (made, feed):
        latest = feed.wait_newer(0, patience(60))
        status, headers, body = fetch(made, "/api/fleet")
        assert (status, json.loads(body)) == (200, {"item": {"text": "grün"}})
        packed = fetch(made, "/api/fleet", Accept_Encoding="gzip")[2]
        assert gzip.decompress(packed) == body == latest.body
        assert fetch(made, "/api/fleet", If_None_Match=headers["etag"])[::2] == (304, b"")


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE", "OPTIONS"])
def test_nothing_but_get_is_answered(method: str) -> None:
    with run_page_server(dict) as (made, _):
        status, headers, _ = fetch(made, "/", method)
        assert (status, headers["allow"]) == (405, "GET")


@pytest.mark.parametrize(
    "path", ["/etc/passwd", "/../fleet.html", "/api", "/api/fleet/", "/fleet.html", "/%2e%2e/"]
)
def test_other_paths_are_not_found(path: str) -> None:
    with run_page_server(dict) as (made, _):
        assert fetch(made, path)[0] == 404


def test_what_is_no_request_ends_only_itself() -> None:
    with run_page_server(dict) as (made, _):
        for data in (
            b"\0\xff\r\n\r\n",
            b"GET\r\n\r\n",
            b"GET / HTTP/9.9\r\n\r\n",
            b"GET /" + b"a" * 70_000 + b" HTTP/1.0\r\n\r\n",
        ):
            line = socket.create_connection(("127.0.0.1", made.server_port), timeout=patience(60))
            with line, contextlib.suppress(ConnectionError):
                line.sendall(data)
                assert b"200" not in line.recv(20)
        assert fetch(made, "/")[0] == 200


def test_a_strange_host_is_refused() -> None:
    with run_page_server(dict) as (made, _):
        assert fetch(made, "/api/fleet", Host="rebound.example")[0] == 421


def test_a_token_opens_the_page_once_and_leaves_the_address() -> None:
    with run_page_server(lambda: {"secret": 1}, token=TOKEN) as (made, feed):
        feed.wait_newer(0, patience(60))
        status, headers, body = fetch(made, "/")
        assert status == 401
        assert b"password" in body
        assert fetch(made, "/api/fleet")[::2] == (401, b"a token is needed\n")
        assert fetch(made, "/api/events")[0] == 401
        assert fetch(made, f"/api/fleet?token={TOKEN}")[0] == 401, "only the page takes it from its address"
        wrong = fetch(made, "/?token=" + "x" * 18)
        assert wrong[0] == 401
        assert "set-cookie" not in wrong[1]
        status, headers, _ = fetch(made, f"/?token={TOKEN}")
        assert (status, headers["location"]) == (303, "/")
        cookie = headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Lax" in cookie
        assert TOKEN not in cookie
        name = f"edgectl-{made.server_port}"
        assert cookie.startswith(f"{name}={derive_cookie(TOKEN)};")
        assert fetch(made, "/", Cookie=cookie.partition(";")[0])[0] == 200
        assert fetch(made, "/api/fleet", Authorization=f"Bearer {TOKEN}")[0] == 200


def connect_to_events(made: ThreadingHTTPServer) -> socket.socket:
    """A viewer."""
    line = socket.create_connection(("127.0.0.1", made.server_port), timeout=patience(60))
    line.sendall(b"GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    return line


def read_events(line: socket.socket, count: int) -> list[dict[str, Any]]:
    """The first events."""
    found = []
    with line.makefile("rb") as file:
        for text in file:
            if text.startswith(b"data: "):
                found.append(json.loads(text.removeprefix(b"data: ")))
                if len(found) == count:
                    break
    return found


def test_many_viewers_share_one_loop_and_one_that_reads_nothing_stops_nobody() -> None:
    made_by: set[int] = set()
    counted = itertools.count(1)

    def make() -> Document:
        made_by.add(threading.get_ident())
        return {"item": {"number": next(counted)}}

    with run_page_server(make) as (made, feed), contextlib.ExitStack() as stack:
        for _ in range(2):
            stack.enter_context(connect_to_events(made))  # reads nothing
        connect_to_events(made).close()
        lines = [stack.enter_context(connect_to_events(made)) for _ in range(MAX_PER_PEER - 6)]
        with ThreadPoolExecutor(len(lines)) as pool:
            for seen in pool.map(lambda line: read_events(line, 3), lines):
                versions = [event["version"] for event in seen]
                assert versions == sorted(versions)
                assert seen[-1]["version"] >= 2
                assert seen[-1]["error"] == ""
        assert len(made_by) == 1
        document = json.loads(fetch(made, "/api/fleet")[2])
        assert document["item"]["number"] <= feed.get_latest().version


def test_a_viewer_that_leaves_gives_its_place_back() -> None:
    with run_page_server(dict) as (made, _):
        for _ in range(3 * MAX_PER_PEER):
            for _ in range(200):  # the server has not noticed yet that those before have gone
                with connect_to_events(made) as line, contextlib.suppress(ConnectionError):
                    if read_events(line, 1):
                        break
                time.sleep(0.05)
            else:
                pytest.fail("no place is free")


def test_a_probe_that_fails_keeps_the_document_and_says_why() -> None:
    fails = threading.Event()

    def make() -> Document:
        if fails.is_set():
            raise StateError("the disk <is> full")
        return {"item": 1}

    with run_page_server(make) as (made, feed):
        feed.wait_newer(0, patience(60))
        fails.set()
        with connect_to_events(made) as line:
            told = next(event for event in (read_events(line, 1)[0] for _ in range(1000)) if event["error"])
        assert told["error"] == "the disk <is> full"
        assert isinstance(told["age_s"], float)
        assert json.loads(fetch(made, "/api/fleet")[2]) == {"item": 1}


def test_before_the_first_probe_there_is_no_document() -> None:
    go = threading.Event()

    def make() -> Document:
        go.wait(patience(60))
        return {}

    with run_page_server(make) as (made, feed):
        status, headers, _ = fetch(made, "/api/fleet")
        assert (status, headers["retry-after"]) == (503, "1")
        go.set()
        feed.wait_newer(0, patience(60))
        assert fetch(made, "/api/fleet")[0] == 200
