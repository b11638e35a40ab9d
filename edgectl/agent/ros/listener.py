# SPDX-License-Identifier: Apache-2.0
"""Child process that listens to topics in the environment of the set-up files, read line by line."""

import _signal as signal
import os
import sys
import time

from ..link import protocol
from ..link.fast_json import Document
from ..supervise import shell, spawn
from .local import list_setup_files

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, Mapping

_PROGRAM = "edgectl_agent/ros/listener_program.py"
_BLOCK_BYTES, _MOST_BYTES = 1 << 16, 1 << 20
_END_S = 1.0
_ENDED = "the listener ended: python3 of the set-up files may have no %s"


class TopicListener:
    """A listener; ``fd`` is readable when something was heard. ``errors``: by topic, why nothing is."""

    def __init__(self, version: int, topics: "list[str]", request: Document) -> None:
        """``request`` holds what surrounds it: environment and set-up files."""
        self.topics, self.version = topics, version
        self.errors: "dict[str, str]" = {}
        self.kept = b""
        loader: "Any" = sys.modules[__name__].__loader__
        program = loader.read_sources()[_PROGRAM]
        self.fd, end = os.pipe()
        source, source_end = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            _exec_listener(version, topics, request, source, end)
        os.close(source)
        os.close(end)
        os.set_blocking(self.fd, False)
        with open(source_end, "wb") as pipe:
            pipe.write(program)

    def read(self) -> "list[tuple[str, float, float | None]]":
        """Read what was heard since: topic, time (monotonic clock) and age (ms)."""
        data = self.kept
        while len(data) < _MOST_BYTES:
            try:
                part = os.read(self.fd, _BLOCK_BYTES)
            except BlockingIOError:
                break
            if not part:
                ros = "rclpy" if self.version == 2 else "rospy"
                self.errors = {**dict.fromkeys(self.topics, _ENDED % ros), **self.errors}
                break
            data += part
        *lines, self.kept = data.split(b"\n")
        return [found for found in map(self._parse, lines) if found is not None]

    def _parse(self, line: bytes) -> "tuple[str, float, float | None] | None":
        words = line.decode("utf-8", "replace").split(" ", 3)
        if words[0] == "heard" and len(words) == 4:
            return self.topics[int(words[1])], float(words[2]), None if words[3] == "-" else float(words[3])
        if words[0] == "error" and len(words) > 2:
            self.errors[self.topics[int(words[1])]] = " ".join(words[2:])[:200]
        return None

    def end(self) -> None:
        """End it: by TERM, so that it can take leave of its graph, then by KILL."""
        until = time.monotonic() + _END_S
        for number in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.kill(self.pid, number)
            except OSError:
                break
            while not os.waitpid(self.pid, os.WNOHANG)[0]:
                if number == signal.SIGTERM and time.monotonic() > until:
                    break
                time.sleep(0.01)
            else:
                break
        os.close(self.fd)


def _exec_listener(version: int, topics: "list[str]", request: Document, source: int, end: int) -> None:
    try:
        spawn.reset_signals()
        os.dup2(source, 0)
        os.dup2(end, 1)
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, 2)
        spawn.close_other_fds({0, 1, 2})
        env: "Mapping[str, str]" = request.get("env") or {}
        clean = {key: text for key, text in shell.build_environment(env).items() if key[:8] != "EDGECTL_"}
        argv = ["python3", "-", str(version), *topics]
        argv = protocol.build_sourced_argv(list_setup_files(request), argv)
        os.execve(argv[0], argv, clean)  # noqa: S606 - the program is a constant
    finally:
        os._exit(127)
