# SPDX-License-Identifier: Apache-2.0
"""Operation ``converse``: an agent that stays as long as its connection and forks a child for each request.

It carries nothing out itself. It loads the modules of an operation once, from their sealed code, forks, and
passes the output of the child on. It waits neither for a child nor for the line, so a request that hangs
costs the others nothing. What it does not take, the manager sends as a call of its own.
"""

import _signal as signal
import os
import select
import sys
import time

from . import cache, protocol
from .boot import FINGERPRINT, AgentImporter, Channel
from .errors import RefusalError
from .fast_json import dumps
from .frames import ASK, DROP, END, MANAGER_WORDS, OUTPUT, REFUSED, SILENCE_S, FrameReader, build_frame

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Dict, List, NoReturn, Set, Tuple

    from .boot import Bundle

    # As `main.serve_request`.
    Serve = Callable[[bytes, Channel, List[str], bool], None]

# More than a manager asks at once; the rest are children that nobody waits for any more.
_MAX_CHILDREN = 16
_OUTPUT_BYTES = 16384
# Exit status of a child that served its request, and had to compile code for it.
_COMPILED = 3


def converse(channel: Channel, bases: "List[str]", serve: "Serve") -> "NoReturn":
    """Say that requests may come, and ``serve`` each in a child until the manager is gone. Ends the process.

    Raises:
        RefusalError: this host keeps no agent from which children could load their code.
    """
    importer = sys.meta_path[0]
    if not isinstance(importer, AgentImporter) or importer.folder is None:
        raise RefusalError("no-cache", "this host cannot keep the agent")
    if FINGERPRINT not in importer.bundle:
        importer.read_sources()
        cache.write_bundle(importer, protocol.OP_CONVERSE)
        # Megabytes that every supervisor would inherit; who needs them reads them again.
        importer.agent, importer.sources, importer.spare = b"", {}, {}
    staying = _StayingAgent(importer, channel, bases, serve)
    channel.reply(dumps({"op": protocol.OP_CONVERSE}).encode("ascii"))
    # The deadline was that of the beginning.
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    os.set_blocking(channel.fd, False)
    try:
        staying.serve()
    except (OSError, ValueError):
        # The line has ended while something was sent, or what came is no frame.
        pass
    finally:
        staying.end_children()
        os._exit(0)


def _forget_loaded_code(bundle: "Bundle") -> None:
    """Keep the names alone of modules that are loaded: an agent that stays never needs their code again."""
    for name in bundle.keys() & sys.modules.keys():
        if bundle[name] is not None:
            bundle[name] = memoryview(b"")


