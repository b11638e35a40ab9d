# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium, driven over the pipe of its DevTools protocol."""

import base64
import contextlib
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.pace import patience

PROGRAMS = ("chromium-headless-shell", "chromium", "google-chrome")
# The browser reads requests from the first, and writes to the second.
_REQUEST_FD, _REPLY_FD = 3, 4


class NavigatedError(Exception):
    """The page went elsewhere while an expression was evaluated in it."""


class Browser:
    """One page of a browser."""

    def __init__(self, requests: int, replies: int) -> None:
        self._requests, self._replies = requests, replies
        self._buffer, self._number = b"", 0
        self.events: list[dict[str, Any]] = []
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """One request about the page, and its result."""
        return self._call(method, self._session, **parameters)

    def _call(self, method: str, session: str | None = None, **parameters: object) -> dict[str, Any]:
        self._number += 1
        request: dict[str, object] = {"id": self._number, "method": method, "params": parameters}
        if session is not None:
            request["sessionId"] = session
        os.write(self._requests, json.dumps(request).encode() + b"\0")
        end = time.monotonic() + patience(60)
        while True:
            found = self._read(end)
            if found.get("id") == self._number:
                if "navigated" in str(found.get("error")):
                    raise NavigatedError
                assert "error" not in found, found
                return dict(found["result"])
            self.events.append(found)

    def _read(self, end: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            assert select.select([self._replies], [], [], max(0.0, end - time.monotonic()))[0], "no answer"
            data = os.read(self._replies, 1 << 16)
            assert data, "the browser has ended"
            self._buffer += data
        text, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(text))

    def resize(self, width: int, height: int, *, dark: bool = False) -> None:
        """Set the size of the window and the theme of the system."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        theme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[theme])

    def open(self, url: str) -> None:
        """Load a page, or begin to."""
        self.call("Page.navigate", url=url)
        self.wait_for(f"document.documentElement && location.href.startsWith({json.dumps(url)})")

    def evaluate(self, script: str) -> Any:
        """Value of an expression in the page."""
        done = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in done, done
        return done["result"].get("value")

    def wait_for(self, script: str) -> Any:
        """The value of the expression as soon as it is true."""
        end = time.monotonic() + patience(60)
        while time.monotonic() < end:
            with contextlib.suppress(NavigatedError):
                if found := self.evaluate(script):
                    return found
            time.sleep(0.05)
        raise AssertionError(f"never true: {script}")

    def press(self, key: str) -> None:
        """Press a key."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=9)

    @contextlib.contextmanager
    def trace(self) -> Iterator[list[dict[str, Any]]]:
        """Record what the browser's threads do; the events are in the list once the block has ended."""
        categories = [
            "toplevel",
            "devtools.timeline",
            "blink.user_timing",
            "disabled-by-default-devtools.timeline",
        ]
        self._call(
            "Tracing.start", traceConfig={"includedCategories": categories}, transferMode="ReportEvents"
        )
        found: list[dict[str, Any]] = []
        yield found
        self._call("Tracing.end")
        end = time.monotonic() + patience(60)
        while not any(event["method"] == "Tracing.tracingComplete" for event in self.events):
            self.events.append(self._read(end))
        for event in self.events:
            if event["method"] == "Tracing.dataCollected":
                found += event["params"]["value"]
        self.events = [event for event in self.events if not event["method"].startswith("Tracing.")]

    def save_screenshot(self, path: Path) -> None:
        """The visible part of the page as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


@contextlib.contextmanager
def run_browser(profile: Path) -> Iterator[Browser]:
    """A browser with a new profile; it ends with the block."""
    program = next((found for each in PROGRAMS if (found := shutil.which(each))), None)
    assert program is not None, "no Chromium: .ci/need-browser"
    theirs_in, ours_out = os.pipe()
    ours_in, theirs_out = os.pipe()

    script = f'exec "$0" "$@" {_REQUEST_FD}<&{theirs_in} {_REPLY_FD}>&{theirs_out}'
    words = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--remote-debugging-pipe",
        f"--user-data-dir={profile}",
    ]
    process = subprocess.Popen(
        ["bash", "-c", script, program, *words],
        pass_fds=(theirs_in, theirs_out),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(theirs_in)
    os.close(theirs_out)
    try:
        yield Browser(ours_out, ours_in)
    finally:
        os.close(ours_out)
        os.close(ours_in)
        process.terminate()
        process.wait(60)
