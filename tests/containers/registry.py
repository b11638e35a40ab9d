# SPDX-License-Identifier: Apache-2.0
"""A registry that serves the image of the tests under every name, holds its answers back, or knows no image."""

import gzip
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tests.containers.docker_engine import build_image
from tests.faults.relay import enter_netns

_TYPE = "application/vnd.docker.distribution.manifest.v2+json"


def build_digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def describe_blob(kind: str, data: bytes) -> dict[str, object]:
    return {"mediaType": kind, "size": len(data), "digest": build_digest(data)}


class ImageRegistry:
    """``asked``: the addresses from which an image was asked for. While not ``open`` nobody gets an answer; while
    ``empty`` there is no image.
    """

    def __init__(self) -> None:
        layer = build_image()
        packed = gzip.compress(layer, 1, mtime=0)
        root = {"type": "layers", "diff_ids": [build_digest(layer)]}
        config = json.dumps({"architecture": "amd64", "os": "linux", "config": {}, "rootfs": root}).encode()
        image = "application/vnd.docker.container.image.v1+json"
        manifest = {
            "schemaVersion": 2,
            "mediaType": _TYPE,
            "config": describe_blob(image, config),
            "layers": [describe_blob("application/vnd.docker.image.rootfs.diff.tar.gzip", packed)],
        }
        self.manifest = json.dumps(manifest).encode()
        self.blobs = {build_digest(data): data for data in (packed, config)}
        self.open, self.empty, self.asked = threading.Event(), False, set[str]()
        self.address = ""
        self.open.set()

    def find(self, path: str) -> tuple[bytes, str] | None:
        """Find content and type of what is asked for."""
        kind, word = path.split("/")[-2:]
        if kind == "manifests" and not self.empty:
            return self.manifest, _TYPE
        found = None if self.empty else self.blobs.get(word)
        return None if found is None else (found, "application/octet-stream")


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def __init__(self, registry: ImageRegistry, *more: object) -> None:
        self.registry = registry
        super().__init__(*more)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        found: tuple[bytes, str] | None = (b"{}", "application/json")
        if self.path != "/v2/":
            self.registry.asked.add(str(self.client_address[0]))
            self.registry.open.wait()
            found = self.registry.find(self.path)
        unknown = json.dumps({"errors": [{"code": "MANIFEST_UNKNOWN", "message": "no such image here"}]})
        body, kind = found or (unknown.encode(), "application/json")
        self.send_response(200 if found else 404)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Docker-Content-Digest", build_digest(body))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body)

    def do_HEAD(self) -> None:
        self.do_GET()

    def log_message(self, *_words: object) -> None:
        """The tests print nothing of it."""


@contextmanager
def open_registry(address: str, netns: Path | None) -> Iterator[ImageRegistry]:
    """Serve at a free port of ``address``, in the network namespace ``netns`` if there is one."""
    registry, ready, made = ImageRegistry(), threading.Event(), list[ThreadingHTTPServer]()

    def serve() -> None:
        try:
            if netns:
                enter_netns(netns)
            server = ThreadingHTTPServer((address, 0), partial(_Handler, registry))
            server.daemon_threads = True
            made.append(server)
        finally:
            ready.set()
        server.serve_forever(poll_interval=0.1)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    ready.wait()
    assert made, f"nobody can listen at {address}"
    registry.address = f"{address}:{made[0].server_address[1]}"
    try:
        yield registry
    finally:
        registry.open.set()
        made[0].shutdown()
        thread.join()
        made[0].server_close()
