# SPDX-License-Identifier: Apache-2.0
"""Operation ``hear``: when this robot hears a task, by messages on a topic or by a command that succeeds.

A watcher in a process of its own begins before a move and is asked at its end for the longest silence.
"""

import _signal as signal
import os
import select
import socket
import struct
import time

from ..link import boot, fast_json
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..supervise import shell, spawn, state_dir
from .local import fill_request, list_setup_files

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import List, NoReturn, Tuple, Union

    from .listener import TopicListener

    # When it was asked and when it was heard (monotonic clock).
    Events = List[Tuple[float, float]]
    Source = Union["CommandSource", "TopicSource"]

# A watcher that nobody asks ends after so long; a manager may have been killed.
_MOST_LIFE_S = 900.0
# Between two runs of a command, and looks at one that runs.
_PAUSE_S, _POLL_S, _COMMAND_S = 0.02, 0.005, 10.0
_MARGIN_S = 2.0
_NO_WATCHER = "the watcher that was begun is gone"


class TopicSource:
    """Messages of one topic."""

    def __init__(self, request: Document) -> None:
        from .listener import TopicListener

        version = int((request.get("ros") or {}).get("version") or 1)
        self.listener: "TopicListener" = TopicListener(version, [request["topic"]], request)
        self.fds = [self.listener.fd]
        self.pause_s = 1.0

    def poll(self) -> "Events":
        """What was heard since."""
        found = [(came, came) for _, came, _ in self.listener.read()]
        if self.listener.errors:
            self.fds = []
        return found

    def describe_error(self) -> str:
        """Why nothing is heard; empty where that is not known."""
        return "; ".join(self.listener.errors.values())

    def end(self) -> None:
        """End it."""
        self.listener.end()


class CommandSource:
    """A command, run again and again; each success is heard when it ends."""

    def __init__(self, request: Document) -> None:
        self.request, self.fds, self.pause_s = request, [], _POLL_S  # type: Document, list[int], float
        self.running: "shell.ShellCommand | None" = None
        self.asked, self.fault = 0.0, ""

    def poll(self) -> "Events":
        """What was heard since; starts the command where its pause is over."""
        now = time.monotonic()
        if self.running is None:
            if now - self.asked >= _PAUSE_S:
                self.asked, self.running = now, self._start()
            return []
        result = self.running.poll()
        if result is None:
            return []
        begun, self.running = self.asked, None
        self.asked = time.monotonic()
        if result["exit"] == 0:
            return [(begun, self.asked)]
        self.fault = "the command failed: %s" % (str(result["output"]).strip()[-200:] or result["exit"])
        return []

    def _start(self) -> shell.ShellCommand:
        request, setup = self.request, list_setup_files(self.request)
        prelude, env = request.get("prelude") or "", request.get("env") or {}
        return shell.ShellCommand(request["command"], prelude, env, _COMMAND_S, None, setup)

    def describe_error(self) -> str:
        """Why nothing is heard."""
        return self.fault

    def end(self) -> None:
        """End what runs."""
        if self.running is not None:
            self.running.end()


class Silence:
    """The longest time between two moments at which something was heard."""

    def __init__(self) -> None:
        self.count, self.longest, self.last, self.asked = 0, 0.0, 0.0, 0.0

    def add(self, events: "Events") -> None:
        """Take what was heard, in order."""
        for asked, came in events:
            if self.count:
                self.longest = max(self.longest, came - self.last)
            self.count, self.last, self.asked = self.count + 1, max(came, self.last), asked


def hear(request: Document) -> Document:
    """Begin a watcher, or end it and report the longest silence.

    Raises:
        RefusalError: the watcher to end is gone, or a placeholder has no value here.
    """
    name = _build_name(request)
    if request["action"] == "begin":
        _begin_watcher(name, fill_request(request))
    now = time.monotonic()
    asked = {
        "end": request["action"] != "begin",
        "since": now - float(request["after_s"]),
        "until": now + float(request["timeout_s"]),
    }
    try:
        return _ask_watcher(name, asked)
    except OSError as error:
        raise RefusalError("no-watcher", _NO_WATCHER, "") from error


def _build_name(request: Document) -> str:
    parts = (state_dir.get_fleet(), request["host"], request["watch"])
    return "\0edgectl-heard-%d-%s" % (os.geteuid(), boot.compute_sha256("\0".join(parts).encode())[:16])


def _begin_watcher(name: str, request: Document) -> None:
    """Start the watcher in a session of its own; without effect where it is there already."""
    server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        server.bind(name)
    except OSError:
        return server.close()
    server.listen(4)
    # Imported here and not in the child: what the agent has compiled is cached on the host.
    if request.get("topic"):
        from . import listener  # noqa: F401
    child = os.fork()
    if child == 0:
        _detach_watcher(server, request)
    server.close()
    os.waitpid(child, 0)
    return None


def _detach_watcher(server: "socket.socket", request: Document) -> "NoReturn":
    """In the first child: a second one in a session of its own, which no login ends."""
    try:
        os.setsid()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if os.fork() == 0:
            spawn.clean_process((server.fileno(),))
            source: "Source" = TopicSource(request) if request.get("topic") else CommandSource(request)
            try:
                _watch(server, source)
            finally:
                source.end()
    finally:
        os._exit(0)


def _watch(server: "socket.socket", source: "Source") -> None:
    """Watch until it was asked for the end, or for too long."""
    silence, deadline = Silence(), time.monotonic() + _MOST_LIFE_S
    waiting: "list[tuple[socket.socket, Document]]" = []
    while time.monotonic() < deadline:
        pause = min([source.pause_s, *(each["until"] - time.monotonic() for _, each in waiting)])
        readable = select.select([server.fileno(), *source.fds], [], [], max(0.0, pause))[0]
        if server.fileno() in readable:
            waiting += _accept(server)
        silence.add(source.poll())
        for each in list(waiting):
            peer, asked = each
            heard = silence.count > 0 and (not asked["end"] or silence.asked >= asked["since"])
            hopeless = isinstance(source, TopicSource) and not source.fds
            if heard or hopeless or time.monotonic() >= asked["until"]:
                waiting.remove(each)
                _answer(peer, silence, source, heard=heard)
                if asked["end"]:
                    return


def _accept(server: "socket.socket") -> "list[tuple[socket.socket, Document]]":
    peer = server.accept()[0]
    try:
        peer.settimeout(_MARGIN_S)
        credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        if struct.unpack("3i", credentials)[1] == os.geteuid():
            return [(peer, fast_json.loads(peer.recv(4096).decode("utf-8")))]
    except (OSError, ValueError):
        pass
    peer.close()
    return []


def _answer(peer: "socket.socket", silence: Silence, source: "Source", *, heard: bool) -> None:
    reply = {
        "heard": heard,
        "count": silence.count,
        "silence_s": round(silence.longest, 6),
        "detail": "" if heard else source.describe_error(),
    }
    try:
        peer.sendall(fast_json.dumps(reply).encode("ascii"))
    except OSError:
        pass
    peer.close()


def _ask_watcher(name: str, asked: Document) -> Document:
    """Ask the watcher of this user. OSError where there is none."""
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.settimeout(max(0.0, asked["until"] - time.monotonic()) + _MARGIN_S)
        made.connect(name)
        made.sendall(fast_json.dumps(asked).encode("ascii"))
        data = made.recv(4096)
    finally:
        made.close()
    if not data:
        raise OSError(_NO_WATCHER)
    reply: Document = fast_json.loads(data.decode("ascii"))
    return reply