class _StayingAgent:
    """The requests that are under way, each a child with a pipe for its output."""

    def __init__(self, importer: AgentImporter, channel: Channel, bases: "List[str]", serve: "Serve") -> None:
        self._importer, self._channel, self._bases, self._serve_request = importer, channel, bases, serve
        self._agent_path = os.path.join(str(importer.folder), importer.sha + ".pyz")
        self._reader = FrameReader(MANAGER_WORDS)
        # By descriptor of the pipe: number of the request, process, operation.
        self._children: "Dict[int, Tuple[int, int, str]]" = {}
        self._outgoing = b""
        self._heard = time.monotonic()
        self._loaded: "Set[str]" = set()
        # Operations whose code has grown: a call of its own keeps it, and it is loaded again after that.
        self._outgrown: "Set[str]" = set()

    def serve(self) -> None:
        """Serve requests until the input ends or nothing has come for too long.

        Raises:
            OSError: the output has ended.
            ValueError: what came is no frame.
        """
        while True:
            ready = self._wait(self._heard + SILENCE_S)
            data = os.read(0, _OUTPUT_BYTES) if 0 in ready else b""
            now = time.monotonic()
            if now - self._heard >= SILENCE_S:
                # Silence; or this process was frozen, also just before it read, and what came meanwhile is
                # too old to be a contact.
                return
            if 0 in ready:
                if not data:
                    return
                self._heard = now
                for word, number, body in self._reader.feed(data):
                    if word == ASK:
                        self._begin(number, body)
                    elif word == DROP:
                        self.end_children(number)
            if self._channel.fd in ready:
                self._send()
            for fd in ready.intersection(self._children):
                self._pass_on(fd)

    def end_children(self, only: int = 0) -> None:
        """End the requests under way that only read, or one: nobody waits for it. A change goes on."""
        for number, pid, operation in self._children.values():
            if operation in protocol.CONVERSED_OPS and only in (0, number):
                os.kill(pid, signal.SIGTERM)

    def _wait(self, until: float) -> "Set[int]":
        """Wait for what can be read or written. No child is read while the line is full: bounded memory."""
        poll = select.poll()
        poll.register(0, select.POLLIN)
        for fd in (self._channel.fd,) if self._outgoing else self._children:
            poll.register(fd, select.POLLOUT if self._outgoing else select.POLLIN)
        milliseconds = int(1000 * max(0.0, until - time.monotonic())) + 1
        return {fd for fd, _ in poll.poll(milliseconds)}

    def _send(self) -> None:
        try:
            self._outgoing = self._outgoing[os.write(self._channel.fd, self._outgoing) :]
        except BlockingIOError:
            pass

    def _pass_on(self, fd: int) -> None:
        """Pass on a piece of the output of a child; at the end, how its process ended."""
        number, pid, operation = self._children[fd]
        data = os.read(fd, _OUTPUT_BYTES)
        if data:
            self._outgoing += build_frame(OUTPUT, number, data)
            return
        os.close(fd)
        del self._children[fd]
        _, status = os.waitpid(pid, 0)
        code = os.WEXITSTATUS(status) if os.WIFEXITED(status) else -os.WTERMSIG(status)
        if code == _COMPILED:
            self._outgrown.add(operation)
            code = 0
        self._outgoing += build_frame(END, number, b"%d" % code)

    def _begin(self, number: int, packet: bytes) -> None:
        """Begin a request: its line of words (`boot.boot_agent`) and its document."""
        head, _, request = packet.partition(b"\n")
        words = head.decode("ascii", "replace").split()
        if not self._can_serve(words, request) or not self._fork(number, words, request):
            self._outgoing += build_frame(REFUSED, number)

    def _can_serve(self, words: "List[str]", request: bytes) -> bool:
        """Whether it is a whole request of this agent and manager, of an operation whose code is kept."""
        if len(words) != 7 or len(self._children) >= _MAX_CHILDREN:  # noqa: PLR2004 - the words of boot_agent
            return False
        _, sha, length, agent_length, _, key, operation = words
        return (
            (sha, key, agent_length, length)
            == (self._importer.sha, self._importer.key, "0", str(len(request)))
            and operation in protocol.CONVERSED_OPS + protocol.CONVERSED_CHANGES
            # Requests that this one does not carry rely on it: a call sends it again.
            and os.path.exists(self._agent_path)
            and self._load(operation)
        )

    def _load(self, operation: str) -> bool:
        """Load the modules of an operation; False where its code is not kept, or was not enough."""
        if operation in self._outgrown:
            self._outgrown.remove(operation)
            self._loaded.discard(operation)
            return False
        if operation in self._loaded:
            return True
        code = cache.read_code(self._importer, operation)
        if not code:
            return False
        for name, each in code.items():
            self._importer.bundle.setdefault(name, each)
        try:
            # In the order in which they were first imported.
            for name, each in code.items():
                if isinstance(each, memoryview):
                    __import__(name)
        except Exception:  # noqa: BLE001 - a call of its own says what is wrong
            return False
        self._loaded.add(operation)
        _forget_loaded_code(self._importer.bundle)
        return True

    def _fork(self, number: int, words: "List[str]", request: bytes) -> bool:
        """Fork the child of a request; False where the host lacks what it needs."""
        try:
            ours, theirs = os.pipe()
        except OSError:
            return False
        try:
            pid = os.fork()
        except OSError:
            os.close(ours)
            os.close(theirs)
            return False
        if pid == 0:
            self._become_child(words, request, ours, theirs)
        os.close(theirs)
        self._children[ours] = number, pid, words[6]
        return True

    def _become_child(self, words: "List[str]", request: bytes, ours: int, output: int) -> "NoReturn":
        """Serve one request as `boot.boot_agent` does, without the descriptors of its parent; then end."""
        try:
            null = os.open(os.devnull, os.O_RDWR)
            for fd, source in ((0, null), (1, output), (2, null)):
                os.dup2(source, fd)
            for fd in (null, ours, output, self._channel.fd, *self._children):
                os.close(fd)
            # A timer is not inherited.
            signal.setitimer(signal.ITIMER_REAL, float(words[4]))
            known = len(self._importer.bundle)
            self._serve_request(request, Channel(words[0]), self._bases, True)
            os._exit(_COMPILED if len(self._importer.bundle) != known else 0)
        finally:
            os._exit(1)
