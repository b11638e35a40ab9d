# SPDX-License-Identifier: Apache-2.0
"""A question to the ROS graph, asked in a child process: the agent goes on meanwhile, and can give it up."""

import _signal as signal
import os
import time

from ..link import protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..supervise import shell, spawn
from .local import fill_request, list_setup_files

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Mapping, NoReturn

    FindFault = Callable[[Document, Mapping[str, str], float, list[str]], tuple[str, str]]

_KEPT_BYTES = 2048
# Beyond the time in which a message must come.
_MARGIN_S = 2.0


class GraphQuestion:
    """The running question, with the interface of a `ShellCommand`."""

    def __init__(
        self, asked: Document, env: "Mapping[str, str]", timeout_s: float, setup: "list[str]"
    ) -> None:
        topic = asked.get("topic")
        seconds = max(timeout_s, float(topic["within_s"]) + _MARGIN_S) if topic else timeout_s
        self.deadline = time.monotonic() + seconds
        # Imported here and not in the child: what the agent has compiled is cached on the host.
        find_fault = _load_graph(asked)
        self.pipe, end = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            _answer(lambda: find_fault(asked, env, self.deadline, setup), end)
        os.close(end)
        shell.ShellCommand.running.add(self)

    def poll(self) -> "Document | None":
        """None while it is asked, else its result; it is given up at its deadline."""
        ended = os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        if not ended and time.monotonic() < self.deadline:
            return None
        said = os.read(self.pipe, _KEPT_BYTES) if ended else b"no answer from the graph in time"
        code = self._reap()
        text = said.decode("utf-8", "replace")
        return {"exit": code if ended else None, "timed_out": not ended, "output": text}

    def _reap(self) -> int:
        shell.ShellCommand.running.discard(self)
        try:
            os.kill(self.pid, signal.SIGKILL)
        except OSError:
            pass
        status = os.waitpid(self.pid, 0)[1]
        os.close(self.pipe)
        return os.WEXITSTATUS(status) if os.WIFEXITED(status) else 1

    def end(self) -> None:
        """Give it up."""
        self._reap()

    def result(self) -> Document:
        """Wait for the answer."""
        while True:
            found = self.poll()
            if found is not None:
                return found
            time.sleep(0.005)


def _answer(find_fault: "Callable[[], tuple[str, str]]", end: int) -> "NoReturn":
    """In the child: exit with 0 and the process of the node where all holds, with 1 and the reason where it
    does not, and with ``UNKNOWN_EXIT`` where nothing could be learnt.
    """
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        spawn.reset_signals()
        spawn.close_other_fds({0, 1, 2, end})
        fault, process = find_fault()
        code = 1 if fault else 0
        os.write(end, (fault or process).encode("utf-8", "replace")[:_KEPT_BYTES])
    except Exception as error:  # noqa: BLE001 - the pipe is the only channel
        code = protocol.UNKNOWN_EXIT
        os.write(end, _describe_error(error).encode("utf-8", "replace")[:_KEPT_BYTES])
    finally:
        os._exit(code)


def _describe_error(error: Exception) -> str:
    """Describe why nothing could be learnt: in the words of this package, else with the kind of error."""
    own = type(error).__name__ == "NoHelperError"
    return str(error) if own else "%s: %s" % (type(error).__name__, error)


def _load_graph(asked: Document) -> "FindFault":
    """Load the function that answers questions to this version of ROS."""
    if asked.get("version") == 2:
        from .graph2 import find_fault as of_ros2

        return of_ros2
    from .graph1 import find_fault as of_ros1

    return of_ros1


def start_helpers(request: Document, host: str) -> None:
    """Start the helper that the questions of a request need, where they are to ROS 2."""
    rule = request.get("activation") or {}
    questions = [request, request.get("ready") or {}, request.get("alive") or {}, rule.get("ready") or {}]
    if rule.get("lifecycle") or any((each.get("graph") or {}).get("version") == 2 for each in questions):
        from .graph2 import ensure_helper

        ensure_helper(host, request.get("env") or {}, list_setup_files(request))


def run_check(request: Document) -> Document:
    """Operation ``check``: ask now, by command or of the ROS graph.

    Raises:
        RefusalError: a placeholder has no value here.
    """
    shell.install_deadline_handlers()
    request = fill_request(request)
    start_helpers(request, request["host"])
    return start_question(request, request, request.get("env") or {}, float(request["timeout_s"])).result()


def start_rules(rules: "list[Document]", host: str) -> "dict[str, shell.ShellCommand | GraphQuestion]":
    """Start the checks of a probe: task -> check. One whose placeholders have no value here is left out."""
    shell.install_deadline_handlers()
    started = {}
    for rule in rules:
        try:
            filled = fill_request(rule)
        except RefusalError:
            continue
        start_helpers(filled, host)
        started[str(rule["task"])] = start_question(
            filled, filled, filled.get("env") or {}, float(rule.get("timeout_s", 10.0))
        )
    return started


def start_question(
    question: Document,
    request: Document,
    env: "Mapping[str, str]",
    timeout_s: float,
    cwd: "str | None" = None,
) -> "shell.ShellCommand | GraphQuestion":
    """Start what a check asks: its command, or its question to the graph.

    ``request`` holds what surrounds it: prelude and set-up files.
    """
    setup = list_setup_files(request)
    if question.get("graph"):
        return GraphQuestion(question["graph"], env, timeout_s, setup)
    return shell.ShellCommand(question["command"], request.get("prelude") or "", env, timeout_s, cwd, setup)
